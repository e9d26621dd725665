// Package brain runs the controllers of creatures: documents that people share, and the programs that they stand for.
//
//	controller, err := brain.Load(document, []string{"hip.position", "root.up.y"}, []string{"hip", "knee"})
//	controller.Reset(0, 1.0/60)
//	controller.Step(sensors, controls)
//
// The kinds are sine, cpg, mlp, ctrnn, graph and onnx. What one does follows from its document, the seed, dt and what
// sensors read, to the last bit, and is what the reference implementation does: all sums are taken in its order, and
// sines, exponentials and hyperbolic tangents are those of the C library that it asks on x86-64 (internal/elementary).
// Of onnx this is not so: what onnxruntime adds up in which order depends on the processor.
//
// Each product in this package is written float64(a*b), which Go must round by itself. Without it the compiler may fuse
// a product with the sum behind it, as it does on arm64, ppc64, s390x and riscv64, also across statements, and the last
// bit would be another. A test holds the package to that.
package brain

import (
	_ "embed"
	"encoding/json"
	"fmt"
	"maps"
	"slices"
	"strings"

	"nmes/internal/documents"
)

// Error is why a document is no brain for a body: what is wrong, and where.
type Error = documents.Error

// limit is what goes through a brain kept within, sensors' values first, so that no sum overflows.
const limit = 1e6

const (
	mostSensors = 4096
	mostMotors  = 1024
)

//go:embed schemas.json
var schemasJSON []byte

// schemas are those of the kinds, written from the schemas of the protocol by tools/go_schemas.py.
var schemas = func() (result map[string]*documents.Schema) {
	if err := json.Unmarshal(schemasJSON, &result); err != nil {
		panic(err)
	}
	return result
}()

// kernel is what runs.
type kernel interface {
	// reset goes to the start.
	reset(seed uint64, dt float64)
	// step goes one control step on, to controls of -1 to 1.
	step(sensors, controls []float64)
}

// kinds makes kernels of completed documents.
var kinds = map[string]func(document []byte, names *names) kernel{
	"sine": newSine, "cpg": newCPG, "mlp": newMLP, "ctrnn": newCTRNN, "graph": newGraph, "onnx": newONNX,
}

// Brain is a controller, tied to the names of a body's sensors and motors. It is for one goroutine at a time.
type Brain struct {
	kind            string
	inputs, outputs []string
	kernel          kernel
	ready           bool
}

// Load reads a brain's document, for a body with these sensors and motors. What is wrong with it is an *Error.
func Load(document []byte, inputs, outputs []string) (*Brain, error) {
	value, err := documents.Parse(document)
	if err != nil {
		return nil, err
	}
	all := strings.Join(slices.Sorted(maps.Keys(kinds)), ", ")
	fields, is := value.(map[string]any)
	if !is || fields["kind"] == nil {
		return nil, documents.Refused("a brain is an object with a 'kind': %s", all)
	}
	kind, _ := fields["kind"].(string)
	schema := schemas[kind]
	if schema == nil {
		return nil, &Error{Problems: []documents.Problem{{Path: "kind", Message: "there is no such kind of brain: there are " + all}}}
	}
	if len(inputs) > mostSensors || len(outputs) > mostMotors {
		return nil, documents.Refused("the body has %d sensors and %d motors; a brain can have %d and %d", len(inputs), len(outputs), mostSensors, mostMotors)
	}
	if err := schema.Check(value); err != nil {
		return nil, err
	}
	schema.Complete(value)
	completed, err := json.Marshal(value)
	if err != nil {
		return nil, documents.Refused("%v", err)
	}
	names := &names{inputs: inputs, outputs: outputs, unknown: map[[2]string]bool{}}
	kernel := kinds[kind](completed, names)
	if err := names.Err(); err != nil {
		return nil, err
	}
	return &Brain{kind: kind, inputs: slices.Clone(inputs), outputs: slices.Clone(outputs), kernel: kernel}, nil
}

// Kind returns which kind of brain it is: sine, cpg, mlp, ctrnn, graph or onnx.
func (b *Brain) Kind() string { return b.kind }

// Inputs returns the names of the sensors, in the order in which Step takes their values.
func (b *Brain) Inputs() []string { return slices.Clone(b.inputs) }

// Outputs returns the names of the motors, in the order in which Step gives their controls.
func (b *Brain) Outputs() []string { return slices.Clone(b.outputs) }

// Reset goes to the start. The seed is of whatever the brain draws; dt is a control step, s, above 0: the brain's time
// is the number of its steps times this.
func (b *Brain) Reset(seed uint64, dt float64) {
	if !(dt > 0 && dt <= 1e6) {
		panic(fmt.Sprintf("brain: a control step is above 0 s, and at most 1e6, not %v", dt))
	}
	b.kernel.reset(seed, dt)
	b.ready = true
}

// Step goes one control step on, from what the sensors read, finite numbers, to what the motors shall do, each from -1
// to 1. It panics where there are not as many as there are names, and before Reset.
func (b *Brain) Step(sensors, controls []float64) {
	if !b.ready || len(sensors) != len(b.inputs) || len(controls) != len(b.outputs) {
		panic(fmt.Sprintf("brain: a step after Reset takes %d sensors and %d controls, not %d and %d",
			len(b.inputs), len(b.outputs), len(sensors), len(controls)))
	}
	b.kernel.step(sensors, controls)
}

// decoded reads a completed document into the struct of its kind; its schema has seen to it that it fits.
func decoded[D any](document []byte) D {
	var result D
	if err := json.Unmarshal(document, &result); err != nil {
		panic(fmt.Sprintf("brain: a document that its schema allows: %v", err))
	}
	return result
}

func within(low, high, value float64) float64 { return min(max(value, low), high) }
