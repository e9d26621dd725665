package genome

import (
	"fmt"
	"maps"
	"math"
	"slices"
)

const neuronTime = 0.3 // s: of a neuron that comes with a motor

// carried is a brain that goes along when its body changes, by the names of sensors and motors: what still has its name
// keeps its weights; what is gone is taken out; a motor that is new gets a part of the brain of its own, drawn at random,
// and a new sensor is there to be listened to.
type carried struct {
	brain                      object
	inputs, outputs            []string // of the body now
	inputsBefore, motorsBefore []string
	draw                       *Draw
}

func carryOver(brain object, before, after *Body, draw *Draw) object {
	c := &carried{brain, after.Inputs(), after.Outputs(), before.Inputs(), before.Outputs(), draw}
	switch brain["kind"] {
	case "mlp":
		return c.mlp()
	case "ctrnn":
		return c.ctrnn()
	case "graph":
		return c.graph()
	}
	return c.waves()
}

// dealt deals names out to entries as brains do; it returns which entries have some, and which names have none.
func dealt(entries, names []string) (owning []int, free []string) {
	taken := map[string]bool{}
	isFree := func(name string) bool { return !taken[name] }
	var exact, others []int
	for i, entry := range entries {
		if slices.Contains(names, entry) {
			exact = append(exact, i)
		} else {
			others = append(others, i)
		}
	}
	for _, i := range append(exact, others...) {
		own := []string{entries[i]}
		if !slices.Contains(names, entries[i]) {
			own = patterned(entries[i], names)
		}
		if slices.ContainsFunc(own, isFree) {
			owning = append(owning, i)
		}
		for _, name := range own {
			taken[name] = true
		}
	}
	for _, name := range names {
		if isFree(name) {
			free = append(free, name)
		}
	}
	slices.Sort(owning)
	return owning, free
}

// patterned returns the names that an entry with wildcards stands for.
func patterned(entry string, names []string) []string {
	if !isPattern(entry) {
		return nil
	}
	return fitting(entry, names)
}

// standsForAny tells whether an entry stands for anything.
func standsForAny(entry string, names []string) bool {
	return slices.Contains(names, entry) || len(patterned(entry, names)) > 0
}

// newOf returns those that were not there before.
func newOf(names, before []string) []string {
	var found []string
	for _, name := range names {
		if !slices.Contains(before, name) {
			found = append(found, name)
		}
	}
	return found
}

// oscillator draws an oscillator for a motor, of the frequency of one of those that are there.
func (c *carried) oscillator(motor string, like array) object {
	var frequency any
	if len(like) > 0 {
		var there bool
		if frequency, there = oneOf(c.draw, like).(object)["frequency"]; !there {
			frequency = 1.0
		}
	} else {
		frequency = rounded(float64(0.5*math.Pow(6, c.draw.Uniform(0, 1))), 6)
	}
	amplitude := rounded(c.draw.Uniform(0.3, 1), 6)
	phase := rounded(c.draw.Uniform(-math.Pi, math.Pi), 6)
	return object{"motor": motor, "frequency": frequency, "amplitude": amplitude, "phase": phase}
}

// waves is of sine and cpg.
func (c *carried) waves() object {
	before := list(c.brain, "oscillators")
	owning, free := dealt(fieldsOf(objects(c.brain, "oscillators"), "motor"), c.outputs)
	added := newOf(free, c.motorsBefore)
	changed := maps.Clone(c.brain)
	kept := array{}
	for _, i := range owning {
		kept = append(kept, before[i])
	}
	all := kept
	for _, motor := range added {
		all = append(all, c.oscillator(motor, kept))
	}
	changed["oscillators"] = all
	var moved []string
	for _, motor := range c.outputs {
		if !slices.Contains(free, motor) || slices.Contains(added, motor) {
			moved = append(moved, motor)
		}
	}
	keep := func(name string, good func(object) bool) {
		if has(changed, name) {
			changed[name] = slices.DeleteFunc(slices.Clone(list(changed, name)), func(term any) bool { return !good(term.(object)) })
		}
	}
	keep("links", func(link object) bool { return linksTwo(link, moved) })
	keep("chains", func(chain object) bool { return standsForAny(text(chain, "motors", ""), moved) })
	keep("feedback", func(term object) bool {
		return standsForAny(text(term, "sensor", ""), c.inputs) && standsForAny(text(term, "motor", ""), moved)
	})
	return changed
}

func linksTwo(link object, motors []string) bool {
	ends := func(side string) []string {
		var found []string
		for _, name := range motors {
			if standsForAny(text(link, side, ""), []string{name}) {
				found = append(found, name)
			}
		}
		return found
	}
	from, to := ends("from"), ends("to")
	return len(from) > 0 && len(to) > 0 && !(len(from) == 1 && slices.Equal(from, to))
}

const isNew = -1 // in place of the row or column that an entry had

// columns returns a network's inputs in the body now and, for each, the column that it had.
func (c *carried) columns() (kept []string, columns []int) {
	kept, columns, free := c.side("inputs", c.inputsBefore, c.inputs)
	if len(kept) == 0 && len(free) > 0 {
		kept, columns = free[:1], []int{isNew}
	}
	return kept, columns
}

// rows returns a network's outputs in the body now and, for each, the row that it had.
func (c *carried) rows() (kept []string, rows []int) {
	kept, rows, _ = c.side("outputs", c.motorsBefore, c.outputs)
	return kept, rows
}

