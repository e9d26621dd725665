package nmes_test

import (
	"testing"

	"nmes"
)

// One cube is pushed, the world ticks, and the cube is read: three replies are waited for, as a controller does.
func BenchmarkActStepObserve(b *testing.B) {
	ctx, client := within(b), enter(b, world(b))
	lockstep(b, client)
	if _, err := client.SpawnCube(ctx, nmes.SpawnCube{CubeName: "box"}); err != nil {
		b.Fatal(err)
	}
	for b.Loop() {
		_, err := client.ApplyPhysics(ctx, nmes.ApplyPhysics{CubeName: "box", Force: &nmes.Vector{1, 0, 0}})
		if err == nil {
			_, err = client.Step(ctx, nmes.Step{})
		}
		if err == nil {
			_, err = client.GetCubeState(ctx, nmes.GetCubeState{CubeName: "box"})
		}
		if err != nil {
			b.Fatal(err)
		}
	}
}

// The same command many times, 1,000 on their way at once.
func BenchmarkPipelined(b *testing.B) {
	ctx, client := within(b), enter(b, world(b))
	lockstep(b, client)
	if _, err := client.SpawnCube(ctx, nmes.SpawnCube{CubeName: "box"}); err != nil {
		b.Fatal(err)
	}
	ring := make([]nmes.Pending[nmes.PhysicsApplied], 1000)
	sent := 0
	for b.Loop() {
		if place := &ring[sent%len(ring)]; sent < len(ring) {
			*place = nmes.Send(client, nmes.ApplyPhysics{CubeName: "box", Force: &nmes.Vector{1, 0, 0}})
		} else {
			if _, err := place.Wait(ctx); err != nil {
				b.Fatal(err)
			}
			*place = nmes.Send(client, nmes.ApplyPhysics{CubeName: "box", Force: &nmes.Vector{1, 0, 0}})
		}
		sent++
	}
}
