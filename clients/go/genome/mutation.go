package genome

import (
	"errors"
	"fmt"
	"slices"
	"strings"
)

// Kinds are the kinds of mutation, as docs/evolution.md tells of them.
var Kinds = []string{
	"add-part", "remove-part", "resize-part", "move-part", "joint", "limits", "axis", "motor", "symmetry", "recursion",
	"sensors", "weights", "oscillators", "topology", "voices", "shape", "development",
}

// kindWeights says how often each is drawn where it can be, relative to the others.
var kindWeights = []float64{1.0, 0.8, 1.5, 1.2, 0.3, 0.6, 0.4, 1.0, 0.4, 0.4, 0.4, 4.0, 4.0, 1.0, 0.4, 0.8, 1.0}

const (
	tries         = 100
	mostFruitless = 20 // draws in a row after which a kind that is asked for has nothing to change
)

var varied = []string{"body", "later", "development", "sensors", "voices", "brain"}

// Mutant is a genome and the kind of mutation by which it came about; its parents name the one that it came from.
type Mutant struct {
	Genome *Genome
	Kind   string
}

// VariationError is a genome that cannot be varied as asked.
type VariationError struct {
	// unknown_mutation, no_offspring, or unsupported: what only NMES itself can change.
	Code    string
	Message string
}

func (e *VariationError) Error() string { return "genome: " + e.Message }

// Requirements are what a mutant's body must be like, and what it may come to sense and say. Nothing is required by their
// zero value.
type Requirements struct {
	Limits Limits
	// Whether it must lie in the plane z = 0.
	Planar bool
	// Types of sensors of cubes that are of use where it will live, besides those that are everywhere.
	Senses []string
	// The channels on which it may come to speak and hear.
	Channels []Channel
	// What its parts may come to be besides boxes: sphere, capsule, cylinder.
	Shapes []string
	// Whether it may come to develop.
	Development bool
}

// Channel is a channel of a world, and how many numbers it has.
type Channel struct {
	Name string
	Size int
}

// Check returns the reasons why a body does not meet the requirements, in words; none if it does.
func (r *Requirements) Check(body *Body) []string {
	reasons := r.Limits.check(body)
	if r.Planar && !body.planar() {
		reasons = append(reasons, "it leaves the plane z = 0, and the engine knows no other")
	}
	return reasons
}

// Mutate changes a genome a little: by one of the Kinds, or, where none is named, by one that is drawn. A mutant is a good
// genome; it follows from its parent, the kind, the requirements and the draw alone, and is the one that NMES makes of
// them. The error is a *VariationError.
func Mutate(parent *Genome, draw *Draw, kind string, needs Requirements) (*Mutant, error) {
	kinds, weights := []string{kind}, []float64{1}
	switch {
	case kind == "":
		kinds, weights = needs.kinds()
	case !slices.Contains(Kinds, kind):
		hint := didYouMean(kind, Kinds)
		if hint == "" {
			hint = ": there are " + strings.Join(Kinds, ", ")
		}
		return nil, &VariationError{"unknown_mutation", fmt.Sprintf("there is no kind of mutation %s%s", quoted(kind), hint)}
	}
	if parent.BrainKind() == "onnx" {
		return nil, &VariationError{"unsupported", "a genome whose brain is an ONNX model is varied by NMES itself alone"}
	}
	reason, fruitless := "there is nothing of that kind to change", 0
	for range tries {
		chosen := kind
		if kind == "" {
			chosen = weighted(draw, kinds, weights)
		}
		m := &mutation{document: parent.Document(), body: &parent.Body, draw: draw, needs: &needs}
		if m.change(chosen) {
			child, err := m.offspring(parent)
			var wrong *DocumentError
			if errors.As(err, &wrong) {
				reason, fruitless = "the last "+wrong.Problems[0].Message, 0
				continue
			}
			if !sameCreature(child.document, parent.document) {
				return &Mutant{child, chosen}, nil
			}
		}
		if fruitless++; fruitless == mostFruitless && kind != "" {
			break
		}
	}
	what := "mutation"
	if kind != "" {
		what += " " + quoted(kind)
	}
	words := fmt.Sprintf("no try gave a good %s of %s: %s", what, quoted(parent.Name), reason)
	return nil, &VariationError{"no_offspring", words}
}

