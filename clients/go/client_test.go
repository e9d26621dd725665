package nmes_test

import (
	"context"
	"errors"
	"fmt"
	"math"
	"os"
	"path/filepath"
	"strings"
	"sync"
	"testing"
	"time"

	"nmes"
	"nmes/internal/served"
)

const password = served.Password

var (
	server sync.Once
	host   *served.Host
	ports  chan int
)

func TestMain(m *testing.M) {
	code := m.Run()
	if host != nil {
		host.Stop()
	}
	os.Exit(code)
}

// world returns the address of a new world, of a server that all tests share.
func world(t testing.TB) string {
	t.Helper()
	server.Do(func() {
		host = served.Start(t, "--worlds", "32")
		ports = make(chan int, len(host.Ports))
		for _, port := range host.Ports {
			ports <- port
		}
	})
	if host == nil {
		t.Fatal("there is no server: the first test that asked for it says why")
	}
	return fmt.Sprintf("127.0.0.1:%d", <-ports)
}

func within(t testing.TB) context.Context {
	t.Helper()
	ctx, cancel := context.WithTimeout(context.Background(), time.Minute)
	t.Cleanup(cancel)
	return ctx
}

func enter(t testing.TB, address string) *nmes.Client {
	t.Helper()
	client, err := nmes.Dial(within(t), address, nmes.Options{Password: password})
	if err != nil {
		t.Fatal(err)
	}
	t.Cleanup(func() { client.Close() })
	return client
}

func lockstep(t testing.TB, client *nmes.Client) {
	t.Helper()
	if _, err := client.SetMode(within(t), nmes.SetMode{Mode: "lockstep"}); err != nil {
		t.Fatal(err)
	}
	if reset, err := client.Reset(within(t), nmes.Reset{}); err != nil { // it may have ticked by the clock
		t.Fatal(reset, err)
	}
}

func TestACubeIsSpawnedPushedAndRead(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	lockstep(t, client)
	if welcome := client.Welcome(); welcome.Dims != 3 || welcome.TickRate != 60 || welcome.World == "" {
		t.Fatalf("welcome %+v", welcome)
	}
	spawned, err := client.SpawnCube(ctx, nmes.SpawnCube{
		CubeName: "box", Position: &nmes.Vector{0, 50, 0}, Mass: nmes.Ptr(2.0), Size: []float64{0.5, 0.5, 0.5},
	})
	if err != nil || spawned.Spawned != "box" {
		t.Fatal(spawned, err)
	}
	if _, err := client.ApplyPhysics(ctx, nmes.ApplyPhysics{CubeName: "box", Impulse: &nmes.Vector{6, 0, 0}}); err != nil {
		t.Fatal(err)
	}
	if _, err := client.Step(ctx, nmes.Step{Ticks: nmes.Ptr(30)}); err != nil {
		t.Fatal(err)
	}
	info, err := client.GetCubeInfo(ctx, nmes.GetCubeInfo{CubeName: "box"})
	if err != nil {
		t.Fatal(err)
	}
	if math.Abs(info.LinearVelocity[0]-3) > 1e-6 || math.Abs(info.LinearVelocity[1]+9.81/2) > 0.05 || info.Mass != 2 {
		t.Fatalf("%+v", info)
	}
}

func TestAnEmptyListIsNotTheDefault(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	lockstep(t, client)
	for _, name := range []string{"one", "two"} {
		if _, err := client.SpawnCube(ctx, nmes.SpawnCube{CubeName: name}); err != nil {
			t.Fatal(err)
		}
	}
	all, err := client.GetWorldState(ctx, nmes.GetWorldState{})
	if err != nil || len(all.Cubes) != 2 {
		t.Fatal(all, err)
	}
	none, err := client.GetWorldState(ctx, nmes.GetWorldState{Cubes: []string{}})
	if err != nil || len(none.Cubes) != 0 {
		t.Fatal(none, err)
	}
	if _, err := client.SetObjective(ctx, nmes.SetObjective{Expression: "time", Cubes: []string{}}); !nmes.IsCode(err, "invalid") {
		t.Fatal("it is about the cube that was spawned last: ", err)
	}
	if _, err := client.Subscribe(ctx, nmes.Subscribe{Events: []string{}}); !nmes.IsCode(err, "invalid") {
		t.Fatal("it has subscribed to the usual events: ", err)
	}
}

