package genome

import (
	"fmt"
	"slices"
)

// Rule is one rule of a body's development: when it applies, and what it does then, as its document says.
type Rule struct {
	When  string
	Shed  []string
	Adopt []string
	Grow  []string
}

var ruleLists = []string{"shed", "adopt", "grow"}

// readRules reads the development of a document that its schema has accepted, for a whole body: what is wrong, and the
// rules that could be read.
func readRules(entries []object, body *Body) ([]Problem, []Rule) {
	var problems []Problem
	var rules []Rule
	parts := map[string][]string{"sense": body.Inputs(), "has": namesOf(body.Cubes, cubeID)}
	for i, entry := range entries {
		if len(problems) > mostProblems {
			break // no more are told
		}
		path := fmt.Sprintf("development/%d", i)
		found := wrongWithRule(entry, path, body)
		problems = append(problems, found...)
		if words := wrongCondition(text(entry, "when", ""), parts); words != "" {
			problems = append(problems, Problem{path + "/when", words})
			continue
		}
		if len(found) == 0 {
			rules = append(rules, Rule{
				When:  text(entry, "when", ""),
				Shed:  texts(list(entry, "shed")),
				Adopt: texts(list(entry, "adopt")),
				Grow:  texts(list(entry, "grow")),
			})
		}
	}
	return problems, rules
}

func wrongWithRule(entry object, path string, body *Body) []Problem {
	var problems []Problem
	note := func(path, format string, values ...any) {
		problems = append(problems, Problem{path, fmt.Sprintf(format, values...)})
	}
	known, root := namesOf(body.Cubes, cubeID), body.Cubes[0].ID
	type named struct{ path, name string }
	var places []named
	for _, kind := range ruleLists {
		for i, name := range texts(list(entry, kind)) {
			places = append(places, named{fmt.Sprintf("%s/%s/%d", path, kind, i), name})
		}
	}
	for i, each := range objects(entry, "resize") {
		places = append(places, named{fmt.Sprintf("%s/resize/%d/part", path, i), text(each, "part", "")})
	}
	if len(places) == 0 && !has(entry, "enter") {
		note(path, "it does nothing; expected shed, adopt, grow, resize or enter")
	}
	for _, each := range places {
		if !slices.Contains(known, each.name) {
			note(each.path, "there is no cube %s%s", quoted(each.name), didYouMean(each.name, known))
		} else if each.name == root {
			note(each.path, "%s is the root, on which all others hang", quoted(root))
		}
	}
	if has(entry, "resize") && len(body.Joints) >= len(body.Cubes) {
		note(path+"/resize", "only in a body without loops a part can come to be of another size")
	}
	return problems
}

// hanging returns by which joint each cube but the root hangs on one that is nearer to the root, the nearer ones first.
type hanging struct {
	names []string
	by    map[string]*Joint
}

func hangingOf(body *Body) hanging {
	root := body.Cubes[0].ID
	found := hanging{by: map[string]*Joint{}}
	for fresh := []string{root}; len(fresh) > 0; fresh = fresh[1:] {
		at := fresh[0]
		for i := range body.Joints {
			joint := &body.Joints[i]
			if !joint.joins(at) {
				continue
			}
			if other := joint.other(at); other != root && found.by[other] == nil {
				found.names = append(found.names, other)
				found.by[other] = joint
				fresh = append(fresh, other)
			}
		}
	}
	return found
}
