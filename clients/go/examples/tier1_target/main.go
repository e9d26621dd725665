// Tier 1, one cube: an agent learns to push a cube to a target, by Q-learning. It sees roughly where the target is and
// how fast the cube goes, and pushes in one of four directions, or not at all.
package main

import (
	"context"
	"math"
	"math/rand/v2"

	"nmes"
	"nmes/examples/internal/example"
)

const (
	cube      = "learner"
	ticks     = 6   // between decisions: a tenth of a second
	push      = 0.7 // N s, on 1 kg
	decisions = 32  // of an episode
	episodes  = 90
	near      = 0.7 // m, and m/s: what counts as there, and as at rest
	learning  = 0.25
	discount  = 0.9
)

var target = nmes.Vector{3, 0.5, -2}

// pushes are the actions.
var pushes = []nmes.Vector{{0, 0, 0}, {push, 0, 0}, {-push, 0, 0}, {0, 0, push}, {0, 0, -push}}

// agent has for each state, and each action in it, what is to be expected.
type agent [81][5]float64

// state returns where and how fast the cube is, of the target and along the ground: each of four numbers as one of three.
func state(seen *nmes.CubeState) (number int) {
	for _, value := range []float64{
		target[0] - seen.Position[0], target[2] - seen.Position[2], seen.LinearVelocity[0], seen.LinearVelocity[2],
	} {
		number *= 3
		if value > near {
			number += 2
		} else if value > -near {
			number++
		}
	}
	return number
}

func distance(seen *nmes.CubeState) float64 {
	return math.Hypot(target[0]-seen.Position[0], target[2]-seen.Position[2])
}

func (a *agent) best(state int) (best int) {
	for action, value := range a[state] {
		if value > a[state][best] {
			best = action
		}
	}
	return best
}

// episode puts the cube down and drives it; it returns how far from the target it ends.
func (a *agent) episode(ctx context.Context, client *nmes.Client, start nmes.Vector, draw *rand.Rand, daring float64) (float64, error) {
	rest := nmes.Vector{}
	placed := nmes.SetCubeState{CubeName: cube, Position: &start, Rotation: []float64{0, 0, 0}, LinearVelocity: &rest, AngularVelocity: &rest}
	if _, err := client.SetCubeState(ctx, placed); err != nil {
		return 0, err
	}
	seen, err := client.GetCubeState(ctx, nmes.GetCubeState{CubeName: cube})
	for range decisions {
		if err != nil {
			return 0, err
		}
		from, before := state(seen), distance(seen)
		action := a.best(from)
		if draw.Float64() < daring {
			action = draw.IntN(len(pushes))
		}
		// Three commands, one way there and back: act, step, observe.
		nmes.Send(client, nmes.ApplyPhysics{CubeName: cube, Impulse: &pushes[action]})
		nmes.Send(client, nmes.Step{Ticks: nmes.Ptr(ticks)})
		if seen, err = nmes.Send(client, nmes.GetCubeState{CubeName: cube}).Wait(ctx); err != nil {
			return 0, err
		}
		to := state(seen)
		worth := before - distance(seen) + discount*a[to][a.best(to)]
		if daring > 0 {
			a[from][action] += learning * (worth - a[from][action])
		}
	}
	return distance(seen), err
}

func measure(ctx context.Context, connect example.Connect) ([]example.Figure, error) {
	client, err := connect()
	if err != nil {
		return nil, err
	}
	defer client.Close()
	if err := example.Lockstep(ctx, client); err != nil {
		return nil, err
	}
	if _, err := client.SpawnCube(ctx, nmes.SpawnCube{CubeName: cube, Position: &nmes.Vector{0, 0.5, 0}, Friction: nmes.Ptr(0.2)}); err != nil {
		return nil, err
	}
	var learner agent
	draw := rand.New(rand.NewPCG(1, 2))
	for i := range episodes {
		start := nmes.Vector{8*draw.Float64() - 1, 0.5, 8*draw.Float64() - 6}
		if _, err := learner.episode(ctx, client, start, draw, 0.6*(1-float64(i)/episodes)+0.05); err != nil {
			return nil, err
		}
	}
	var begun, farthest float64
	for _, start := range []nmes.Vector{{0, 0.5, 0}, {6, 0.5, -5}, {0, 0.5, -5}, {5, 0.5, 1}} {
		ended, err := learner.episode(ctx, client, start, draw, 0)
		if err != nil {
			return nil, err
		}
		begun = math.Max(begun, math.Hypot(target[0]-start[0], target[2]-start[2]))
		farthest = math.Max(farthest, ended)
	}
	return []example.Figure{
		example.Known("distance at the start", begun, "m"),
		{Name: "final distance", Value: farthest, Unit: "m", AtLeast: 0, AtMost: 1.2},
	}, nil
}

func main() { example.Main(measure) }