func TestWhatTheServerRefusesIsAnErrorWithItsCode(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	_, err := client.GetCubeInfo(ctx, nmes.GetCubeInfo{CubeName: "nobody"})
	var refused *nmes.CommandError
	if !errors.As(err, &refused) || refused.Code != "cube_not_found" || refused.Field != "cube_name" {
		t.Fatal(err)
	}
	if _, err := client.SpawnCube(ctx, nmes.SpawnCube{Mass: nmes.Ptr(-1.0)}); !nmes.IsCode(err, "invalid") {
		t.Fatal(err)
	}
	if _, err := client.SpawnCube(ctx, nmes.SpawnCube{Mass: nmes.Ptr(math.NaN())}); err == nil {
		t.Fatal("a mass that is no number was sent")
	}
	if _, err := client.Ping(ctx); err != nil {
		t.Fatal("what could not be sent has put the rest out of step: ", err)
	}
}

func TestAWrongPasswordAndNobodyThereAreTold(t *testing.T) {
	address := world(t)
	_, err := nmes.Dial(within(t), address, nmes.Options{Password: "wrong"})
	if !nmes.IsCode(err, "auth_failed") {
		t.Fatal(err)
	}
	if _, err = nmes.Dial(within(t), "127.0.0.1:1", nmes.Options{Password: password}); !nmes.IsCode(err, "unreachable") {
		t.Fatal(err)
	}
	if _, err = nmes.Dial(within(t), address, nmes.Options{Password: password, World: "none"}); !nmes.IsCode(err, "world_not_found") {
		t.Fatal(err)
	}
}

func TestPipelinedCommandsActInOrder(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	lockstep(t, client)
	var frames []nmes.Pending[nmes.Stepped]
	for range 500 {
		frames = append(frames, nmes.Send(client, nmes.Step{}))
	}
	for i, pending := range frames {
		if stepped, err := pending.Wait(ctx); err != nil || stepped.Frame != i+1 {
			t.Fatal(i, stepped, err)
		}
	}
}

// A thousand goroutines over one connection: each finds its own replies, in the order in which it sent.
func TestManyGoroutinesShareAConnection(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	lockstep(t, client)
	var group sync.WaitGroup
	failures := make(chan error, 1000)
	for number := range 1000 {
		group.Add(1)
		go func() {
			defer group.Done()
			name := fmt.Sprintf("cube%d", number)
			place := nmes.Vector{float64(number%40) * 3, 1 + float64(number/40)*3, 7}
			made := nmes.Send(client, nmes.SpawnCube{CubeName: name, Position: &place, List: nmes.Ptr(false)})
			var infos []nmes.Pending[nmes.CubeState]
			for range 5 {
				infos = append(infos, nmes.Send(client, nmes.GetCubeState{CubeName: name}))
			}
			if spawned, err := made.Wait(ctx); err != nil || spawned.Spawned != name {
				failures <- fmt.Errorf("%s: %v %v", name, spawned, err)
				return
			}
			for _, pending := range infos {
				if info, err := pending.Wait(ctx); err != nil || info.CubeName != name || info.Position != place {
					failures <- fmt.Errorf("%s: %v %v", name, info, err)
					return
				}
			}
		}()
	}
	group.Wait()
	close(failures)
	for err := range failures {
		t.Fatal(err)
	}
	if list, err := client.GetCubeList(ctx); err != nil || len(list.Cubes) != 1000 {
		t.Fatal(len(list.Cubes), err)
	}
}

