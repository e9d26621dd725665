package brain

import (
	"encoding/base64"
	"errors"
	"fmt"
	"maps"
	"math"
	"slices"
	"strings"

	"nmes/internal/documents"
)

const mostProducts = 1 << 26 // and numbers that are read for something else, in one step of a model

var errLong = fmt.Errorf("a step of it takes more than %d products and other numbers", mostProducts)

// node is an operator of a model, and what it is applied to.
type onnxNode struct {
	operator        string
	inputs, outputs []string
	attributes      map[string]attribute
}

type attribute struct {
	number   float64
	integer  int64
	integers []int64
	tensor   *tensor
}

// model is what is needed of an ONNX file: https://github.com/onnx/onnx/blob/main/onnx/onnx.proto
type model struct {
	nodes         []onnxNode
	initializers  map[string]*tensor
	input, output string
	kind          int
	shape         []int // of the input; -1 where it is open
}

// onnx is a model of layers, as they are exported of policies. It has no memory. It runs operators by itself, in the
// numbers that the model has: singles are rounded to singles after each operator, and sums of products once, at the end.
type onnx struct {
	model *model
	sums  [][]float64 // from sensors to the model's inputs
	heard []float64
	owner []int
}

func newONNX(document []byte, n *names) kernel {
	given := decoded[struct {
		sides
		Model string
	}](document)
	entries := newEntries(given.sides, n)
	file, err := base64.StdEncoding.DecodeString(given.Model)
	if err != nil || strings.ContainsAny(given.Model, "\r\n") {
		n.Add("model", "is not base64")
		return nil
	}
	m, err := readModel(file)
	if err != nil {
		n.Add("model", "is no ONNX model that runs here: %v", err)
		return nil
	}
	count := entries.inputs.count
	for i, each := range m.shape { // what is left open is all inputs in the last place, else 1
		if each < 0 && i == len(m.shape)-1 {
			m.shape[i] = count
		} else if each < 0 {
			m.shape[i] = 1
		}
	}
	if size(m.shape) < 0 {
		n.Add("model", "is no ONNX model that runs here: of its inputs, %v", errShape)
		return nil
	}
	entries.expect("model", size(m.shape), &entries.inputs, "inputs")
	if n.Err() != nil {
		return nil
	}
	out, err := m.run(make([]float64, count))
	if err != nil {
		n.Add("model", "fails on inputs of 0: %v", err)
		return nil
	}
	entries.expect("model", len(out), &entries.outputs, "outputs")
	o := &onnx{m, matrix(count, len(n.inputs)), make([]float64, len(n.inputs)), entries.outputs.owner}
	for sensor, entry := range entries.inputs.owner {
		if entry >= 0 {
			o.sums[entry][sensor] = 1
		}
	}
	return o
}

func (o *onnx) reset(uint64, float64) {}

func (o *onnx) step(sensors, controls []float64) {
	hear(sensors, o.heard)
	seen := make([]float64, len(o.sums))
	weigh(o.sums, o.heard, seen)
	out, err := o.model.run(seen)
	if err != nil {
		panic(err) // it ran when the brain was loaded, and whether it does hangs on no numbers of the inputs: see judge
	}
	for i, value := range out {
		if math.IsNaN(value) {
			out[i] = 0
		}
	}
	pick(o.owner, out, controls)
}

// -- reading ----------------------------------------------------------------------------------------------------------

func readModel(file []byte) (*model, error) {
	m := &model{initializers: map[string]*tensor{}}
	r := &protoReader{}
	var inputs, outputs []value
	err := r.message(file, func(f protoField) error {
		if f.number != 7 {
			return nil
		}
		return r.message(f.bytes, func(f protoField) error {
			switch f.number {
			case 1:
				node, err := r.node(f.bytes)
				m.nodes = append(m.nodes, node)
				return err
			case 5:
				name, t, err := r.tensor(f.bytes)
				m.initializers[name] = t
				return err
			case 11, 12:
				v, err := r.value(f.bytes)
				if f.number == 11 {
					inputs = append(inputs, v)
				} else {
					outputs = append(outputs, v)
				}
				return err
			case 15:
				return errors.New("it has sparse numbers, which are not known here")
			}
			return nil
		})
	})
	if err != nil {
		return nil, err
	}
	inputs = slices.DeleteFunc(inputs, func(v value) bool { return m.initializers[v.name] != nil })
	for _, side := range [][]value{inputs, outputs} {
		if len(side) != 1 || (side[0].kind != single && side[0].kind != double) {
			return nil, errors.New("it must have one tensor of floats or doubles for its inputs, and one for its outputs")
		}
	}
	m.input, m.output, m.kind, m.shape = inputs[0].name, outputs[0].name, inputs[0].kind, inputs[0].shape
	return m, m.judge()
}

