package evolve_test

import (
	"context"
	"errors"
	"math/rand/v2"
	"strings"
	"sync"
	"sync/atomic"
	"testing"
	"time"

	"nmes"
	"nmes/evolve"
	"nmes/genome"
)

const hopper = `{"format": "nmes-genome/1", "name": "hopper", "body": {"cubes": [
	{"id": "torso", "size": [0.4, 0.2, 0.3], "mass": 3, "position": [0, 0.5, 0]},
	{"id": "foot", "size": [0.3, 0.1, 0.3], "mass": 1, "position": [0, 0.05, 0]}], "joints": [
	{"id": "leg", "cube1": "torso", "cube2": "foot", "type": "slide", "anchor": [0, 0.2, 0], "axis": [0, 1, 0],
	 "limits": [-0.2, 0.2], "motor": {"mode": "position", "range": [-0.2, 0.2], "max_effort": 200}}]},
	"brain": {"kind": "sine", "oscillators": [{"motor": "leg", "amplitude": 1, "frequency": 1.5}]}}`

func founders(t *testing.T) []*genome.Genome {
	t.Helper()
	founder, err := genome.Parse([]byte(hopper))
	if err != nil {
		t.Fatal(err)
	}
	return []*genome.Genome{founder}
}

// weight is a score that needs no world, and is ready after a while that no seed tells.
func weight(_ context.Context, creature *genome.Genome) (float64, error) {
	time.Sleep(rand.N(2 * time.Millisecond))
	return creature.Body.Mass(), nil
}

var small = evolve.Options{Seed: 7, Population: 24, Generations: 4, Elites: 2}

func run(t *testing.T, score evolve.Score, options evolve.Options) (*evolve.Result, []evolve.Generation) {
	t.Helper()
	var generations []evolve.Generation
	options.Each = func(generation evolve.Generation) { generations = append(generations, generation) }
	result, err := evolve.Run(context.Background(), founders(t), score, options)
	if err != nil {
		t.Fatal(err)
	}
	return result, generations
}

func TestTheRunIsTheSameWithAnyNumberOfGoroutines(t *testing.T) {
	digests := map[string]bool{}
	for _, goroutines := range []int{1, 1, 10, 100} {
		options := small
		options.Goroutines = goroutines
		result, _ := run(t, weight, options)
		digests[result.Digest] = true
	}
	if len(digests) != 1 {
		t.Errorf("%d different digests of one seed", len(digests))
	}
	options := small
	options.Seed++
	if result, _ := run(t, weight, options); digests[result.Digest] {
		t.Error("another seed has the same digest")
	}
}

func TestGenerationsGetBetterAndTheBestLiveOn(t *testing.T) {
	result, generations := run(t, weight, small)
	if len(generations) != small.Generations {
		t.Fatalf("%d generations", len(generations))
	}
	numbers := map[int]bool{}
	for i, generation := range generations {
		if len(generation.Candidates) != small.Population {
			t.Errorf("generation %d has %d candidates", i, len(generation.Candidates))
		}
		for j, candidate := range generation.Candidates {
			if j > 0 && candidate.Score > generation.Candidates[j-1].Score {
				t.Errorf("generation %d is not in order at %d", i, j)
			}
			if candidate.Score != candidate.Genome.Body.Mass() {
				t.Errorf("candidate %d has the score of another", candidate.Number)
			}
			numbers[candidate.Number] = true
		}
		if i > 0 {
			for place, elite := range generations[i-1].Candidates[:small.Elites] {
				found := false
				for _, candidate := range generation.Candidates {
					found = found || candidate.Number == elite.Number
				}
				if !found {
					t.Errorf("elite %d of generation %d is gone", place, i-1)
				}
			}
		}
	}
	if wanted := small.Population + (small.Generations-1)*(small.Population-small.Elites); len(numbers) != wanted {
		t.Errorf("%d candidates, not %d", len(numbers), wanted)
	}
	first, last := generations[0].Candidates[0].Score, generations[small.Generations-1].Candidates[0].Score
	if last <= first || result.Best.Score != last {
		t.Errorf("from %v to %v, and the result says %v", first, last, result.Best.Score)
	}
}

func TestAsManyAreScoredAtOnceAsThereAreGoroutines(t *testing.T) {
	var now atomic.Int32
	var all sync.WaitGroup
	all.Add(small.Population)
	options := small
	options.Generations, options.Goroutines = 1, small.Population
	run(t, func(_ context.Context, creature *genome.Genome) (float64, error) {
		now.Add(1)
		all.Done()
		all.Wait() // for ever, if one of them were not there
		return creature.Body.Mass(), nil
	}, options)
	if int(now.Load()) != small.Population {
		t.Errorf("%d", now.Load())
	}
}

func TestWhatTheServerRefusesHasNoScoreAndNoDescendants(t *testing.T) {
	heavy := func(_ context.Context, creature *genome.Genome) (float64, error) {
		if creature.Body.Mass() > 4.001 {
			return 99, &nmes.CommandError{Code: "limit_reached", Message: "too heavy"}
		}
		return creature.Body.Mass(), nil
	}
	_, generations := run(t, heavy, small)
	refused := map[int]bool{}
	for _, generation := range generations {
		for _, candidate := range generation.Candidates {
			if candidate.Refused != "" {
				refused[candidate.Number] = true
				if candidate.Score != 0 {
					t.Error("a score in spite of all")
				}
			} else if candidate.Score > 4.001 {
				t.Error("a score that was refused")
			}
		}
		if generation.Candidates[0].Refused != "" {
			t.Error("the best is one without a score")
		}
	}
	if len(refused) == 0 {
		t.Error("nothing was refused")
	}
}

func TestAnyOtherErrorEndsTheRun(t *testing.T) {
	options, lost := small, errors.New("the cable is cut")
	options.Goroutines = 4
	var count atomic.Int32
	_, err := evolve.Run(context.Background(), founders(t), func(context.Context, *genome.Genome) (float64, error) {
		if count.Add(1) == 30 {
			return 0, lost
		}
		return 1, nil
	}, options)
	if !errors.Is(err, lost) {
		t.Error(err)
	}
	ctx, cancel := context.WithCancel(context.Background())
	cancel()
	if _, err := evolve.Run(ctx, founders(t), weight, small); !errors.Is(err, context.Canceled) {
		t.Error(err)
	}
}

func TestTwoAreAPopulation(t *testing.T) {
	_, generations := run(t, weight, evolve.Options{Population: 2, Generations: 3})
	if len(generations) != 3 || len(generations[2].Candidates) != 2 {
		t.Errorf("%+v", generations)
	}
}

func TestOptionsOutOfBoundsAreRefused(t *testing.T) {
	for _, options := range []evolve.Options{
		{Population: 1}, {Population: -1}, {Elites: 100}, {Generations: -1}, {Tournament: 1001}, {Goroutines: -1},
	} {
		if _, err := evolve.Run(context.Background(), founders(t), weight, options); err == nil || !strings.HasPrefix(err.Error(), "evolve: ") {
			t.Errorf("%+v: %v", options, err)
		}
	}
	if _, err := evolve.Run(context.Background(), nil, weight, small); err == nil {
		t.Error("a run without founders")
	}
}
