// Command bench measures this client: started with the port of a world, it reads what to do and how often, a line each
// (pipelined 20000, shared 20000, trips 300), and writes how many seconds that took.
package main

import (
	"context"
	"fmt"
	"log"
	"os"
	"sync"
	"time"

	"nmes"
)

const (
	onTheirWay = 1000 // commands at once
	goroutines = 1000
	first      = 2 // the number of the first goroutine: pushes of 1 are those of the others
)

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
		switch what {
		case "trips":
			trips(ctx, client, count)
		case "shared":
			shared(ctx, client, count)
		default:
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

// shared has many goroutines pipeline over the one connection. Each pushes with its number along x, and along y with how
// many commands it has sent, so that a recording tells whether they came whole and in order.
func shared(ctx context.Context, client *nmes.Client, count int) {
	var group sync.WaitGroup
	for number := range goroutines {
		group.Add(1)
		go func() {
			defer group.Done()
			sent := make([]nmes.Pending[nmes.PhysicsApplied], count/goroutines)
			for i := range sent {
				force := nmes.Vector{float64(first + number), float64(i), 0}
				sent[i] = nmes.Send(client, nmes.ApplyPhysics{CubeName: "box", Force: &force})
			}
			for _, each := range sent {
				_, err := each.Wait(ctx)
				must(err)
			}
		}()
	}
	group.Wait()
}

func push() nmes.ApplyPhysics {
	return nmes.ApplyPhysics{CubeName: "box", Force: &nmes.Vector{1, 0, 0}}
}

func must(err error) {
	if err != nil {
		log.Fatal(err)
	}
}
