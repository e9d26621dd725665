package genome

import (
	"encoding/hex"
	"fmt"
	"maps"
	"math"
	"slices"

	"nmes/internal/blake2b"
)

const (
	mostNodes, mostLinks, mostNeurons, mostTerms = 1024, 16384, 512, 1024

	step = 0.3 // standard deviation of a change of a weight; of a large one, a third of itself
)

var activations = []string{"tanh", "sigmoid", "sin", "cos", "gauss", "relu", "abs", "identity"}

// wave is a number of an oscillator: its default, its bounds, how far it is moved, and how often.
type wave struct {
	name                                 string
	otherwise, low, high, spread, weight float64
}

var waves = []wave{
	{"frequency", 1, 0, 100, 0, 0.2},
	{"amplitude", 0.5, -10, 10, 0.15, 0.25},
	{"phase", 0, -100, 100, 0.5, 0.25},
	{"step", 0, -100, 100, 0.3, 0.1},
	{"offset", 0, -10, 10, 0.15, 0.2},
}

// brainChange is one change of a brain, which is a document, for the body that it drives.
type brainChange struct {
	brain           object
	inputs, outputs []string
	draw            *Draw
}

func changeBrain(kind string, brain object, body *Body, draw *Draw) bool {
	c := &brainChange{brain, body.Inputs(), body.Outputs(), draw}
	waves := brain["kind"] == "sine" || brain["kind"] == "cpg"
	switch {
	case kind == "weights":
		return !waves && c.weights()
	case kind == "oscillators":
		return waves && c.oscillators()
	case waves:
		return c.waveStructure()
	}
	switch brain["kind"] {
	case "mlp":
		return c.layers()
	case "ctrnn":
		return c.neurons()
	case "graph":
		return c.graph()
	}
	return false
}

func (c *brainChange) entries(name string) []object { return objects(c.brain, name) }

func (c *brainChange) append(name string, entry any) {
	c.brain[name] = append(list(c.brain, name), entry)
}

// normal draws a number as documents have it.
func (c *brainChange) normal(spread float64) float64 { return rounded(c.draw.Normal(spread), 6) }

func (c *brainChange) normals(count int, spread float64) array {
	row := make(array, count)
	for i := range row {
		row[i] = c.normal(spread)
	}
	return row
}

// weights shifts some of a network's numbers, at least one. All that was left out is written then.
func (c *brainChange) weights() bool {
	read, problems := readBrain(c.brain, bodyNames{inputs: c.inputs, outputs: c.outputs})
	if len(problems) > 0 {
		panic(problems) // the parent's brain is good
	}
	var vector []float64
	read.changeEach(func(value float64) float64 {
		vector = append(vector, value)
		return value
	})
	if len(vector) == 0 {
		return false
	}
	part := oneOf(c.draw, []float64{1.0 / float64(len(vector)), 0.1, 0.5})
	var chosen []int
	for i := range vector {
		if c.draw.Chance(part) {
			chosen = append(chosen, i)
		}
	}
	if chosen == nil {
		chosen = []int{c.draw.Count(0, len(vector)-1)}
	}
	for _, i := range chosen {
		moved := vector[i] + c.draw.Normal(float64(step*max(1, math.Abs(vector[i])/3)))
		// As numpy rounds, by a product and a quotient.
		vector[i] = math.RoundToEven(float64(moved*1e6)) / 1e6
	}
	at := 0
	read.changeEach(func(float64) float64 {
		at++
		return vector[at-1]
	})
	clear(c.brain)
	maps.Copy(c.brain, read.document)
	return true
}

func bounded(value, low, high float64) float64 { return rounded(min(max(value, low), high), 6) }

// oscillators changes one number of an oscillator, the frequency of all, or one of how they pull at each other.
func (c *brainChange) oscillators() bool {
	type term struct {
		name  string
		entry object
	}
	var terms []term
	for _, name := range []string{"links", "chains", "feedback"} {
		for _, entry := range c.entries(name) {
			terms = append(terms, term{name, entry})
		}
	}
	if len(terms) > 0 && c.draw.Chance(0.25) {
		chosen := oneOf(c.draw, terms)
		c.changeTerm(chosen.name, chosen.entry)
		return true
	}
	var weights []float64
	for _, each := range waves {
		weights = append(weights, each.weight)
	}
	what := weighted(c.draw, waves, weights)
	changed := c.entries("oscillators")
	together := what.name == "frequency" && c.draw.Chance(0.6)
	factor := c.draw.Factor(0.15)
	shift := c.draw.Normal(what.spread)
	if !together {
		changed = []object{oneOf(c.draw, changed)}
	}
	for _, each := range changed {
		value := number(each, what.name, what.otherwise)
		if what.name == "frequency" {
			value = float64(value * factor)
		} else {
			value += shift
		}
		each[what.name] = bounded(value, what.low, what.high)
	}
	return true
}

