package genome

import (
	"fmt"
	"math"
	"slices"
	"strings"
)

const (
	mostInputs, mostOutputs = 4096, 1024
	mostEdges               = 4096 // links between oscillators, once wildcards are resolved
)

var brainKinds = []string{"sine", "cpg", "mlp", "ctrnn", "graph", "onnx"}

// brain is a checked document of a brain, its defaults filled in.
type brain struct {
	schema   *schema
	document object
}

// readBrain returns the brain that a document describes, for a body with these sensors and motors, or what is wrong.
//
// Of an ONNX model it judges what the schema says, and the names; nothing here runs such a model.
func readBrain(document any, names bodyNames) (*brain, []Problem) {
	fields, _ := document.(object)
	kind, good := fields["kind"].(string)
	kinds := strings.Join(brainKinds, ", ")
	if fields["kind"] == nil {
		return nil, refused("brain", "a brain is an object with a 'kind': "+kinds).Problems
	}
	if !good || !slices.Contains(brainKinds, kind) {
		hint := didYouMean(kind, brainKinds)
		if hint == "" {
			hint = ": there are " + kinds
		}
		return nil, refused("brain/kind", "there is no such kind of brain"+hint).Problems
	}
	f := &findings{names: names, unknown: map[[2]string]*unknownName{}}
	if len(names.inputs) > mostInputs {
		f.add("", "the body has %s sensors; a brain can have %s", thousands(len(names.inputs)), thousands(mostInputs))
	}
	if len(names.outputs) > mostOutputs {
		f.add("", "the body has %s motors; a brain can have %s", thousands(len(names.outputs)), thousands(mostOutputs))
	}
	b := &brain{schema: schemas()["brain-"+kind]}
	sound, whole := f.sound(b.schema, fields)
	if !whole || !f.evenRows(b.schema, sound, "") || f.full() {
		return nil, f.found
	}
	b.document = complete(b.schema, sound)
	map[string]func(object, *findings){
		"sine": resolveSine, "cpg": resolveCpg, "mlp": resolveMlp,
		"ctrnn": resolveCtrnn, "graph": resolveGraph, "onnx": resolveOnnx,
	}[kind](b.document, f)
	return b, f.found
}

// sound returns the parts of a document that fit its schema, and whether that is still a brain.
func (f *findings) sound(s *schema, document object) (object, bool) {
	wrong := problemsOf(s, document)
	for _, problem := range wrong {
		f.add(problem.at.pointer(), "%s", problem.words)
	}
	if len(wrong) == 0 {
		return document, true
	}
	sound := without(document, wrong).(object)
	return sound, !f.full() && len(problemsOf(s, sound)) == 0
}

// isRow tells whether this is an array of parameters, or of rows of them.
func (s *schema) isRow() bool {
	return s.Items != nil && (s.Items.Parameter || s.Items.Type == "array" && s.Items.isRow())
}

// evenRows notes rows of unequal length; it tells whether there are none.
func (f *findings) evenRows(s *schema, value object, path string) bool {
	even := true
	for _, name := range s.Order {
		part := s.Properties[name]
		switch {
		case part.isRow() && part.Items.Type == "array":
			rows := list(value, name)
			for i, row := range rows {
				if got, first := len(row.(array)), len(rows[0].(array)); got != first {
					f.add(fmt.Sprintf("%s%s/%d", path, name, i), "has %d numbers, the first row %d", got, first)
					even = false
				}
			}
		case part.Items != nil && part.Items.Type == "object":
			for i, item := range objects(value, name) {
				even = f.evenRows(part.Items, item, fmt.Sprintf("%s%s/%d/", path, name, i)) && even
			}
		}
	}
	return even
}

// parameters calls a function for each container of parameters, with where they stand in it, in the order of the schema.
func parameters(s *schema, value object, do func(value object, name string, part *schema)) {
	for _, name := range s.Order {
		part := s.Properties[name]
		switch {
		case part.Parameter || part.isRow():
			do(value, name, part)
		case part.Items != nil && part.Items.Type == "object":
			for _, item := range objects(value, name) {
				parameters(part.Items, item, do)
			}
		}
	}
}