// judge returns what is wrong with the nodes of a model. What they do to shapes may hang on nothing that is computed, so
// that a step fails for all inputs or for none; and no name may be given twice, by which one could come to hang on it.
func (m *model) judge() error {
	named := map[string]bool{m.input: true}
	constants := maps.Clone(m.initializers)
	for name := range constants {
		named[name] = true
	}
	for _, node := range m.nodes {
		switch {
		case operators[node.operator] == nil:
			return fmt.Errorf("the operator %s is not among those that run here: %s", documents.Excerpt(node.operator), operatorNames())
		case node.operator == "Dropout" && len(node.inputs) > 2 && node.inputs[2] != "": // it may be in training
			return errors.New("draws random numbers (Dropout)")
		case node.operator == "Reshape" && len(node.inputs) > 1:
			if shape := constants[node.inputs[1]]; shape == nil || shape.kind != integer {
				return errors.New("the shape of a Reshape must be constant, and of int64")
			}
		}
		for _, name := range node.outputs {
			if named[name] {
				return fmt.Errorf("there are two of %s", documents.Excerpt(name))
			}
			named[name] = true
			if node.operator == "Constant" {
				constants[name] = node.attributes["value"].tensor
			}
		}
	}
	return nil
}

// value is a model's input or output.
type value struct {
	name  string
	kind  int
	shape []int
}

// value reads a ValueInfoProto.
func (r *protoReader) value(data []byte) (v value, err error) {
	err = r.message(data, func(f protoField) error {
		if f.number == 1 {
			v.name = string(f.bytes)
		}
		if f.number != 2 {
			return nil
		}
		return r.message(f.bytes, func(f protoField) error {
			if f.number != 1 {
				return nil
			}
			return r.message(f.bytes, func(f protoField) error {
				if f.number == 1 {
					v.kind = int(min(f.value, 1000))
				}
				if f.number != 2 {
					return nil
				}
				return r.message(f.bytes, func(f protoField) error {
					length := -1
					err := r.message(f.bytes, func(f protoField) error {
						if f.number == 1 {
							length = int(min(f.value, mostValues+1))
						}
						return nil
					})
					v.shape = append(v.shape, length)
					return err
				})
			})
		})
	})
	return v, err
}

// node reads a NodeProto.
func (r *protoReader) node(data []byte) (onnxNode, error) {
	node := onnxNode{attributes: map[string]attribute{}}
	err := r.message(data, func(f protoField) error {
		switch f.number {
		case 1:
			node.inputs = append(node.inputs, string(f.bytes))
		case 2:
			node.outputs = append(node.outputs, string(f.bytes))
		case 4:
			node.operator = string(f.bytes)
		case 5:
			return r.attribute(f.bytes, node.attributes)
		}
		return nil
	})
	return node, err
}

func (r *protoReader) attribute(data []byte, to map[string]attribute) error {
	name, result := "", attribute{}
	err := r.message(data, func(f protoField) (err error) {
		switch f.number {
		case 1:
			name = string(f.bytes)
		case 2:
			var numbers []float64
			if numbers, err = f.numbers(4); len(numbers) > 0 {
				result.number = numbers[0]
			}
		case 3:
			result.integer = int64(f.value)
		case 5:
			_, result.tensor, err = r.tensor(f.bytes)
		case 8:
			var more []int64
			more, err = f.integers()
			result.integers = append(result.integers, more...)
		}
		return err
	})
	to[name] = result
	return err
}

// -- running ----------------------------------------------------------------------------------------------------------

// run returns what the model makes of its inputs.
func (m *model) run(inputs []float64) ([]float64, error) {
	known := map[string]*tensor{m.input: rounded(m.kind, m.shape, slices.Clone(inputs))}
	for name, t := range m.initializers {
		known[name] = t
	}
	products := 0
	for _, node := range m.nodes {
		arguments := make([]*tensor, len(node.inputs))
		for i, name := range node.inputs {
			if arguments[i] = known[name]; arguments[i] == nil && name != "" {
				return nil, fmt.Errorf("%s: there is no %s before it", node.operator, documents.Excerpt(name))
			}
			if arguments[i] != nil {
				products += len(arguments[i].values)
			}
		}
		if products > mostProducts {
			return nil, errLong
		}
		result, err := operators[node.operator](arguments, node.attributes, &products)
		if err != nil {
			return nil, fmt.Errorf("%s: %w", node.operator, err)
		}
		if len(node.outputs) != 1 {
			return nil, fmt.Errorf("%s: has %d outputs", node.operator, len(node.outputs))
		}
		known[node.outputs[0]] = result
	}
	if known[m.output] == nil {
		return nil, fmt.Errorf("there is no %s", documents.Excerpt(m.output))
	}
	return slices.Clone(known[m.output].values), nil
}

// rounded returns a tensor of values, which are made singles where it is one of these.
func rounded(kind int, shape []int, values []float64) *tensor {
	if kind == single {
		for i, value := range values {
			values[i] = float64(float32(value))
		}
	}
	return &tensor{kind, shape, values}
}