func (c *brainChange) changeTerm(name string, term object) {
	switch {
	case name == "feedback":
		what := oneOf(c.draw, []string{"rate", "offset"})
		term[what] = bounded(number(term, what, 0)+c.draw.Normal(0.5), -1000, 1000)
	case c.draw.Chance(0.5):
		term["lag"] = bounded(number(term, "lag", 0)+c.draw.Normal(0.4), -100, 100)
	default:
		term["weight"] = bounded(float64(number(term, "weight", 4)*c.draw.Factor(0.3)), -100, 100)
	}
}

// waveStructure gives one motor an oscillator of its own; of a cpg it also adds or takes away a link or a feedback.
func (c *brainChange) waveStructure() bool {
	what := "own"
	if c.brain["kind"] == "cpg" {
		what = oneOf(c.draw, []string{"own", "link", "feedback", "less"})
	}
	name := "feedback"
	switch what {
	case "own":
		return c.ownOscillator()
	case "less":
		names := slices.DeleteFunc([]string{"links", "chains", "feedback"}, func(name string) bool {
			return len(list(c.brain, name)) == 0
		})
		if len(names) == 0 {
			return false
		}
		name = oneOf(c.draw, names)
		c.brain[name] = removed(list(c.brain, name), oneOf(c.draw, list(c.brain, name)))
		return true
	case "link":
		name = "links"
	}
	var moved []string
	for _, motor := range c.outputs {
		if slices.ContainsFunc(c.entries("oscillators"), func(each object) bool { return fits(text(each, "motor", ""), motor) }) {
			moved = append(moved, motor)
		}
	}
	if len(list(c.brain, name)) >= mostTerms || len(moved) < 2 || what == "feedback" && len(c.inputs) == 0 {
		return false
	}
	var term object
	if what == "link" {
		source := oneOf(c.draw, moved)
		others := slices.DeleteFunc(slices.Clone(moved), func(motor string) bool { return motor == source })
		target := oneOf(c.draw, others)
		term = object{"from": source, "to": target, "weight": 4.0, "lag": rounded(c.draw.Uniform(-math.Pi, math.Pi), 6)}
	} else {
		sensor := oneOf(c.draw, c.inputs)
		term = object{"sensor": sensor, "motor": oneOf(c.draw, moved)}
		number := oneOf(c.draw, []string{"rate", "offset"})
		term[number] = c.normal(1)
	}
	c.append(name, term)
	return true
}

// ownOscillator gives a motor that shares an oscillator a copy of it for itself.
func (c *brainChange) ownOscillator() bool {
	entries := c.entries("oscillators")
	own := fieldsOf(entries, "motor")
	shared := slices.DeleteFunc(slices.Clone(c.outputs), func(motor string) bool { return slices.Contains(own, motor) })
	if len(shared) == 0 || len(entries) >= mostTerms {
		return false
	}
	motor := oneOf(c.draw, shared)
	like := entries[max(0, slices.IndexFunc(own, func(entry string) bool { return fits(entry, motor) }))]
	copied := cloned(like)
	copied["motor"] = motor
	copied["phase"] = bounded(number(like, "phase", 0)+c.draw.Normal(0.5), -100, 100)
	c.append("oscillators", copied)
	return true
}

// layers adds a hidden unit, takes one away, or changes an activation.
func (c *brainChange) layers() bool {
	layers := c.entries("layers")
	if len(layers) < 2 || c.draw.Chance(0.2) {
		activation := oneOf(c.draw, activations)
		oneOf(c.draw, layers)["activation"] = activation
		return true
	}
	at := c.draw.Count(0, len(layers)-2)
	layer, onward := layers[at], layers[at+1]
	units := len(list(layer, "biases"))
	if units > 1 && c.draw.Chance(0.4) {
		gone := c.draw.Count(0, units-1)
		for _, name := range []string{"weights", "biases"} {
			layer[name] = slices.Delete(list(layer, name), gone, gone+1)
		}
		withoutColumn(onward, "weights", gone)
		return true
	}
	if units >= mostNodes {
		return false
	}
	rows := list(layer, "weights")
	layer["weights"] = append(rows, c.normals(len(rows[0].(array)), 1))
	layer["biases"] = append(list(layer, "biases"), 0.0)
	c.withColumn(onward, "weights")
	return true
}

// withColumn and withoutColumn change each row of a matrix.
func (c *brainChange) withColumn(fields object, name string) {
	rows := list(fields, name)
	for i, row := range rows {
		rows[i] = append(row.(array), c.normal(step))
	}
}

