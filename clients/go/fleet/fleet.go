// Package fleet sees how many hosts fare, and finds or creates worlds on them.
//
//	for _, status := range fleet.Scan(ctx, hosts, options) { ... }
//	place, err := fleet.Allocate(ctx, hosts, options, nmes.NewWorld{World: "red", Template: "arena"})
//	client, err := place.Dial(ctx)
package fleet

import (
	"cmp"
	"context"
	"errors"
	"fmt"
	"slices"
	"strings"
	"sync"
	"time"

	"nmes"
)

// AtOnce is how many hosts are asked at the same time.
const AtOnce = 64

// Timeout is how long one host may take to answer, counted from when it is asked.
const Timeout = 10 * time.Second

// Status is how a host fares.
type Status struct {
	// Its address, HOST:PORT.
	Host string
	// Why it is not known how it fares; nil: it is.
	Err error
	// Its worlds that the password opens, its first one first.
	Worlds []nmes.WorldListWorlds
}

// Awake returns how many worlds are live and do not hibernate.
func (s Status) Awake() int {
	return s.count(func(world nmes.WorldListWorlds) bool { return world.Frame != nil && !asleep(world) })
}

// Asleep returns how many worlds hibernate; nobody has used the others yet.
func (s Status) Asleep() int { return s.count(asleep) }

// Clients returns how many connections are in all worlds.
func (s Status) Clients() (clients int) {
	for _, world := range s.Worlds {
		clients += world.Clients
	}
	return clients
}

// Lagging returns how many worlds fall behind the clock, and how fast the slowest of these runs, as a part of the pace
// asked for; 1 where all keep up.
func (s Status) Lagging() (worlds int, slowest float64) {
	slowest = 1
	for _, world := range s.Worlds {
		if world.Ratio != nil {
			worlds, slowest = worlds+1, min(slowest, *world.Ratio)
		}
	}
	return worlds, slowest
}

// Faulted returns the names of the worlds that a fault has stopped.
func (s Status) Faulted() (names []string) {
	for _, world := range s.Worlds {
		if world.Fault != nil {
			names = append(names, world.World)
		}
	}
	return names
}

func (s Status) count(is func(nmes.WorldListWorlds) bool) (count int) {
	for _, world := range s.Worlds {
		if is(world) {
			count++
		}
	}
	return count
}

func (s Status) has(name string) bool {
	return s.count(func(world nmes.WorldListWorlds) bool { return world.World == name }) > 0
}

func asleep(world nmes.WorldListWorlds) bool { return world.Asleep != nil && *world.Asleep }

// Scan asks hosts for their worlds, side by side, and returns how they fare, in their order. No world is created, entered
// or woken. A host that does not answer within Timeout, or before the context ends, is no failure of the others.
func Scan(ctx context.Context, hosts []string, options nmes.Options) []Status {
	statuses := make([]Status, len(hosts))
	places := make(chan struct{}, AtOnce)
	var asked sync.WaitGroup
	for i, host := range hosts {
		places <- struct{}{}
		asked.Add(1)
		go func() {
			defer asked.Done()
			defer func() { <-places }()
			within, cancel := context.WithTimeout(ctx, Timeout)
			defer cancel()
			worlds, err := nmes.Worlds(within, host, options)
			if ctx.Err() == nil && errors.Is(err, context.DeadlineExceeded) {
				err = fmt.Errorf("no answer within %v: %w", Timeout, err)
			}
			statuses[i] = Status{host, err, worlds}
		}()
	}
	asked.Wait()
	return statuses
}

// Place is where a world is.
type Place struct {
	// The address of its host.
	Host string
	// Its name there.
	World string
	// Whether it was created just now.
	Created bool

	options nmes.Options
}

// Dial enters the world.
func (p *Place) Dial(ctx context.Context) (*nmes.Client, error) {
	options := p.options
	options.World = p.World
	return nmes.Dial(ctx, p.Host, options)
}

// Unallocated is why no host has, or took, a world: of each host the reason, in the order in which they were asked.
type Unallocated struct {
	World   string
	Hosts   []string
	Reasons []error
}

func (u *Unallocated) Error() string {
	lines := []string{fmt.Sprintf("fleet: no host has the world %q, and none took it", u.World)}
	for i, host := range u.Hosts {
		lines = append(lines, fmt.Sprintf("%s: %v", host, u.Reasons[i]))
	}
	return strings.Join(lines, "\n")
}

// Unwrap returns the reasons.
func (u *Unallocated) Unwrap() []error { return u.Reasons }

// Allocate finds a world by its name on one of the hosts, or creates it on the one with the fewest awake worlds; of
// equal ones the one with the fewest clients, then the first. Where a host does not take it (limit_reached,
// host_draining, ...), the next one is asked. The password must be one that may create worlds there.
//
// A name is unique on a host, not in a fleet: a host that does not answer may have the world too, and so may another
// program have created it elsewhere at the same moment.
func Allocate(ctx context.Context, hosts []string, options nmes.Options, wanted nmes.NewWorld) (*Place, error) {
	failed := &Unallocated{World: wanted.World}
	var open []Status
	for _, status := range Scan(ctx, hosts, options) {
		if status.Err != nil {
			failed.add(status.Host, status.Err)
			continue
		}
		if status.has(wanted.World) {
			return &Place{Host: status.Host, World: wanted.World, options: options}, nil
		}
		open = append(open, status)
	}
	slices.SortStableFunc(open, func(a, b Status) int {
		return cmp.Or(cmp.Compare(a.Awake(), b.Awake()), cmp.Compare(a.Clients(), b.Clients()))
	})
	for _, status := range open {
		_, err := nmes.CreateWorld(ctx, status.Host, options, wanted)
		// Another program may have created it since, or somebody whose worlds this password does not open.
		taken := nmes.IsCode(err, "world_exists") && Scan(ctx, []string{status.Host}, options)[0].has(wanted.World)
		if err == nil || taken {
			return &Place{Host: status.Host, World: wanted.World, Created: !taken, options: options}, nil
		}
		if failed.add(status.Host, err); ctx.Err() != nil {
			break
		}
	}
	return nil, failed
}

func (u *Unallocated) add(host string, reason error) {
	u.Hosts, u.Reasons = append(u.Hosts, host), append(u.Reasons, reason)
}
