package genome

import (
	"fmt"
	"maps"
	"slices"
)

// Rule is one rule of a body's development: when it applies, and what it does then, as its document says.
type Rule struct {
	When  string
	Shed  []string
	Adopt []string
	Grow  []string
	// Which parts come to be of another size.
	Resize []Resize
}

// Resize is a part that comes to be of another size: how many times as long its edges are then as at birth.
type Resize struct {
	Part  string
	Scale float64
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
			for _, each := range objects(entry, "resize") {
				rule := &rules[len(rules)-1]
				rule.Resize = append(rule.Resize, Resize{text(each, "part", ""), number(each, "scale", 1)})
			}
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

// scales returns how small and how large its rules may make the parts of a body that they resize, by the ids of these.
func scales(body *Body) (smallest, largest map[string]float64) {
	smallest, largest = map[string]float64{}, map[string]float64{}
	for _, rule := range body.Development {
		for _, each := range rule.Resize {
			if _, there := smallest[each.Part]; !there {
				smallest[each.Part], largest[each.Part] = 1, 1
			}
			smallest[each.Part] = min(smallest[each.Part], each.Scale)
			largest[each.Part] = max(largest[each.Part], each.Scale)
		}
	}
	return smallest, largest
}

// resized returns a body, without loops, some of whose parts are of another size, of the same density: as many times as
// long as these say, by the ids of cubes. A part grows away from the joint by which it hangs; what hangs on it is moved
// along, and stays as large as it is.
func resized(body *Body, scales map[string]float64) *Body {
	changed := false
	for _, scale := range scales {
		changed = changed || scale != 1
	}
	if !changed {
		return body
	}
	other := *body
	other.Cubes = slices.Clone(body.Cubes)
	// What was done to a cube: all that was at about is moved by shift, and what is beyond by scale as far.
	type placing struct {
		about, shift Vector
		scale        float64
	}
	placed := func(point Vector, by placing) (at Vector) {
		for k := range point {
			at[k] = by.about[k] + float64((point[k]-by.about[k])*by.scale) + by.shift[k]
		}
		return at
	}
	done := map[string]placing{body.Cubes[0].ID: {scale: 1}}
	hangs := hangingOf(body)
	for _, name := range hangs.names {
		joint := hangs.by[name]
		scale, there := scales[name]
		if !there {
			scale = 1
		}
		anchor := placed(joint.Anchor, done[joint.other(name)])
		done[name] = placing{joint.Anchor, minus(anchor, joint.Anchor), scale}
		cube := other.cube(name)
		for k := range cube.Size {
			cube.Size[k] = float64(cube.Size[k] * scale)
		}
		cube.Mass = float64(float64(float64(cube.Mass*scale)*scale) * scale)
		cube.Position = placed(cube.Position, done[name])
	}
	return &other
}

// leastLeft returns for each joint of a body the least that rules can leave of it while that joint is there: what they
// never take away, and what the joint hangs by; each part as small as it may come to be.
func leastLeft(body *Body) []*Body {
	lost := map[string]bool{}
	for _, name := range body.Later {
		lost[name] = true
	}
	for _, rule := range body.Development {
		for _, name := range rule.Shed {
			lost[name] = true
		}
	}
	smallest, _ := scales(body)
	small := resized(body, smallest)
	found := make([]*Body, len(body.Joints))
	if len(lost) == 0 {
		for i := range found {
			found[i] = small
		}
		return found
	}
	hangs, stays := hangingOf(body), map[string]bool{body.Cubes[0].ID: true}
	for _, part := range hangs.names { // the nearer ones first
		if stays[hangs.by[part].other(part)] && !lost[part] {
			stays[part] = true
		}
	}
	looped := len(body.Joints) >= len(body.Cubes) // then there is another way, and what is on one may be gone
	for i := range body.Joints {
		joint := &body.Joints[i]
		kept := maps.Clone(stays)
		for _, part := range []string{joint.Cube1, joint.Cube2} {
			kept[part] = true
			for at := part; !looped && hangs.by[at] != nil; {
				at = hangs.by[at].other(at)
				kept[at] = true
			}
		}
		least := *small
		least.Cubes = slices.DeleteFunc(slices.Clone(small.Cubes), func(cube Cube) bool { return !kept[cube.ID] })
		found[i] = &least
	}
	return found
}