// kinds returns those that may change anything: they draw nothing elsewhere.
func (r *Requirements) kinds() ([]string, []float64) {
	idle := map[string]bool{"voices": len(r.Channels) == 0, "shape": len(r.Shapes) == 0, "development": !r.Development}
	var kinds []string
	var weights []float64
	for i, kind := range Kinds {
		if !idle[kind] {
			kinds, weights = append(kinds, kind), append(weights, kindWeights[i])
		}
	}
	return kinds, weights
}

func sameCreature(one, other object) bool {
	return !slices.ContainsFunc(varied, func(name string) bool { return !equal(one[name], other[name]) })
}

// mutation is one try: a document that is changed, the body as it was, and all choices.
type mutation struct {
	document object
	body     *Body
	draw     *Draw
	needs    *Requirements
}

// change makes one change to the document; it returns whether there was anything to change.
func (m *mutation) change(kind string) bool {
	switch kind {
	case "weights", "oscillators", "topology":
		brain, there := m.document["brain"].(object)
		return there && changeBrain(kind, brain, m.body, m.draw)
	case "development":
		return changeDevelopment(m.document, m.body, m.draw)
	case "sensors":
		return m.sensors()
	case "voices":
		return m.voices()
	case "shape":
		return m.shape()
	}
	body := m.document["body"].(object)
	if graph, grows := body["graph"].(object); grows {
		setDefault(graph, "connections", array{})
		return (&graphChange{graph, m.body, m.draw, m.needs.Planar}).change(kind)
	}
	setDefault(body, "joints", array{})
	return (&cubeChange{body, m.body, m.draw, m.needs.Planar}).change(kind)
}

func setDefault(fields object, name string, value any) {
	if !has(fields, name) {
		fields[name] = value
	}
}

// shape gives a part another of the shapes that there are.
func (m *mutation) shape() bool {
	body := m.document["body"].(object)
	graph, grows := body["graph"].(object)
	parts := list(body, "cubes")
	if grows {
		parts = list(graph, "parts")
	}
	if len(m.needs.Shapes) == 0 {
		return false
	}
	part := oneOf(m.draw, parts).(object)
	present := text(part, "shape", "box")
	others := slices.DeleteFunc(append([]string{"box"}, m.needs.Shapes...), func(shape string) bool { return shape == present })
	if len(others) == 0 {
		return false
	}
	shape, old := oneOf(m.draw, others), edgesOf(part)
	size := fit(shape, old)
	part["size"] = anyOf(size[:])
	if shape == "box" {
		delete(part, "shape")
	} else {
		part["shape"] = shape
	}
	if !grows {
		ratio := volume(shape, size) / volume(present, old)
		part["mass"] = rounded(max(float64(number(part, "mass", 0)*ratio), 0.001), 6)
		(&cubeChange{body, m.body, m.draw, false}).stand()
	}
	return true
}

// fit returns the edges nearest to some, m, that a shape may have, rounded as documents have them.
func fit(shape string, size Vector) Vector {
	size = fitted(shape, size)
	for k := range size {
		size[k] = rounded(size[k], 6)
	}
	return size
}

// voices adds a voice on one of the channels that there are, or takes one away.
func (m *mutation) voices() bool {
	setDefault(m.document, "voices", array{})
	voices := list(m.document, "voices")
	if len(voices) > 0 && m.draw.Chance(0.4) {
		m.document["voices"] = removed(voices, oneOf(m.draw, voices))
		return true
	}
	if len(voices) >= mostVoices || len(m.needs.Channels) == 0 {
		return false
	}
	m.document["voices"] = append(voices, m.channelNumber())
	return true
}

// channelNumber draws a number of a channel, as sensors and voices name it.
func (m *mutation) channelNumber() object {
	channel := oneOf(m.draw, m.needs.Channels)
	return object{"channel": channel.Name, "number": float64(m.draw.Count(1, channel.Size))}
}

// removed returns an array without the first item that is equal to one.
func removed(items array, item any) array {
	at := slices.IndexFunc(items, func(each any) bool { return equal(each, item) })
	return slices.Delete(items, at, at+1)
}
