package genome

import (
	"fmt"
	"slices"
	"strconv"
	"strings"
)

// inspection is what was found in a genome's document, its brain left out. The body is good only if there are no
// problems, nil if it cannot be read at all; absent are the ids of the cubes and joints that it lacks since they are
// wrong, * for one without an id.
type inspection struct {
	problems []Problem
	body     *Body
	absent   []string
}

// A document is judged in steps: by its schema, then as a body, then as a brain for that body. Nothing is blamed that
// may only follow from what an earlier step has left out.

func inspectBody(document any) inspection {
	if wrong := problemsOf(schemas()["genome"], document); len(wrong) > 0 {
		return inspectRest(document, wrong)
	}
	return inspectSound(document.(object))
}

func told(wrong []unsound) []Problem {
	problems := make([]Problem, len(wrong))
	for i, each := range wrong {
		problems[i] = Problem{each.at.pointer(), each.words}
	}
	return problems
}

// inspectSound judges the body of a document that is as its schema says.
func inspectSound(document object) inspection {
	body, place := document["body"].(object), ""
	graph, grows := body["graph"].(object)
	if has(body, "cubes") == grows || grows && has(body, "joints") {
		return inspection{problems: refused("body", "must have either cubes (and joints between them) or a graph").Problems}
	}
	if grows {
		grown, wrong := grow(graph)
		if wrong != nil {
			return inspection{problems: wrong.Problems}
		}
		// Scales may have taken a size or a mass out of its bounds.
		if outgrown := problemsOf(schemas()["genome"].Properties["body"], grown); len(outgrown) > 0 {
			problems := make([]Problem, len(outgrown))
			for i, each := range outgrown {
				words := fmt.Sprintf("grows %s is out of range: %s", quantity(grown, each.at), each.words)
				problems[i] = Problem{"body/graph", words}
			}
			return inspection{problems: problems}
		}
		body, place = grown, "body/graph"
	}
	read, problems := readBody(sourcesOf(document, body, place))
	return inspection{problems: problems, body: read}
}

func sourcesOf(document, body object, place string) sources {
	from := sources{
		cubes:       objects(body, "cubes"),
		joints:      objects(body, "joints"),
		voices:      objects(document, "voices"),
		later:       texts(list(document, "later")),
		development: objects(document, "development"),
		place:       place,
	}
	if has(document, "sensors") {
		from.sensors = objects(document, "sensors")
	}
	return from
}

// quantity returns words for a place in a grown body, such as cubes/3/mass.
func quantity(body object, at place) string {
	kind, index := at[0].(string), at[1].(int)
	id := text(objects(body, kind)[index], "id", "")
	return fmt.Sprintf("%s, of which the %s", quoted(id), at[2:].pointer())
}

// partPlaces are where parts stand that can be left out one by one.
var partPlaces = []string{"body/cubes", "body/joints", "sensors", "voices"}

// part returns the part in which a value stands, as its place and index; -1 where it is in none.
func (p place) part() (string, int) {
	for _, where := range partPlaces {
		if depth := strings.Count(where, "/") + 1; len(p) > depth && p[:depth].pointer() == where {
			index, _ := p[depth].(int)
			return where, index
		}
	}
	return "", -1
}

func partsAt(document object, where string) array {
	keys := strings.Split(where, "/")
	for _, key := range keys[:len(keys)-1] {
		document, _ = document[key].(object)
	}
	return list(document, keys[len(keys)-1])
}

