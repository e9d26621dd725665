// Package evolve is a small genetic algorithm: tournaments choose parents, the best of a generation live on, and all
// others are mutants. Each candidate lives in a world of its own, on any number of goroutines.
//
//	worlds, err := evolve.Enter(ctx, "127.0.0.1:14000", names, nmes.Options{})
//	...
//	defer worlds.Close()
//	result, err := evolve.Run(ctx, founders, worlds.Score, evolve.Options{Seed: 7, Goroutines: len(names)})
//
// What comes out follows from the founders, the options and the scores alone: choices are drawn for each candidate by
// itself, so it does not matter how many goroutines there are and which of them is done first.
package evolve

import (
	"cmp"
	"context"
	"crypto/sha256"
	"encoding/hex"
	"errors"
	"fmt"
	"hash"
	"math"
	"slices"
	"sync"

	"nmes"
	"nmes/genome"
)

// Options say how to evolve. What is 0 has a default.
type Options struct {
	// Of all that is drawn.
	Seed int64
	// How many candidates a generation has; 100.
	Population int
	// How many generations; 10.
	Generations int
	// How many of the best live on as they are; 1 in 20 of the population, at least one.
	Elites int
	// Of how many candidates the best becomes a parent; 3. One may be drawn twice, so there may be more than the population.
	Tournament int
	// How many candidates are scored at once; 1.
	Goroutines int
	// What mutants must be like, and may come to sense.
	Needs genome.Requirements
	// Is told of each generation once it is scored; nil for nobody.
	Each func(Generation)
}

// Candidate is one creature of a run.
type Candidate struct {
	// Which one of the run, from 0.
	Number int
	// Which one it comes from; -1 of a founder, and of a founder's mutant.
	Parent int
	// By which kind of mutation; "" of a founder, and of one that is as its parent was, since no mutant was good.
	Kind   string
	Genome *genome.Genome
	// What it is worth.
	Score float64
	// Why it has no score: what the server said of it; "" where it has one.
	Refused string
}

// Generation is one that is scored: its candidates from the best on.
type Generation struct {
	Number     int
	Candidates []Candidate
}

// Result is what came of a run.
type Result struct {
	Best Candidate
	// Of all candidates with their scores to the last bit: equal digests, equal runs. 64 hexadecimal digits.
	Digest string
}

// Score scores a creature; the larger, the better. A *nmes.CommandError says that it cannot be scored, and the run goes
// on without; any other error ends the run.
type Score func(ctx context.Context, creature *genome.Genome) (float64, error)

// filled returns the options with their defaults.
func (o Options) filled() (Options, error) {
	o.Population = cmp.Or(o.Population, 100)
	o.Generations = cmp.Or(o.Generations, 10)
	o.Elites = cmp.Or(o.Elites, max(1, o.Population/20))
	o.Tournament = cmp.Or(o.Tournament, 3)
	o.Goroutines = cmp.Or(o.Goroutines, 1)
	for _, each := range []struct {
		name             string
		value, low, most int
	}{
		{"Population", o.Population, 2, 1_000_000},
		{"Generations", o.Generations, 1, 1_000_000},
		{"Elites", o.Elites, 1, o.Population - 1},
		{"Tournament", o.Tournament, 1, 1_000},
		{"Goroutines", o.Goroutines, 1, 100_000},
	} {
		if each.value < each.low || each.value > each.most {
			return o, fmt.Errorf("evolve: %s is from %d to %d, not %d", each.name, each.low, each.most, each.value)
		}
	}
	return o, nil
}

