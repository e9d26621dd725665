// Command lines answers what is asked about genomes, a line of JSON each, for tests that compare it with NMES:
// {"check": "TEXT", "needs": {...}} is answered by what is wrong with that text, or by the hash and by which of the needs
// the body does not meet; {"mutate": {...}, "seed": 7, "number": 0, "kind": "", "needs": {...}} by the mutant's hash and
// kind, or by why there is none.
package main

import (
	"bufio"
	"encoding/json"
	"errors"
	"log"
	"os"

	"nmes/genome"
)

type question struct {
	Check  *string             `json:"check"`
	Mutate json.RawMessage     `json:"mutate"`
	Seed   int64               `json:"seed"`
	Number int                 `json:"number"`
	Kind   string              `json:"kind"`
	Needs  genome.Requirements `json:"needs"`
}

type answer struct {
	Problems []genome.Problem `json:"problems,omitempty"`
	Hash     string           `json:"hash,omitempty"`
	Reasons  []string         `json:"reasons,omitempty"`
	Kind     string           `json:"kind,omitempty"`
	Code     string           `json:"code,omitempty"`
	Message  string           `json:"message,omitempty"`
	Document any              `json:"document,omitempty"`
}

func main() {
	in := bufio.NewScanner(os.Stdin)
	in.Buffer(nil, 256<<20)
	out := json.NewEncoder(os.Stdout)
	for in.Scan() {
		var asked question
		must(json.Unmarshal(in.Bytes(), &asked))
		if asked.Check != nil {
			must(out.Encode(checked([]byte(*asked.Check), asked.Needs)))
		} else {
			must(out.Encode(mutated(asked)))
		}
	}
	must(in.Err())
}

func checked(text []byte, needs genome.Requirements) answer {
	if problems := genome.Check(text); len(problems) > 0 {
		return answer{Problems: problems}
	}
	read, err := genome.Parse(text)
	must(err)
	return answer{Hash: read.Hash, Reasons: needs.Check(&read.Body)}
}

func mutated(asked question) answer {
	parent, err := genome.Parse(asked.Mutate)
	must(err)
	draw := genome.NewDraw(asked.Seed, "genome", asked.Number)
	mutant, err := genome.Mutate(parent, draw, asked.Kind, asked.Needs)
	var refused *genome.VariationError
	if errors.As(err, &refused) {
		return answer{Code: refused.Code, Message: refused.Message}
	}
	must(err)
	return answer{Hash: mutant.Genome.Hash, Kind: mutant.Kind, Document: mutant.Genome}
}

func must(err error) {
	if err != nil {
		log.Fatal(err)
	}
}