// inspectRest judges what is left of a document without what its schema refuses.
func inspectRest(document any, wrong []unsound) inspection {
	found := inspection{problems: told(wrong)}
	if len(wrong) > mostProblems {
		return found
	}
	mended := without(document, wrong)
	leftOut := map[string]map[int]bool{}
	leave := func(at place) bool {
		where, index := at.part()
		if index >= 0 {
			if leftOut[where] == nil {
				leftOut[where] = map[int]bool{}
			}
			leftOut[where][index] = true
		}
		return index >= 0
	}
	for _, problem := range problemsOf(schemas()["genome"], mended) {
		if !leave(problem.at) {
			return found
		}
	}
	for _, problem := range wrong {
		inBody := len(problem.at) > 0 && problem.at[0] == "body"
		// A field that there is not may be one that is misspelt: of a joint its motor, of a body its joints.
		if inBody && len(problem.at) == 4 && problem.at[1] == "joints" {
			leave(problem.at)
		}
		inPart := slices.ContainsFunc(problem.at[min(2, len(problem.at)):], func(key any) bool {
			_, named := key.(string)
			return named
		})
		if inBody && !inPart {
			return found
		}
	}
	fields := mended.(object)
	body := fields["body"].(object)
	if !has(body, "cubes") {
		return found
	}
	kept := map[string][]int{}
	parts := map[string][]object{}
	for _, where := range partPlaces {
		for i, item := range partsAt(fields, where) {
			if leftOut[where][i] {
				if strings.HasPrefix(where, "body/") {
					found.absent = append(found.absent, nameOf(item))
				}
				continue
			}
			kept[where] = append(kept[where], i)
			parts[where] = append(parts[where], item.(object))
		}
	}
	if has(body, "graph") || len(kept["body/cubes"]) == 0 {
		return found
	}
	from := sources{cubes: parts["body/cubes"], joints: parts["body/joints"], voices: parts["voices"], absent: found.absent}
	if has(fields, "sensors") {
		from.sensors = append([]object{}, parts["sensors"]...)
	}
	read, others := readBody(from)
	for _, problem := range others {
		found.problems = append(found.problems, Problem{original(problem.Path, kept), problem.Message})
	}
	found.body = read
	return found
}

// nameOf returns the id of a part that is left out; *, which may be any, where it has no good one.
func nameOf(part any) string {
	fields, _ := part.(object)
	return text(fields, "id", "*")
}

// original returns where in the document that stands which has this path without what was left out.
func original(path string, kept map[string][]int) string {
	for _, where := range partPlaces {
		rest, inside := strings.CutPrefix(path, where+"/")
		if !inside || len(kept[where]) == 0 {
			continue
		}
		index, further, deeper := strings.Cut(rest, "/")
		at, err := strconv.Atoi(index)
		if err != nil {
			panic(err) // this package has written it
		}
		path = fmt.Sprintf("%s/%d", where, kept[where][at])
		if deeper {
			path += "/" + further
		}
	}
	return path
}

// inspectBrain judges a document's brain, for the body that was found in it.
func inspectBrain(document any, found inspection) []Problem {
	fields, _ := document.(object)
	wrong := map[string]bool{}
	onlyBody := true
	for _, problem := range found.problems {
		top, _, _ := strings.Cut(problem.Path, "/")
		wrong[top] = true
		onlyBody = onlyBody && top == "body"
	}
	if !has(fields, "brain") || wrong["brain"] {
		return nil
	}
	names := bodyNames{unsure: map[string]bool{"sensor": true, "motor": true}}
	if found.body != nil && !slices.Contains(found.absent, "*") {
		names = bodyNames{inputs: found.body.Inputs(), outputs: found.body.Outputs(), unsure: map[string]bool{}}
		names.unsure["sensor"] = len(found.absent) > 0 || !onlyBody
		names.unsure["motor"] = wrong["voices"]
		if len(found.absent) > 0 {
			able := append(slices.Clone(names.outputs), found.absent...)
			names.outputs = nil
			for _, joint := range objects(fields["body"].(object), "joints") {
				if id := text(joint, "id", "*"); slices.Contains(able, id) {
					names.outputs = append(names.outputs, id)
				}
			}
			for _, voice := range found.body.Voices {
				names.outputs = append(names.outputs, voice.ID)
			}
		}
	}
	_, problems := readBrain(fields["brain"], names)
	return problems
}
