// Tier 2, one structure that moves: a pole of four cubes on a frozen base is pushed, and falls; an evolution strategy
// finds how strong its motors must be, and how hard they must steer, for it to stay up.
package main

import (
	"context"
	"math"
	"math/rand/v2"

	"nmes"
	"nmes/examples/internal/example"
)

const (
	edge, spacing = 0.4, 0.5 // m: the hinges sit in the gaps
	joints        = 4
	ticks         = 4 // between decisions
	decisions     = 30
	generations   = 5
	children      = 5
)

// genome is what is evolved: how fast motors go for each rad that a joint is bent, 1/s, and their strength, N m.
type genome struct{ gain, strength float64 }

// trial builds a pole, pushes it, steers it for two seconds, and returns how high its tip was on average, of upright.
func trial(ctx context.Context, client *nmes.Client, genes genome) (float64, error) {
	if _, err := client.Reset(ctx, nmes.Reset{}); err != nil {
		return 0, err
	}
	below, names := "", []string{}
	var bent [joints]float64
	for i := range joints + 1 {
		y := edge/2 + spacing*float64(i)
		cube, err := client.SpawnCube(ctx, nmes.SpawnCube{
			Position: &nmes.Vector{0, y, 0}, Size: []float64{edge, edge, edge}, Mass: nmes.Ptr(0.5), IsBase: i == 0, List: nmes.Ptr(false),
		})
		if err != nil {
			return 0, err
		}
		if i > 0 {
			hinge, err := client.CreateJoint(ctx, nmes.CreateJoint{
				Cube1: below, Cube2: cube.Spawned, JointType: "hinge", Position: &nmes.Vector{0, y - spacing/2, 0},
				Axis: &nmes.Vector{0, 0, 1}, MotorMaxForce: &genes.strength, MotorTargetVelocity: nmes.Ptr(0.0),
			})
			if err != nil {
				return 0, err
			}
			names = append(names, hinge.JointName)
		}
		below = cube.Spawned
	}
	if _, err := client.ApplyPhysics(ctx, nmes.ApplyPhysics{CubeName: below, Impulse: &nmes.Vector{0.3, 0, 0}}); err != nil {
		return 0, err
	}
	height := 0.0
	for range decisions {
		for i, name := range names {
			nmes.Send(client, nmes.SetJointParam{JointName: name, ParamName: "motor_target_velocity", Value: -genes.gain * bent[i]})
		}
		nmes.Send(client, nmes.Step{Ticks: nmes.Ptr(ticks)})
		var readings [joints]nmes.Pending[nmes.JointInfo]
		for i, name := range names {
			readings[i] = nmes.Send(client, nmes.GetJointInfo{JointName: name})
		}
		tip, err := nmes.Send(client, nmes.GetCubeState{CubeName: below}).Wait(ctx)
		if err != nil {
			return 0, err
		}
		for i, reading := range readings {
			info, err := reading.Wait(ctx)
			if err != nil {
				return 0, err
			}
			bent[i] = info.Position
		}
		height += tip.Position[1] / (edge/2 + spacing*joints) / decisions
	}
	return height, nil
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
	best := genome{gain: 0, strength: 0.05}
	first, err := trial(ctx, client, best)
	if err != nil {
		return nil, err
	}
	score, draw := first, rand.New(rand.NewPCG(3, 4))
	for range generations {
		parent := best
		for range children {
			child := genome{math.Abs(parent.gain + 3*draw.NormFloat64()), parent.strength * math.Exp(1.5*draw.NormFloat64())}
			height, err := trial(ctx, client, child)
			if err != nil {
				return nil, err
			}
			if height > score {
				best, score = child, height
			}
		}
	}
	return []example.Figure{
		{Name: "height at first", Value: first, AtLeast: 0, AtMost: 0.8},
		{Name: "height once evolved", Value: score, AtLeast: 0.95, AtMost: 1.01},
		example.Known("gain", best.gain, "1/s"),
		example.Known("strength", best.strength, "N m"),
	}, nil
}

func main() { example.Main(measure) }