// Who waits for a reply reads, some give up meanwhile, others pipeline, and events come all the while: nothing is lost,
// and events are heard also where nobody waits.
func TestWhoeverReadsLosesNothing(t *testing.T) {
	const steps = 400
	address := world(t)
	ctx, client, other := within(t), enter(t, address), enter(t, address)
	lockstep(t, client)
	if _, err := client.Subscribe(ctx, nmes.Subscribe{Events: []string{"tick"}}); err != nil {
		t.Fatal(err)
	}
	heard := make(chan int, 2*steps)
	go func() {
		for event := range client.Events() {
			if tick, ok := event.(*nmes.TickEvent); ok {
				heard <- tick.Frame
			}
		}
		close(heard)
	}()
	var group sync.WaitGroup
	failures := make(chan error, 4)
	group.Add(2)
	go func() { // gives up on some
		defer group.Done()
		for i := range steps {
			short, cancel := context.WithTimeout(ctx, time.Duration(i%7)*30*time.Microsecond)
			if _, err := client.Ping(short); err != nil && !errors.Is(err, context.DeadlineExceeded) {
				failures <- err
			}
			cancel()
		}
	}()
	go func() { // pipelines
		defer group.Done()
		for range steps / 20 {
			var pings []nmes.Pending[nmes.Pong]
			for range 20 {
				pings = append(pings, nmes.Send(client, nmes.Ping{}))
			}
			for _, ping := range pings {
				if _, err := ping.Wait(ctx); err != nil {
					failures <- err
					return
				}
			}
			time.Sleep(200 * time.Microsecond)
		}
	}()
	for frame := 1; frame <= steps; frame++ {
		if stepped, err := client.Step(ctx, nmes.Step{}); err != nil || stepped.Frame != frame {
			t.Fatal(frame, stepped, err)
		}
	}
	group.Wait()
	close(failures)
	for err := range failures {
		t.Fatal(err)
	}
	for range 5 { // nobody waits for a reply on this connection any more
		if _, err := other.Step(ctx, nmes.Step{}); err != nil {
			t.Fatal(err)
		}
		time.Sleep(5 * time.Millisecond)
	}
	for frame := 1; frame <= steps+5; frame++ {
		select {
		case tick := <-heard:
			if tick != frame {
				t.Fatal(frame, tick)
			}
		case <-ctx.Done():
			t.Fatal("tick ", frame, " was not heard")
		}
	}
	client.Close()
	if _, more := <-heard; more {
		t.Fatal("events go on behind the end")
	}
}

func TestABatchHasAnOutcomeForEachCommand(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	lockstep(t, client)
	outcomes, err := client.Batch(ctx,
		nmes.SpawnCube{CubeName: "one"}, nmes.GetCubeState{CubeName: "none"}, nmes.Step{Ticks: nmes.Ptr(3)})
	if err != nil || len(outcomes) != 3 {
		t.Fatal(outcomes, err)
	}
	var list nmes.CubeList
	if err := outcomes[0].Into(&list); err != nil || list.Spawned != "one" {
		t.Fatal(list, err)
	}
	if err := outcomes[1].Into(&nmes.CubeState{}); !nmes.IsCode(err, "cube_not_found") {
		t.Fatal(err)
	}
	var stepped nmes.Stepped
	if err := outcomes[2].Into(&stepped); err != nil || stepped.Frame != 3 {
		t.Fatal(stepped, err)
	}
}

func TestEventsComeOverAChannelThatEndsWithTheConnection(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	lockstep(t, client)
	if _, err := client.Subscribe(ctx, nmes.Subscribe{Events: []string{"tick"}}); err != nil {
		t.Fatal(err)
	}
	if _, err := client.Step(ctx, nmes.Step{Ticks: nmes.Ptr(10)}); err != nil {
		t.Fatal(err)
	}
	events := client.Events()
	for frame := 1; frame <= 10; frame++ {
		switch event := (<-events).(type) {
		case *nmes.TickEvent:
			if event.Frame != frame {
				t.Fatalf("%d: %+v", frame, event)
			}
		default:
			t.Fatalf("%T", event)
		}
	}
	client.Close()
	if _, open := <-events; open || !nmes.IsCode(client.Err(), "closed") {
		t.Fatal(client.Err())
	}
	if _, err := client.Ping(ctx); !nmes.IsCode(err, "closed") {
		t.Fatal(err)
	}
}

func TestEventsThatNobodyReadsAreDroppedFromTheOldest(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	lockstep(t, client)
	if _, err := client.Subscribe(ctx, nmes.Subscribe{Events: []string{"tick"}}); err != nil {
		t.Fatal(err)
	}
	total := nmes.EventBacklog + 500
	for left := total; left > 0; left -= 2100 {
		if _, err := client.Step(ctx, nmes.Step{Ticks: nmes.Ptr(min(left, 2100))}); err != nil {
			t.Fatal(err)
		}
	}
	if first := (<-client.Events()).(*nmes.TickEvent); first.Frame != 501 || client.Dropped() != 500 {
		t.Fatal(first, client.Dropped())
	}
}

