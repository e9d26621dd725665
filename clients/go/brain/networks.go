package brain

import (
	"fmt"

	"nmes/internal/elementary"
)

// activations are what a unit makes of its sum.
var activations = map[string]func(float64) float64{
	"tanh":     elementary.Tanh,
	"sigmoid":  func(s float64) float64 { return float64(0.5*elementary.Tanh(float64(0.5*s))) + 0.5 },
	"sin":      elementary.Sin,
	"cos":      elementary.Cos,
	"gauss":    func(s float64) float64 { return elementary.Exp(-float64(s * s)) },
	"step":     step,
	"relu":     func(s float64) float64 { return within(0, limit, s) },
	"abs":      func(s float64) float64 { return min(max(s, -s), limit) },
	"identity": func(s float64) float64 { return within(-limit, limit, s) },
}

func step(s float64) float64 {
	if s >= 0 {
		return 1
	}
	return 0
}

// -- layers -----------------------------------------------------------------------------------------------------------

type layer struct {
	weights  [][]float64 // of what is before, and of a 1 for the bias
	weigh    func(weights [][]float64, row, sums []float64)
	activate func(float64) float64
	row      []float64 // what is before, and a 1
}

// mlp is a multilayer perceptron, without a memory.
type mlp struct {
	layers []layer
	last   []float64
	owner  []int
}

func newMLP(document []byte, n *names) kernel {
	given := decoded[struct {
		sides
		Layers []struct {
			Weights    [][]float64
			Biases     []float64
			Activation string
		}
	}](document)
	for number, each := range given.Layers {
		even(n, fmt.Sprintf("layers/%d/weights", number), each.Weights)
	}
	if n.Err() != nil {
		return nil
	}
	entries := newEntries(given.sides, n)
	m := &mlp{owner: entries.outputs.owner}
	units := 0
	for number, each := range given.Layers {
		path := fmt.Sprintf("layers/%d/", number)
		columns := len(each.Weights[0])
		if number == 0 {
			entries.expect(path+"weights", columns, &entries.inputs, "columns")
		} else {
			same(n, path+"weights", columns, units, "columns", "unit of the layer before")
		}
		units = len(each.Weights)
		same(n, path+"biases", len(each.Biases), units, "numbers", "row of the weights")
		if number == len(given.Layers)-1 {
			entries.expect(path+"weights", units, &entries.outputs, "rows")
		}
	}
	if n.Err() != nil {
		return nil
	}
	for number, each := range given.Layers {
		weights := each.Weights
		if number == 0 {
			weights = entries.spread(weights, 0)
		}
		columns := len(weights[0])
		l := layer{matrix(len(weights), columns+1), weigh, activations[each.Activation], make([]float64, columns+1)}
		if number == 0 && len(weights) > 1 && columns > 1 {
			l.weigh = weighByColumns
		}
		for i, row := range weights {
			copy(l.weights[i], row)
			l.weights[i][columns] = each.Biases[i]
		}
		l.row[columns] = 1
		m.layers = append(m.layers, l)
		m.last = make([]float64, len(weights))
	}
	return m
}

func (m *mlp) reset(uint64, float64) {}

func (m *mlp) step(sensors, controls []float64) {
	hear(sensors, m.layers[0].row)
	for i, l := range m.layers {
		out := m.last
		if i < len(m.layers)-1 {
			next := m.layers[i+1].row
			out = next[:len(next)-1]
		}
		l.weigh(l.weights, l.row, out)
		for unit, sum := range out {
			out[unit] = l.activate(sum)
		}
	}
	pick(m.owner, m.last, controls)
}

// even notes rows of unequal length.
func even(n *names, path string, rows [][]float64) {
	for number, row := range rows {
		if len(row) != len(rows[0]) {
			n.Add(fmt.Sprintf("%s/%d", path, number), "has %d numbers, the first row %d", len(row), len(rows[0]))
		}
	}
}

func same(n *names, path string, got, wanted int, each, other string) {
	if got != wanted {
		n.Add(path, "has %d %s, and there must be %d, one for each %s", got, each, wanted, other)
	}
}

// -- continuous-time recurrent networks -------------------------------------------------------------------------------

// ctrnn are neurons that follow their input with a delay, each exactly as if its input stood still during a step. With
// v = (y + bias) / 2 and u = tanh(v), sigmoid(y + bias) is (1 + u) / 2, and the equation becomes
// tau dv/dt = -v + (bias + sum weight (1 + u) / 2 + sum input weight x) / 2.
type ctrnn struct {
	taus, biases []float64
	drive        [][]float64 // of what stands in the row: inputs, 1, u
	row, u       []float64
	v, sums      []float64
	keep, take   []float64 // how much of a state is kept in a step, and how much of what drives it is taken
	owner        []int
}

func newCTRNN(document []byte, n *names) kernel {
	given := decoded[struct {
		sides
		TimeConstants []float64 `json:"time_constants"`
		Biases        []float64
		Weights       [][]float64
		InputWeights  [][]float64 `json:"input_weights"`
	}](document)
	even(n, "weights", given.Weights)
	even(n, "input_weights", given.InputWeights)
	if n.Err() != nil {
		return nil
	}
	entries := newEntries(given.sides, n)
	count := len(given.TimeConstants)
	const other = "neuron, of which there are as many as time_constants"
	same(n, "biases", len(given.Biases), count, "numbers", other)
	same(n, "weights", len(given.Weights), count, "rows", other)
	same(n, "weights", len(given.Weights[0]), count, "columns", other)
	same(n, "input_weights", len(given.InputWeights), count, "rows", other)
	entries.expect("input_weights", len(given.InputWeights[0]), &entries.inputs, "columns")
	if count < entries.outputs.count {
		n.Add("time_constants", "has %d neurons, too few for %d outputs", count, entries.outputs.count)
	}
	if n.Err() != nil {
		return nil
	}
	sensors := len(n.inputs)
	c := &ctrnn{
		taus: given.TimeConstants, biases: given.Biases, owner: entries.outputs.owner,
		drive: entries.spread(given.InputWeights, 1+count), row: make([]float64, sensors+1+count),
		v: make([]float64, count), sums: make([]float64, count), keep: make([]float64, count), take: make([]float64, count),
	}
	c.u = c.row[sensors+1:]
	c.row[sensors] = 1
	for i, row := range c.drive {
		for j := range sensors {
			row[j] = float64(0.5 * row[j])
		}
		row[sensors] = float64(0.5 * (given.Biases[i] + float64(0.5*total(given.Weights[i]))))
		for j, weight := range given.Weights[i] {
			row[sensors+1+j] = float64(0.25 * weight)
		}
	}
	return c
}

func (c *ctrnn) reset(_ uint64, dt float64) {
	for i, tau := range c.taus {
		c.keep[i] = elementary.Exp(-dt / tau)
		c.take[i] = 1 - c.keep[i]
		c.v[i] = float64(0.5 * c.biases[i])
		c.u[i] = elementary.Tanh(c.v[i])
	}
}

func (c *ctrnn) step(sensors, controls []float64) {
	hear(sensors, c.row)
	weigh(c.drive, c.row, c.sums)
	for i, sum := range c.sums {
		c.v[i] = float64(c.v[i]*c.keep[i]) + float64(sum*c.take[i])
		c.u[i] = elementary.Tanh(c.v[i])
	}
	pick(c.owner, c.u, controls)
}