func (c *carried) side(name string, before, now []string) (kept []string, had []int, free []string) {
	entries := before
	if has(c.brain, name) {
		entries = texts(list(c.brain, name))
	}
	owning, free := dealt(entries, now)
	for _, i := range owning {
		kept, had = append(kept, entries[i]), append(had, i)
	}
	for _, each := range newOf(free, before) {
		kept, had = append(kept, each), append(had, isNew)
	}
	return kept, had, free
}

// taken returns a row's numbers in other columns, with zeros in those that are new.
func taken(row any, columns []int) array {
	result := make(array, len(columns))
	for i, column := range columns {
		result[i] = 0.0
		if column != isNew {
			result[i] = row.(array)[column]
		}
	}
	return result
}

// weak draws the weights of a new unit, the weaker the more it listens to.
func (c *carried) weak(count int) array {
	result := make(array, count)
	for i := range result {
		result[i] = rounded(c.draw.Normal(1/math.Sqrt(float64(max(count, 1)))), 6)
	}
	return result
}

// numbersFor returns a number for each row: that which it had, or one for those that are new.
func numbersFor(numbers array, rows []int, fresh float64) array {
	result := make(array, len(rows))
	for i, row := range rows {
		result[i] = fresh
		if row != isNew {
			result[i] = numbers[row]
		}
	}
	return result
}

// rowsFor returns a row for each: that which it had, in other columns, or one that is drawn.
func (c *carried) rowsFor(matrix array, rows, columns []int) array {
	result := make(array, len(rows))
	for i, row := range rows {
		if row == isNew {
			result[i] = c.weak(len(columns))
		} else {
			result[i] = taken(matrix[row], columns)
		}
	}
	return result
}

func upTo(from, to int) []int {
	var result []int
	for i := from; i < to; i++ {
		result = append(result, i)
	}
	return result
}

func (c *carried) mlp() object {
	inputs, columns := c.columns()
	outputs, rows := c.rows()
	changed := maps.Clone(c.brain)
	layers := array{}
	for _, layer := range objects(c.brain, "layers") {
		layers = append(layers, maps.Clone(layer))
	}
	first, last := layers[0].(object), layers[len(layers)-1].(object)
	count := len(list(first, "weights"))
	first["weights"] = c.rowsFor(list(first, "weights"), upTo(0, count), columns)
	width := len(list(last, "weights")[0].(array))
	last["weights"] = c.rowsFor(list(last, "weights"), rows, upTo(0, width))
	last["biases"] = numbersFor(list(last, "biases"), rows, 0)
	changed["inputs"], changed["outputs"], changed["layers"] = anyOf(inputs), anyOf(outputs), layers
	return changed
}

func (c *carried) ctrnn() object {
	inputs, columns := c.columns()
	outputs, rows := c.rows()
	motors := len(c.motorsBefore)
	if has(c.brain, "outputs") {
		motors = len(list(c.brain, "outputs"))
	}
	// The neurons behind those of motors stay as they are.
	order := append(rows, upTo(motors, len(list(c.brain, "biases")))...)
	changed := maps.Clone(c.brain)
	changed["inputs"], changed["outputs"] = anyOf(inputs), anyOf(outputs)
	changed["time_constants"] = numbersFor(list(c.brain, "time_constants"), order, neuronTime)
	changed["biases"] = numbersFor(list(c.brain, "biases"), order, 0)
	changed["weights"] = c.rowsFor(list(c.brain, "weights"), order, order)
	changed["input_weights"] = c.rowsFor(list(c.brain, "input_weights"), order, columns)
	return changed
}

func (c *carried) graph() object {
	var driving []object
	for _, node := range objects(c.brain, "nodes") {
		if has(node, "motor") {
			driving = append(driving, node)
		}
	}
	owning, free := dealt(fieldsOf(driving, "motor"), c.outputs)
	kept := map[any]bool{}
	for _, i := range owning {
		kept[driving[i]["id"]] = true
	}
	nodes, links := array{}, array{}
	var ids []string
	for _, node := range objects(c.brain, "nodes") {
		if !has(node, "motor") || kept[node["id"]] {
			nodes, ids = append(nodes, node), append(ids, text(node, "id", ""))
		}
	}
	for _, link := range objects(c.brain, "links") {
		good := slices.Contains(ids, text(link, "to", ""))
		if has(link, "from") {
			good = good && slices.Contains(ids, text(link, "from", ""))
		} else {
			good = good && standsForAny(text(link, "sensor", ""), c.inputs)
		}
		if good {
			links = append(links, link)
		}
	}
	for _, motor := range newOf(free, c.motorsBefore) {
		id := motor
		for number := 2; slices.Contains(ids, id); number++ {
			id = fmt.Sprintf("%s.%d", motor, number)
		}
		if len(ids) > 0 {
			from := oneOf(c.draw, ids)
			links = append(links, object{"from": from, "to": id, "weight": rounded(c.draw.Normal(1), 6)})
		}
		if len(c.inputs) > 0 {
			sensor := oneOf(c.draw, c.inputs)
			links = append(links, object{"sensor": sensor, "to": id, "weight": rounded(c.draw.Normal(1), 6)})
		}
		nodes = append(nodes, object{"id": id, "motor": motor, "activation": "tanh", "bias": 0.0})
		ids = append(ids, id)
	}
	changed := maps.Clone(c.brain)
	changed["nodes"], changed["links"] = nodes, links
	return changed
}
