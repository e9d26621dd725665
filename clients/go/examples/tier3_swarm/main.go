// Tier 3, many agents: five connections drive their cubes apart, each in a goroutine of its own; then a sixth one's heavy
// cube hunts them down and rams each. They see each other through the world alone.
package main

import (
	"context"
	"errors"
	"math"

	"nmes"
	"nmes/examples/internal/example"
)

const (
	swarm       = 5
	apart       = 4.0       // m from the middle
	flee, hunt  = 120, 1200 // ticks
	push        = 8.0       // N at most, on a cube of 1 kg
	hunterMass  = 5.0       // kg
	hunterPush  = 120.0     // N at most
	hunterSpeed = 6.0       // m/s
)

// limited returns a force along the ground, shortened to the most there may be.
func limited(x, z, most float64) *nmes.Vector {
	factor := math.Min(1, most/math.Max(math.Hypot(x, z), 1e-9))
	return &nmes.Vector{factor * x, 0, factor * z}
}

// agent drives one cube.
type agent struct {
	client *nmes.Client
	cube   string
}

// spawn returns an agent with a cube.
func spawn(ctx context.Context, connect example.Connect, cube nmes.SpawnCube) (*agent, error) {
	client, err := connect()
	if err != nil {
		return nil, err
	}
	cube.List = nmes.Ptr(false)
	spawned, err := client.SpawnCube(ctx, cube)
	if err != nil {
		client.Close()
		return nil, err
	}
	return &agent{client, spawned.Spawned}, nil
}

// flee looks where all are, and pushes its cube away from the middle of them.
func (a *agent) flee(ctx context.Context, all []string) error {
	state, err := a.client.GetWorldState(ctx, nmes.GetWorldState{Cubes: all})
	if err != nil {
		return err
	}
	x, z := middle(state.Cubes)
	for _, cube := range state.Cubes {
		if cube.CubeName == a.cube {
			x, z := cube.Position[0]-x, cube.Position[2]-z
			radius := math.Hypot(x, z)
			pull := 12 * (apart - radius) / radius
			force := limited(pull*x-6*cube.LinearVelocity[0], pull*z-6*cube.LinearVelocity[2], push)
			_, err = a.client.ApplyPhysics(ctx, nmes.ApplyPhysics{Force: force}) // who owns one cube need not name it
		}
	}
	return err
}

// chase pushes its cube to the nearest one that it has not rammed yet, and notes which it has.
func (a *agent) chase(ctx context.Context, prey []string, rammed map[string]bool) error {
	state, err := a.client.GetWorldState(ctx, nmes.GetWorldState{Cubes: prey})
	if err != nil {
		return err
	}
	info, err := a.client.GetCubeInfo(ctx, nmes.GetCubeInfo{CubeName: a.cube})
	if err != nil {
		return err
	}
	for _, touch := range info.Contacts {
		for _, name := range prey {
			if touch.CubeName != nil && *touch.CubeName == name {
				rammed[name] = true
			}
		}
	}
	wayX, wayZ := math.Inf(1), math.Inf(1)
	for _, cube := range state.Cubes {
		x, z := cube.Position[0]-info.Position[0], cube.Position[2]-info.Position[2]
		if !rammed[cube.CubeName] && math.Hypot(x, z) < math.Hypot(wayX, wayZ) {
			wayX, wayZ = x, z
		}
	}
	if len(rammed) == len(prey) {
		return nil
	}
	speed := hunterSpeed / math.Hypot(wayX, wayZ)
	force := limited(40*(speed*wayX-info.LinearVelocity[0]), 40*(speed*wayZ-info.LinearVelocity[2]), hunterPush)
	nmes.Send(a.client, nmes.ApplyPhysics{Force: force})
	_, err = a.client.Step(ctx, nmes.Step{})
	return err
}

func middle(cubes []nmes.WorldStateCubes) (x, z float64) {
	for _, cube := range cubes {
		x += cube.Position[0] / float64(len(cubes))
		z += cube.Position[2] / float64(len(cubes))
	}
	return x, z
}

// spread returns how far cubes are from their middle on average.
func spread(cubes []nmes.WorldStateCubes) (mean float64) {
	x, z := middle(cubes)
	for _, cube := range cubes {
		mean += math.Hypot(cube.Position[0]-x, cube.Position[2]-z) / float64(len(cubes))
	}
	return mean
}

func measure(ctx context.Context, connect example.Connect) ([]example.Figure, error) {
	leader, err := connect()
	if err != nil {
		return nil, err
	}
	defer leader.Close()
	if err := example.Lockstep(ctx, leader); err != nil {
		return nil, err
	}
	var agents [swarm]*agent
	names := []string{}
	for i := range agents {
		angle := 2 * math.Pi * float64(i) / swarm
		position := nmes.Vector{1.2 * math.Cos(angle), 0.5, 1.2 * math.Sin(angle)}
		if agents[i], err = spawn(ctx, connect, nmes.SpawnCube{Position: &position, Friction: nmes.Ptr(0.1)}); err != nil {
			return nil, err
		}
		defer agents[i].client.Close()
		names = append(names, agents[i].cube)
	}
	crowded, err := leader.GetWorldState(ctx, nmes.GetWorldState{Cubes: names})
	if err != nil {
		return nil, err
	}
	for range flee { // in each tick all of them at once, in whatever order
		done := make(chan error, swarm)
		for _, each := range agents {
			go func() { done <- each.flee(ctx, names) }()
		}
		for range agents {
			err = errors.Join(err, <-done)
		}
		if err != nil {
			return nil, err
		}
		if _, err = leader.Step(ctx, nmes.Step{}); err != nil {
			return nil, err
		}
	}
	driven, err := leader.GetWorldState(ctx, nmes.GetWorldState{Cubes: names})
	if err != nil {
		return nil, err
	}
	hunter, err := spawn(ctx, connect, nmes.SpawnCube{Position: &nmes.Vector{0, 0.5, 0}, Mass: nmes.Ptr(hunterMass), Friction: nmes.Ptr(0.1)})
	if err != nil {
		return nil, err
	}
	defer hunter.client.Close()
	rammed := map[string]bool{}
	for tick := 0; tick < hunt && len(rammed) < swarm; tick++ {
		if err := hunter.chase(ctx, names, rammed); err != nil {
			return nil, err
		}
	}
	return []example.Figure{
		example.Known("spread at the start", spread(crowded.Cubes), "m"),
		{Name: "spread once driven apart", Value: spread(driven.Cubes), Unit: "m", AtLeast: 3, AtMost: 5},
		{Name: "cubes rammed", Value: float64(len(rammed)), AtLeast: swarm, AtMost: swarm},
	}, nil
}

func main() { example.Main(measure) }
