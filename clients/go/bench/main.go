// Command bench measures this client: started with the port of a world, it reads what to do and how often, a line each
// (pipelined 20000, trips 300), and writes how many seconds that took.
package main

import (
	"context"
	"fmt"
	"log"
	"os"
	"time"

	"nmes"
)

const onTheirWay = 1000 // commands at once

func main() {
	ctx := context.Background()
	client, err := nmes.Dial(ctx, "127.0.0.1:"+os.Args[1], nmes.Options{})
	must(err)
	_, err = client.SetMode(ctx, nmes.SetMode{Mode: "lockstep"})
	must(err)
	_, err = client.SpawnCube(ctx, nmes.SpawnCube{CubeName: "box"})
	must(err)
	for {
		var what string
		var count int
		if _, err := fmt.Scan(&what, &count); err != nil {
			return
		}
		began := time.Now()
		if what == "trips" {
			trips(ctx, client, count)
		} else {
			pipelined(ctx, client, count)
		}
		fmt.Println(time.Since(began).Seconds())
	}
}

// trips pushes a cube, lets the world tick and reads the cube; each reply is waited for, as a controller does.
func trips(ctx context.Context, client *nmes.Client, count int) {
	for range count {
		_, err := client.ApplyPhysics(ctx, push())
		must(err)
		_, err = client.Step(ctx, nmes.Step{})
		must(err)
		_, err = client.GetCubeState(ctx, nmes.GetCubeState{CubeName: "box"})
		must(err)
	}
}

func pipelined(ctx context.Context, client *nmes.Client, count int) {
	ring := make([]nmes.Pending[nmes.PhysicsApplied], min(count, onTheirWay))
	for i := range count {
		place := &ring[i%len(ring)]
		if i >= len(ring) {
			_, err := place.Wait(ctx)
			must(err)
		}
		*place = nmes.Send(client, push())
	}
	for _, each := range ring {
		_, err := each.Wait(ctx)
		must(err)
	}
}

func push() nmes.ApplyPhysics {
	return nmes.ApplyPhysics{CubeName: "box", Force: &nmes.Vector{1, 0, 0}}
}

func must(err error) {
	if err != nil {
		log.Fatal(err)
	}
}