// Run evolves creatures from founders, the first generation being these and mutants of theirs.
func Run(ctx context.Context, founders []*genome.Genome, score Score, options Options) (*Result, error) {
	options, err := options.filled()
	if err != nil {
		return nil, err
	}
	if len(founders) == 0 {
		return nil, errors.New("evolve: a run needs a founder")
	}
	r := &run{options: options, score: score, digest: sha256.New()}
	var before []Candidate
	for number := range options.Generations {
		before, err = r.generation(ctx, founders, before)
		if err != nil {
			return nil, err
		}
		if options.Each != nil {
			options.Each(Generation{number, slices.Clone(before)})
		}
	}
	if before[0].Refused != "" {
		return nil, fmt.Errorf("evolve: no candidate has a score, the last since %s", before[0].Refused)
	}
	return &Result{before[0], hex.EncodeToString(r.digest.Sum(nil))}, nil
}

type run struct {
	options Options
	score   Score
	digest  hash.Hash
	count   int // of the candidates so far
}

// generation breeds and scores the next one; it returns its candidates from the best on.
func (r *run) generation(ctx context.Context, founders []*genome.Genome, before []Candidate) ([]Candidate, error) {
	elites := before[:min(len(before), r.options.Elites)]
	fresh := make([]Candidate, r.options.Population-len(elites))
	err := r.each(ctx, len(fresh), func(ctx context.Context, i int) (err error) {
		fresh[i] = r.breed(r.count+i, founders, before)
		fresh[i].Score, err = r.score(ctx, fresh[i].Genome)
		var refused *nmes.CommandError
		switch {
		case errors.As(err, &refused):
			fresh[i].Refused = refused.Error()
		case err == nil && math.IsNaN(fresh[i].Score):
			fresh[i].Refused = "its score is no number"
		default:
			return err
		}
		fresh[i].Score = 0
		return nil
	})
	if err != nil {
		return nil, err
	}
	r.count += len(fresh)
	for _, each := range fresh {
		score := math.Float64bits(each.Score)
		fmt.Fprintf(r.digest, "%d %d %q %s %016x %q\n", each.Number, each.Parent, each.Kind, each.Genome.Hash, score, each.Refused)
	}
	all := append(slices.Clone(elites), fresh...)
	slices.SortFunc(all, better)
	return all, nil
}

// better orders candidates from the best on; of those that are worth the same, the one that was there first is better.
func better(one, other Candidate) int {
	switch {
	case one.Refused == "" && other.Refused != "":
		return -1
	case one.Refused != "" && other.Refused == "":
		return 1
	}
	return cmp.Or(cmp.Compare(other.Score, one.Score), cmp.Compare(one.Number, other.Number))
}

// breed returns the candidate of a number. It draws by itself, whatever others draw.
func (r *run) breed(number int, founders []*genome.Genome, before []Candidate) Candidate {
	draw := genome.NewDraw(r.options.Seed, "candidate", number)
	child := Candidate{Number: number, Parent: -1}
	switch {
	case before != nil:
		place := len(before)
		for range r.options.Tournament {
			place = min(place, draw.Count(0, len(before)-1)) // they are in order: the first is the best
		}
		child.Parent, child.Genome = before[place].Number, before[place].Genome
	case number < len(founders):
		child.Genome = founders[number]
		return child
	default:
		child.Genome = founders[number%len(founders)]
	}
	if mutant, err := genome.Mutate(child.Genome, draw, "", r.options.Needs); err == nil {
		child.Genome, child.Kind = mutant.Genome, mutant.Kind
	} // else no try gave a good one, and the parent has another life
	return child
}

// each calls a function for every number below count, on as many goroutines as there may be; the first error ends it.
func (r *run) each(ctx context.Context, count int, do func(context.Context, int) error) error {
	ctx, cancel := context.WithCancelCause(ctx)
	defer cancel(nil)
	numbers := make(chan int)
	var working sync.WaitGroup
	for range min(r.options.Goroutines, count) {
		working.Add(1)
		go func() {
			defer working.Done()
			for i := range numbers {
				if err := do(ctx, i); err != nil {
					cancel(err)
				}
			}
		}()
	}
	for i := range count {
		select {
		case numbers <- i:
		case <-ctx.Done():
		}
	}
	close(numbers)
	working.Wait()
	return context.Cause(ctx)
}
