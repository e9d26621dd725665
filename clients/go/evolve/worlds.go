package evolve

import (
	"context"
	"fmt"

	"nmes"
	"nmes/genome"
)

// HorizontalDistance is what a creature is worth unless another objective is asked for: how far it has gone, m.
const HorizontalDistance = "displacement.horizontal"

const (
	usualTicks = 600
	mostTicks  = 10_000 // that one command may ask for
)

// Worlds are worlds of a host, in lockstep, in each of which one creature lives at a time.
type Worlds struct {
	// For how many ticks a creature lives; 600, which is ten seconds at 60 a second, if 0.
	Ticks int
	// What it is worth then, as docs/objectives.md tells; HorizontalDistance if empty.
	Objective string

	free    chan *nmes.Client
	clients []*nmes.Client
}

// Enter enters worlds of a host, and makes them tick by command; from then on they are for creatures that are scored.
// They must be equal but for their names, or what a creature is worth would depend on where it lived.
func Enter(ctx context.Context, address string, names []string, options nmes.Options) (*Worlds, error) {
	w := &Worlds{free: make(chan *nmes.Client, len(names))}
	for _, name := range names {
		options.World = name
		client, err := nmes.Dial(ctx, address, options)
		if err == nil {
			w.clients = append(w.clients, client)
			w.free <- client
			_, err = client.SetMode(ctx, nmes.SetMode{Mode: "lockstep"})
		}
		if err != nil {
			w.Close()
			return nil, fmt.Errorf("evolve: world %s: %w", name, err)
		}
	}
	return w, nil
}

// Close leaves the worlds.
func (w *Worlds) Close() {
	for _, client := range w.clients {
		client.Close()
	}
}

// Score lets a creature live in a world of its own, which begins anew for it, and returns what it is worth at the end.
// Where more goroutines ask than there are worlds, the others wait.
func (w *Worlds) Score(ctx context.Context, creature *genome.Genome) (float64, error) {
	select {
	case world := <-w.free:
		defer func() { w.free <- world }()
		return w.live(ctx, world, creature)
	case <-ctx.Done():
		return 0, ctx.Err()
	}
}

func (w *Worlds) live(ctx context.Context, world *nmes.Client, creature *genome.Genome) (float64, error) {
	const name = "candidate"
	if _, err := world.Reset(ctx, nmes.Reset{Seed: nmes.Ptr(0)}); err != nil {
		return 0, err
	}
	if _, err := world.SpawnCreature(ctx, nmes.SpawnCreature{Genome: creature, Name: name, Autonomous: true}); err != nil {
		return 0, err
	}
	objective, ticks := w.Objective, w.Ticks
	if objective == "" {
		objective = HorizontalDistance
	}
	if ticks == 0 {
		ticks = usualTicks
	}
	if _, err := world.SetObjective(ctx, nmes.SetObjective{Expression: objective, Creature: name}); err != nil {
		return 0, err
	}
	for ; ticks > 0; ticks -= mostTicks {
		if _, err := world.Step(ctx, nmes.Step{Ticks: nmes.Ptr(min(ticks, mostTicks))}); err != nil {
			return 0, err
		}
	}
	reward, err := world.ComputeReward(ctx, nmes.ComputeReward{})
	if err != nil {
		return 0, err
	}
	return reward.Value, nil
}