func withoutColumn(fields object, name string, gone int) {
	rows := list(fields, name)
	for i, row := range rows {
		rows[i] = slices.Delete(row.(array), gone, gone+1)
	}
}

// neurons adds a neuron behind those of the motors, or takes one away there.
func (c *brainChange) neurons() bool {
	motors, neurons := len(c.outputs), len(list(c.brain, "biases"))
	if has(c.brain, "outputs") {
		motors = len(list(c.brain, "outputs"))
	}
	if neurons > motors && c.draw.Chance(0.4) {
		gone := c.draw.Count(motors, neurons-1)
		for _, name := range []string{"time_constants", "biases", "weights", "input_weights"} {
			c.brain[name] = slices.Delete(list(c.brain, name), gone, gone+1)
		}
		withoutColumn(c.brain, "weights", gone)
		return true
	}
	if neurons >= mostNeurons {
		return false
	}
	c.append("time_constants", rounded(float64(0.05*math.Pow(20, c.draw.Uniform(0, 1))), 6))
	c.append("biases", c.normal(1))
	c.withColumn(c.brain, "weights")
	c.append("weights", c.normals(neurons+1, 1))
	c.append("input_weights", c.normals(len(list(c.brain, "input_weights")[0].(array)), step))
	return true
}

// graph adds a link, splits one by a node, takes a link or a node away, or changes an activation.
func (c *brainChange) graph() bool {
	setDefault(c.brain, "links", array{})
	ways := []func() bool{c.addLink, c.splitLink, c.removeLink, c.removeNode, c.activate}
	return weighted(c.draw, ways, []float64{0.4, 0.25, 0.15, 0.05, 0.15})()
}

func (c *brainChange) addLink() bool {
	nodes, links := c.entries("nodes"), c.entries("links")
	type end struct{ side, name string }
	var sources []end
	for _, id := range fieldsOf(nodes, "id") {
		sources = append(sources, end{"from", id})
	}
	for _, name := range c.inputs {
		sources = append(sources, end{"sensor", name})
	}
	source := oneOf(c.draw, sources)
	target := text(oneOf(c.draw, nodes), "id", "")
	known := slices.ContainsFunc(links, func(link object) bool { return link[source.side] == source.name && link["to"] == target })
	if known || len(links) >= mostLinks {
		return false
	}
	c.append("links", object{source.side: source.name, "to": target, "weight": c.normal(1)})
	return true
}

// splitLink puts a node into a link: 1 on the way in and the old weight on the way out, as NEAT does.
func (c *brainChange) splitLink() bool {
	links, nodes := list(c.brain, "links"), c.entries("nodes")
	if len(links) == 0 || len(nodes) >= mostNodes || len(links) >= mostLinks-1 {
		return false
	}
	link := oneOf(c.draw, links).(object)
	side, to := "from", text(link, "to", "")
	if !has(link, "from") {
		side = "sensor"
	}
	source := text(link, side, "")
	node := splittingNode(side, source, to)
	if slices.Contains(fieldsOf(nodes, "id"), node) {
		return false // it was split before
	}
	c.append("nodes", object{"id": node, "activation": oneOf(c.draw, activations), "bias": 0.0})
	weight, there := link["weight"]
	if !there {
		weight = 1.0
	}
	c.brain["links"] = append(removed(links, link),
		object{side: source, "to": node}, object{"from": node, "to": to, "weight": weight})
	return true
}

// splittingNode returns the id of the node that splits a link, the same in every line of descent.
func splittingNode(side, source, to string) string {
	link := fmt.Sprintf("{'%s': %s} %s", side, quoted(source), to)
	return "split." + hex.EncodeToString(blake2b.Sum([]byte(link), 6))
}

func (c *brainChange) removeLink() bool {
	links := list(c.brain, "links")
	if len(links) == 0 {
		return false
	}
	c.brain["links"] = removed(links, oneOf(c.draw, links))
	return true
}

func (c *brainChange) removeNode() bool {
	hidden := slices.DeleteFunc(list(cloned(c.brain), "nodes"), func(node any) bool { return has(node.(object), "motor") })
	if len(hidden) == 0 {
		return false
	}
	node := oneOf(c.draw, hidden)
	id := node.(object)["id"]
	c.brain["nodes"] = removed(list(c.brain, "nodes"), node)
	c.brain["links"] = slices.DeleteFunc(list(c.brain, "links"), func(link any) bool {
		fields := link.(object)
		return fields["from"] == id || fields["to"] == id
	})
	return true
}

func (c *brainChange) activate() bool {
	activation := oneOf(c.draw, activations)
	oneOf(c.draw, c.entries("nodes"))["activation"] = activation
	return true
}
