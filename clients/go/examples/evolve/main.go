// Command evolve evolves creatures that go far, each in a world of its own, and prints the best of each generation and,
// in the end, a digest: from the same seed it is the same, however many goroutines there are.
//
//	nmes serve --worlds 100 --port-step 0 --mode lockstep --no-record
//	go run ./examples/evolve -goroutines 100 walker.json
//
// The password is in NMES_PASSWORD.
package main

import (
	"context"
	"encoding/json"
	"flag"
	"fmt"
	"log"
	"os"

	"nmes"
	"nmes/evolve"
	"nmes/genome"
)

func main() {
	log.SetFlags(0)
	address := flag.String("addr", "127.0.0.1:14000", "of the host")
	count := flag.Int("worlds", 100, "how many of its worlds, main-1, main-2 and so on")
	ticks := flag.Int("ticks", 600, "of each life")
	objective := flag.String("objective", evolve.HorizontalDistance, "what a creature is worth at its end")
	best := flag.String("o", "", "where to write the best creature")
	var options evolve.Options
	flag.Int64Var(&options.Seed, "seed", 0, "of all that is drawn")
	flag.IntVar(&options.Population, "population", 100, "how many candidates a generation has")
	flag.IntVar(&options.Generations, "generations", 10, "how many generations")
	flag.IntVar(&options.Goroutines, "goroutines", 100, "how many candidates are scored at once")
	flag.Parse()

	var founders []*genome.Genome
	for _, path := range flag.Args() {
		text, err := os.ReadFile(path)
		must(err)
		founder, err := genome.Parse(text)
		must(err)
		founders = append(founders, founder)
	}
	names := make([]string, *count)
	for i := range names {
		names[i] = fmt.Sprintf("main-%d", i+1)
	}
	ctx := context.Background()
	worlds, err := evolve.Enter(ctx, *address, names, nmes.Options{})
	must(err)
	defer worlds.Close()
	worlds.Ticks, worlds.Objective = *ticks, *objective
	options.Each = func(generation evolve.Generation) {
		leader := generation.Candidates[0]
		fmt.Printf("generation %d: candidate %d is worth %.4f, hash %s\n",
			generation.Number, leader.Number, leader.Score, leader.Genome.Hash[:16])
	}
	result, err := evolve.Run(ctx, founders, worlds.Score, options)
	must(err)
	fmt.Println("digest", result.Digest)
	if *best != "" {
		text, err := json.MarshalIndent(result.Best.Genome, "", "  ")
		must(err)
		must(os.WriteFile(*best, append(text, '\n'), 0o644))
	}
}

func must(err error) {
	if err != nil {
		log.Fatal(err)
	}
}
