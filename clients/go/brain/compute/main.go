// Command compute runs brains that the project's tests draw: a line of JSON in for each, with what its sensors read, and
// a line out with what it does, or with what is wrong with it.
package main

import (
	"bufio"
	"encoding/json"
	"errors"
	"log"
	"os"

	"nmes/brain"
)

type drawn struct {
	Document        json.RawMessage
	DocumentText    string `json:"document_text"` // the bytes of one that may be no JSON, each as a character
	Inputs, Outputs []string
	Seed            uint64
	DT              float64
	Sensors         [][]float64 // a row for each step; none: the document is only judged
}

type answer struct {
	Controls [][]float64 `json:"controls,omitempty"`
	Problems [][2]string `json:"problems,omitempty"` // each a place, and what is wrong there
	More     bool        `json:"more,omitempty"`
}

func main() {
	in, out := bufio.NewReader(os.Stdin), json.NewEncoder(os.Stdout)
	for {
		line, err := in.ReadBytes('\n')
		if err != nil {
			return
		}
		var told drawn
		if err := json.Unmarshal(line, &told); err != nil {
			log.Fatal(err)
		}
		if err := out.Encode(run(told)); err != nil {
			log.Fatal(err)
		}
	}
}

func run(told drawn) answer {
	document := []byte(told.Document)
	for _, character := range told.DocumentText {
		document = append(document, byte(character))
	}
	controller, err := brain.Load(document, told.Inputs, told.Outputs)
	var refused *brain.Error
	if errors.As(err, &refused) {
		result := answer{More: refused.More}
		for _, problem := range refused.Problems {
			result.Problems = append(result.Problems, [2]string{problem.Path, problem.Message})
		}
		return result
	}
	if err != nil {
		log.Fatal(err)
	}
	var result answer
	if told.Sensors == nil {
		return result
	}
	for range 2 { // the second time from the start again
		result.Controls = result.Controls[:0]
		controller.Reset(told.Seed, told.DT)
		for _, sensors := range told.Sensors {
			controls := make([]float64, len(told.Outputs))
			controller.Step(sensors, controls)
			result.Controls = append(result.Controls, controls)
		}
	}
	return result
}