// changeEach replaces all parameters by what a function makes of them, kept within their bounds.
func (b *brain) changeEach(change func(float64) float64) {
	parameters(b.schema, b.document, func(value object, name string, part *schema) {
		value[name] = changed(part, value[name], change)
	})
}

func changed(part *schema, value any, change func(float64) float64) any {
	if items, many := value.(array); many {
		result := make(array, len(items))
		for i, item := range items {
			result[i] = changed(part.Items, item, change)
		}
		return result
	}
	return math.Min(math.Max(change(mustNumber(value)), *part.Minimum), *part.Maximum)
}

// -- kinds -----------------------------------------------------------------------------------------------------------

func pointerOf(format string) func(int) string {
	return func(i int) string { return fmt.Sprintf(format, i) }
}

// oscillators deals out motors; it tells which are driven, and whether each oscillator names motors that there are.
func oscillators(document object, f *findings) (drives []bool, named bool) {
	entries := fieldsOf(objects(document, "oscillators"), "motor")
	named = true
	for _, owner := range f.owners(entries, "motor", pointerOf("oscillators/%d/motor")) {
		drives = append(drives, owner >= 0)
	}
	for _, entry := range entries {
		named = named && !f.isUnknown(entry, "motor")
	}
	return drives, named
}

func fieldsOf(entries []object, name string) []string {
	return namesOf(entries, func(entry object) string { return text(entry, name, "") })
}

func resolveSine(document object, f *findings) { oscillators(document, f) }

func resolveCpg(document object, f *findings) {
	drives, named := oscillators(document, f)
	swung := func(entry, pointer string) []int {
		motors := f.match(entry, "motor", pointer)
		found := slices.DeleteFunc(slices.Clone(motors), func(motor int) bool { return !drives[motor] })
		if len(motors) > 0 && len(found) == 0 && named { // a wrongly named one may be theirs
			if slices.Contains(f.names.outputs, entry) {
				f.add(pointer, "the motor %s has no oscillator", quoted(entry))
			} else {
				f.add(pointer, "no motor that fits %s has an oscillator", quoted(entry))
			}
		}
		return found
	}
	edges := 0
	for i, link := range objects(document, "links") {
		here := fmt.Sprintf("links/%d", i)
		sources := swung(text(link, "from", ""), here+"/from")
		targets := swung(text(link, "to", ""), here+"/to")
		if edges+len(sources)*len(targets) > 2*mostEdges { // however many of them are of one with itself
			f.add(here, "with it there are over %s links between two oscillators", thousands(mostEdges))
			return
		}
		count := len(sources) * len(targets)
		for _, source := range sources {
			if slices.Contains(targets, source) {
				count--
			}
		}
		if len(sources) > 0 && len(targets) > 0 && count == 0 {
			f.add(here, "links an oscillator with itself")
		}
		edges += count
	}
	for i, chain := range objects(document, "chains") {
		row := swung(text(chain, "motors", ""), fmt.Sprintf("chains/%d/motors", i))
		edges += 2 * max(0, len(row)-1)
	}
	if edges > mostEdges {
		words := "makes %s links between two oscillators, at most %s"
		f.add("links", words, thousands(edges), thousands(mostEdges))
	}
	for i, term := range objects(document, "feedback") {
		f.match(text(term, "sensor", ""), "sensor", fmt.Sprintf("feedback/%d/sensor", i))
		swung(text(term, "motor", ""), fmt.Sprintf("feedback/%d/motor", i))
	}
}

// sides are the entries of a network's inputs and outputs: how many there are, and whether they are listed.
type sides struct {
	f      *findings
	counts map[string]int
	listed map[string]bool
}

func sidesOf(document object, f *findings) sides {
	s := sides{f, map[string]int{}, map[string]bool{}}
	for _, side := range []struct{ name, what string }{{"inputs", "sensor"}, {"outputs", "motor"}} {
		entries := f.names.of(side.what)
		if has(document, side.name) {
			entries = texts(list(document, side.name))
		}
		s.listed[side.name], s.counts[side.name] = has(document, side.name), len(entries)
		f.owners(entries, side.what, pointerOf(side.name+"/%d"))
	}
	return s
}

