// Tier 2, one structure: nine connections, a cube each, are joined to a grid by twelve hinges, and hop.
package main

import (
	"context"
	"math"

	"nmes"
	"nmes/examples/internal/example"
)

const (
	spacing = 1.2 // m, between the centres of cubes of 1 m
	impulse = 4.0 // N s upwards on each cube of 1 kg: 4 m/s, so that they should rise by v^2 / 2g = 0.82 m
)

func measure(ctx context.Context, connect example.Connect) ([]example.Figure, error) {
	var clients [9]*nmes.Client
	var names [9]string
	for i := range clients {
		client, err := connect()
		if err != nil {
			return nil, err
		}
		defer client.Close()
		if clients[i] = client; i == 0 {
			if err := example.Lockstep(ctx, client); err != nil {
				return nil, err
			}
		}
		position := nmes.Vector{spacing * float64(i%3-1), 0.5, spacing * float64(i/3-1)}
		spawned, err := client.SpawnCube(ctx, nmes.SpawnCube{Position: &position, List: nmes.Ptr(false)})
		if err != nil {
			return nil, err
		}
		names[i] = spawned.Spawned
	}
	leader := clients[0]
	hinges := []nmes.Pending[nmes.JointCreated]{}
	hinge := func(i, j int, axis nmes.Vector) {
		hinges = append(hinges, nmes.Send(clients[i], nmes.CreateJoint{Cube1: names[i], Cube2: names[j], JointType: "hinge", Axis: &axis}))
	}
	for i := range names {
		if i%3 < 2 { // to the neighbour along x, about z
			hinge(i, i+1, nmes.Vector{0, 0, 1})
		}
		if i/3 < 2 { // to the neighbour along z, about x
			hinge(i, i+3, nmes.Vector{1, 0, 0})
		}
	}
	for _, each := range hinges {
		if _, err := each.Wait(ctx); err != nil {
			return nil, err
		}
	}
	rest, err := heights(ctx, leader, names[:], 60)
	if err != nil {
		return nil, err
	}
	for _, client := range clients { // who owns one cube need not name it
		if _, err := client.ApplyPhysics(ctx, nmes.ApplyPhysics{Impulse: &nmes.Vector{0, impulse, 0}}); err != nil {
			return nil, err
		}
	}
	highest, landed := append([]float64{}, rest...), rest
	for range 120 {
		if landed, err = heights(ctx, leader, names[:], 1); err != nil {
			return nil, err
		}
		for i, height := range landed {
			highest[i] = math.Max(highest[i], height)
		}
	}
	hop, apart := math.Inf(1), 0.0
	for i := range names {
		hop, apart = math.Min(hop, highest[i]-rest[i]), math.Max(apart, math.Abs(landed[i]-rest[i]))
	}
	return []example.Figure{
		{Name: "hinges", Value: float64(len(hinges)), AtLeast: 12, AtMost: 12},
		{Name: "hop height", Value: hop, Unit: "m", AtLeast: 0.6, AtMost: 1},
		{Name: "height after landing", Value: apart, Unit: "m", AtLeast: 0, AtMost: 0.1},
	}, nil
}

// heights returns how high cubes are after some ticks.
func heights(ctx context.Context, client *nmes.Client, names []string, ticks int) ([]float64, error) {
	nmes.Send(client, nmes.Step{Ticks: &ticks})
	state, err := nmes.Send(client, nmes.GetWorldState{Cubes: names}).Wait(ctx)
	if err != nil {
		return nil, err
	}
	result := []float64{}
	for _, cube := range state.Cubes {
		result = append(result, cube.Position[1])
	}
	return result, nil
}

func main() { example.Main(measure) }
