package fleet_test

import (
	"context"
	"errors"
	"fmt"
	"net"
	"strings"
	"sync"
	"testing"
	"time"

	"nmes"
	"nmes/fleet"
	"nmes/internal/served"
)

var options = nmes.Options{Password: served.Password}

func within(t testing.TB) context.Context {
	t.Helper()
	ctx, cancel := context.WithTimeout(context.Background(), time.Minute)
	t.Cleanup(cancel)
	return ctx
}

// start starts a host without recordings, and returns its address.
func start(t *testing.T, given ...string) string {
	t.Helper()
	host := served.Start(t, append(given, "--backend", "ballistic", "--mode", "lockstep", "--no-record")...)
	t.Cleanup(host.Stop)
	return fmt.Sprintf("127.0.0.1:%d", host.Ports[0])
}

// silent returns the address of what takes connections and says nothing.
func silent(t *testing.T) string {
	t.Helper()
	listener, err := net.Listen("tcp", "127.0.0.1:0")
	if err != nil {
		t.Fatal(err)
	}
	t.Cleanup(func() { listener.Close() })
	return listener.Addr().String()
}

func TestAFleetIsScannedAndWorldsAreAllocated(t *testing.T) {
	ctx := within(t)
	small, large := start(t, "--max-worlds", "3"), start(t, "--worlds", "2")
	hosts := []string{small, large}
	t.Run("a scan tells of each host", func(t *testing.T) {
		closed, err := net.Listen("tcp", "127.0.0.1:0")
		if err != nil {
			t.Fatal(err)
		}
		closed.Close()
		client, err := nmes.Dial(ctx, large, options)
		if err != nil {
			t.Fatal(err)
		}
		defer client.Close()
		soon, cancel := context.WithTimeout(ctx, 2*time.Second)
		defer cancel()
		statuses := fleet.Scan(soon, []string{large, closed.Addr().String(), silent(t), small}, options)
		if found := statuses[0]; found.Err != nil || len(found.Worlds) != 2 || found.Awake() != 1 || found.Clients() != 1 || found.Host != large {
			t.Errorf("%+v", found)
		}
		if !nmes.IsCode(statuses[1].Err, "unreachable") {
			t.Error(statuses[1].Err)
		}
		if !errors.Is(statuses[2].Err, context.DeadlineExceeded) {
			t.Error(statuses[2].Err)
		}
		if found := statuses[3]; found.Err != nil || len(found.Worlds) != 1 || found.Asleep() != 0 || found.Faulted() != nil {
			t.Errorf("%+v", found)
		}
		if lagging, slowest := statuses[0].Lagging(); lagging != 0 || slowest != 1 {
			t.Error(lagging, slowest)
		}
		wrong := fleet.Scan(ctx, []string{small}, nmes.Options{Password: "wrong"})
		if !nmes.IsCode(wrong[0].Err, "auth_failed") {
			t.Error(wrong[0].Err)
		}
	})
	t.Run("a new world goes where the fewest are awake, and is found again", func(t *testing.T) {
		for i, host := range []string{small, large} { // of equal hosts the first; then the one that has none awake
			name := fmt.Sprintf("new-%d", i)
			place, err := fleet.Allocate(ctx, hosts, options, nmes.NewWorld{World: name, Seed: nmes.Ptr(7)})
			if err != nil || !place.Created || place.Host != host {
				t.Fatal(place, err)
			}
			client, err := place.Dial(ctx)
			if err != nil {
				t.Fatal(err)
			}
			defer client.Close()
			if info, err := client.GetWorldInfo(ctx); err != nil || info.World != name || info.Seed != 7 {
				t.Fatal(info, err)
			}
			again, err := fleet.Allocate(ctx, hosts, options, nmes.NewWorld{World: name})
			if err != nil || again.Created || again.Host != host {
				t.Fatal(again, err)
			}
		}
	})
	t.Run("a full host is passed over", func(t *testing.T) {
		places := map[string]int{}
		for i := range 4 { // the small host has two, and room for one
			place, err := fleet.Allocate(ctx, hosts, options, nmes.NewWorld{World: fmt.Sprintf("more-%d", i)})
			if err != nil {
				t.Fatal(err)
			}
			places[place.Host]++
		}
		if places[small] != 1 || places[large] != 3 {
			t.Error(places)
		}
	})
	t.Run("why no host takes a world is told of each", func(t *testing.T) {
		_, err := fleet.Allocate(ctx, hosts, options, nmes.NewWorld{World: "x", Template: "no-such"})
		if !nmes.IsCode(err, "template_not_found") || strings.Count(err.Error(), "\n") != 2 || !strings.Contains(err.Error(), large) {
			t.Error(err)
		}
		_, err = fleet.Allocate(ctx, []string{small}, options, nmes.NewWorld{World: "x"})
		var none *fleet.Unallocated
		if !errors.As(err, &none) || !nmes.IsCode(err, "limit_reached") {
			t.Error(err)
		}
	})
	t.Run("many who want the same world at once get one", func(t *testing.T) {
		var waiting sync.WaitGroup
		created := make(chan bool, 16)
		for range cap(created) {
			waiting.Add(1)
			go func() {
				defer waiting.Done()
				place, err := fleet.Allocate(ctx, []string{large}, options, nmes.NewWorld{World: "shared"})
				if err != nil {
					t.Error(err)
					return
				}
				created <- place.Created
			}()
		}
		waiting.Wait()
		close(created)
		creators := 0
		for is := range created {
			if is {
				creators++
			}
		}
		if creators != 1 {
			t.Errorf("%d created it", creators)
		}
	})
	t.Run("a world is closed for good", func(t *testing.T) {
		if err := nmes.CloseWorld(ctx, large, options, "shared"); err != nil {
			t.Fatal(err)
		}
		worlds, err := nmes.Worlds(ctx, large, options)
		for _, world := range worlds {
			if world.World == "shared" {
				t.Error("it is still there")
			}
		}
		if err != nil {
			t.Error(err)
		}
		if _, err := nmes.CreateWorld(ctx, large, options, nmes.NewWorld{World: "new-1"}); !nmes.IsCode(err, "world_exists") {
			t.Error(err)
		}
	})
}