func TestWhoComesBackIsTheSamePlayer(t *testing.T) {
	config := filepath.Join(t.TempDir(), "config.json")
	secret := filepath.Join(t.TempDir(), "secret")
	for path, content := range map[string]string{config: `{"mode": "lockstep", "roles": {"player": {}}}`, secret: "play"} {
		if err := os.WriteFile(path, []byte(content), 0o600); err != nil {
			t.Fatal(err)
		}
	}
	host := served.Start(t, "--config", config, "--role", "player="+secret)
	t.Cleanup(host.Stop)
	address := fmt.Sprintf("127.0.0.1:%d", host.Ports[0])
	ctx := within(t)
	client, err := nmes.Dial(ctx, address, nmes.Options{Password: "play"})
	if err != nil {
		t.Fatal(err)
	}
	defer client.Close()
	if _, err := client.SpawnCube(ctx, nmes.SpawnCube{CubeName: "mine"}); err != nil {
		t.Fatal(err)
	}
	before := *client.Welcome().Player
	if err := client.Reconnect(ctx); err != nil {
		t.Fatal(err)
	}
	if after := *client.Welcome().Player; after != before {
		t.Fatalf("player %d came back as %d", before, after)
	}
	if _, err := client.DespawnCube(ctx, nmes.DespawnCube{CubeName: "mine"}); err != nil {
		t.Fatal(err)
	}
	other, err := nmes.Dial(ctx, address, nmes.Options{Password: "play"})
	if err != nil || *other.Welcome().Player == before {
		t.Fatal(other, err)
	}
	defer other.Close()
}

// Goroutines that share a client find together that its connection is lost.
func TestThoseWhoReconnectAtOnceLeaveOneConnection(t *testing.T) {
	address := world(t)
	ctx, client, other := within(t), enter(t, address), enter(t, address)
	client.Close()
	var group sync.WaitGroup
	failures := make(chan error, 8)
	for range cap(failures) {
		group.Add(1)
		go func() {
			defer group.Done()
			failures <- client.Reconnect(ctx)
		}()
	}
	group.Wait()
	close(failures)
	for err := range failures {
		if err != nil {
			t.Fatal(err)
		}
	}
	if _, err := client.Ping(ctx); err != nil {
		t.Fatal(err)
	}
	client.Close()
	for {
		info, err := other.GetWorldInfo(ctx) // until the server has noticed
		if err != nil {
			t.Fatal("connections are left open: ", err)
		}
		if info.Counts.Clients == 1 {
			return
		}
	}
}

func TestAContextThatEndsLeavesTheConnectionGood(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	lockstep(t, client)
	short, cancel := context.WithCancel(ctx)
	long := nmes.Send(client, nmes.Step{Ticks: nmes.Ptr(10_000)})
	cancel()
	if _, err := long.Wait(short); !errors.Is(err, context.Canceled) {
		t.Fatal(err)
	}
	if _, err := client.Ping(ctx); err != nil {
		t.Fatal(err)
	}
	if stepped, err := long.Wait(ctx); err != nil || stepped.Frame != 10_000 {
		t.Fatal(stepped, err)
	}
}

func TestStringsThatHoldTheDelimiterAreSentEscaped(t *testing.T) {
	ctx, client := within(t), enter(t, world(t))
	_, err := client.GetCubeState(ctx, nmes.GetCubeState{CubeName: "a<???DONE???---b"})
	if !nmes.IsCode(err, "cube_not_found") || !strings.Contains(err.Error(), "<???DONE???---") {
		t.Fatal(err)
	}
}

func TestTheOriginalDialectIsSilentWhereItWas(t *testing.T) {
	ctx, address := within(t), world(t)
	old, err := nmes.DialOriginal(ctx, address, password, nil)
	if err != nil {
		t.Fatal(err)
	}
	defer old.Close()
	if err := old.Tell(map[string]any{"type": "spawn_cube", "cube_name": "old", "position": []int{0, 3, 0}}); err != nil {
		t.Fatal(err)
	}
	answer, err := old.Ask(ctx, map[string]any{"type": "get_cube_list"})
	if err != nil || !strings.Contains(string(answer), `"old"`) {
		t.Fatal(string(answer), err)
	}
	if _, err := nmes.DialOriginal(ctx, address, "wrong", nil); !nmes.IsCode(err, "auth_failed") {
		t.Fatal(err)
	}
}