// expect compares a length with the number of entries of one side.
func (s *sides) expect(pointer string, got int, side, each string) {
	wanted, what := s.counts[side], "motors"
	if side == "inputs" {
		what = "sensors"
	}
	switch {
	case got == wanted || (s.f.names.unsure["sensor"] || s.f.names.unsure["motor"]) && !s.listed[side]:
	case s.listed[side]:
		s.f.add(pointer, "has %d %s, and there must be %d, one for each entry of %s", got, each, wanted, side)
	default:
		words := "has %d %s, and the body has %d %s: a list '%s' would say which are meant"
		s.f.add(pointer, words, got, each, wanted, what, side)
	}
}

func sameLength(f *findings, pointer string, got, wanted int, each, other string) {
	if got != wanted {
		f.add(pointer, "has %d %s, and there must be %d, one for each %s", got, each, wanted, other)
	}
}

// shape returns how many rows a matrix has, and how many numbers each of them.
func shape(fields object, name string) (int, int) {
	rows := list(fields, name)
	return len(rows), len(rows[0].(array))
}

func resolveMlp(document object, f *findings) {
	entries := sidesOf(document, f)
	before := 0
	layers := objects(document, "layers")
	for i, layer := range layers {
		here := fmt.Sprintf("layers/%d/", i)
		units, columns := shape(layer, "weights")
		if i == 0 {
			entries.expect(here+"weights", columns, "inputs", "columns")
		} else {
			sameLength(f, here+"weights", columns, before, "columns", "unit of the layer before")
		}
		sameLength(f, here+"biases", len(list(layer, "biases")), units, "numbers", "row of the weights")
		before = units
	}
	entries.expect(fmt.Sprintf("layers/%d/weights", len(layers)-1), before, "outputs", "rows")
}

func resolveCtrnn(document object, f *findings) {
	entries := sidesOf(document, f)
	n, other := len(list(document, "time_constants")), "neuron, of which there are as many as time_constants"
	rows, columns := shape(document, "weights")
	inputRows, inputs := shape(document, "input_weights")
	sameLength(f, "biases", len(list(document, "biases")), n, "numbers", other)
	sameLength(f, "weights", rows, n, "rows", other)
	sameLength(f, "weights", columns, n, "columns", other)
	sameLength(f, "input_weights", inputRows, n, "rows", other)
	entries.expect("input_weights", inputs, "inputs", "columns")
	if motors := entries.counts["outputs"]; n < motors {
		f.add("time_constants", "has %d neurons, too few for %d outputs", n, motors)
	}
}

func resolveGraph(document object, f *findings) {
	ids := map[string]bool{}
	var known, motors []string
	var motored []int
	for i, node := range objects(document, "nodes") {
		id := text(node, "id", "")
		if ids[id] {
			f.add(fmt.Sprintf("nodes/%d/id", i), "there is another node %s", quoted(id))
		} else {
			known = append(known, id)
		}
		ids[id] = true
		if has(node, "motor") {
			motored = append(motored, i)
			motors = append(motors, text(node, "motor", ""))
		}
	}
	if len(motored) == 0 {
		f.add("nodes", "no node drives a motor: give one a 'motor'")
	}
	f.owners(motors, "motor", func(i int) string { return fmt.Sprintf("nodes/%d/motor", motored[i]) })
	seen := map[[3]string]int{}
	for i, link := range objects(document, "links") {
		here := fmt.Sprintf("links/%d", i)
		if has(link, "from") == has(link, "sensor") {
			f.add(here, "must have either 'from' or 'sensor'")
			continue
		}
		side := "sensor"
		if has(link, "from") {
			side = "from"
		}
		key := [3]string{side, text(link, side, ""), text(link, "to", "")}
		if first, already := seen[key]; already {
			f.add(here, "links what link %d does", first)
		} else {
			seen[key] = i
		}
		for _, end := range []string{"from", "to"} {
			if name := text(link, end, ""); has(link, end) && !ids[name] {
				f.noted(name, known, "node", here+"/"+end)
			}
		}
		if side == "sensor" {
			f.match(text(link, "sensor", ""), "sensor", here+"/sensor")
		}
	}
}

func resolveOnnx(document object, f *findings) { sidesOf(document, f) }
