package genome

import (
	"fmt"
	"maps"
	"math"
	"regexp"
	"slices"
	"strconv"
	"strings"
)

const (
	mostRuleParts, mostStages, mostUses, longestWhen = 16, 16, 64, 500
)

// ruleNumber finds, of an expression, the numbers, but for those in ids, and those beside `has`, which is 0 or 1.
var ruleNumber = regexp.MustCompile(`"[^"]*"|'[^']*'|has\([^()]*\)\s*[<>=!]+\s*[0-9.]+` +
	`|((?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)`)

// developmentChange is one change of the later and the development of a document; body is its body, whole.
type developmentChange struct {
	document object
	body     *Body
	hangs    hanging
	draw     *Draw
}

func changeDevelopment(document object, body *Body, draw *Draw) bool {
	c := &developmentChange{document, body, hangingOf(body), draw}
	if len(c.hangs.names) == 0 {
		return false
	}
	setDefault(document, "later", array{})
	setDefault(document, "development", array{})
	changes, weights := []func(){c.birth, c.addRule}, []float64{0.3, 0.3}
	if len(c.rules()) > 0 {
		changes, weights = append(changes, c.changeRule, c.removeRule), append(weights, 0.4, 0.15)
	}
	weighted(draw, changes, weights)()
	for _, name := range []string{"later", "development"} {
		if len(list(document, name)) == 0 {
			delete(document, name)
		}
	}
	return true
}

func (c *developmentChange) rules() []object { return objects(c.document, "development") }
func (c *developmentChange) later() []string { return texts(list(c.document, "later")) }

// birth makes a part later, with what hangs on it; or there at birth, with what it hangs on.
func (c *developmentChange) birth() {
	part, later := oneOf(c.draw, c.hangs.names), c.later()
	if !slices.Contains(later, part) {
		c.delay(part, c.age())
		return
	}
	for slices.Contains(later, part) {
		later = slices.DeleteFunc(later, func(name string) bool { return name == part })
		part = c.hangs.by[part].other(part)
	}
	c.document["later"] = anyOf(later)
}

// delay makes a part of the body later, with all that hangs on it, and adds the rules by which they grow after an age, s.
func (c *developmentChange) delay(part string, age float64) {
	later := c.later()
	fresh := newOf(unborn(c.body, append(slices.Clone(later), part)), later)
	c.document["later"] = anyOf(append(later, fresh...))
	rules := list(c.document, "development")
	for names := range slices.Chunk(fresh, mostRuleParts) {
		rules = append(rules, object{"when": "age > " + decimal(age), "grow": anyOf(names)})
	}
	c.document["development"] = rules
}

// unborn returns the ids of the cubes that are not there at birth: those that are later, and what hangs on them alone.
func unborn(body *Body, later []string) []string {
	there := reached(body, later)
	return slices.DeleteFunc(slices.Clone(hangingOf(body).names), func(name string) bool { return there[name] })
}

// addRule adds a rule at a place among the others.
func (c *developmentChange) addRule() {
	d, rules, later := c.draw, c.rules(), c.later()
	kind := weighted(d, []string{"grow", "shed", "adopt", "resize", "enter"}, []float64{0.3, 0.25, 0.1, 0.25, 0.1})
	if kind == "resize" && len(c.body.Joints) >= len(c.body.Cubes) {
		kind = "grow" // in a body with loops nothing is resized
	}
	part := oneOf(d, c.hangs.names)
	orphans := slices.DeleteFunc(slices.Clone(later), func(name string) bool {
		return slices.ContainsFunc(rules, func(rule object) bool { return slices.Contains(list(rule, "grow"), any(name)) })
	})
	if kind == "grow" && len(orphans) > 0 {
		part = oneOf(d, orphans)
	}
	var rule object
	if kind == "adopt" || kind == "grow" && !slices.Contains(later, part) {
		rule = object{"when": fmt.Sprintf(`has("%s") < 1`, part), kind: array{part}}
		rule["every"] = c.every()
		rule["times"] = float64(d.Count(1, 8))
	} else {
		rule = object{"when": c.condition()}
		switch kind {
		case "resize":
			rule["resize"] = array{object{"part": part, "scale": c.scale(1)}}
		case "enter":
			rule["enter"] = float64(d.Count(1, min(highestStage(rules)+1, mostStages)))
		default:
			rule[kind] = array{part}
		}
	}
	if d.Chance(0.2) {
		rule["stage"] = float64(d.Count(1, highestStage(rules)))
	}
	c.document["development"] = slices.Insert(list(c.document, "development"), d.Count(0, len(rules)), any(rule))
}

// condition draws when a rule applies: at an age mostly, else where a sensor reads more or less than a number.
func (c *developmentChange) condition() string {
	if len(c.body.Sensors) == 0 || c.draw.Chance(0.6) {
		return "age > " + decimal(c.age())
	}
	sensor := oneOf(c.draw, c.body.Sensors).ID
	sign := oneOf(c.draw, []string{"<", ">"})
	return fmt.Sprintf(`sense("%s") %s %s`, sensor, sign, decimal(c.draw.Normal(0.5)))
}

func highestStage(rules []object) int {
	highest := 0
	for _, rule := range rules {
		highest = max(highest, whole(rule, "enter", 0))
	}
	return max(highest, 1)
}

func (c *developmentChange) removeRule() {
	rules := list(c.document, "development")
	c.document["development"] = removed(rules, oneOf(c.draw, rules))
}

// changeRule changes a number of a rule's condition, what it does, in which stage, or how often.
func (c *developmentChange) changeRule() {
	d, rules := c.draw, c.rules()
	rule := oneOf(d, rules)
	when := text(rule, "when", "")
	var numbers [][]int
	for _, found := range ruleNumber.FindAllStringSubmatchIndex(when, -1) {
		if found[2] >= 0 {
			numbers = append(numbers, found[2:])
		}
	}
	kinds := slices.DeleteFunc(slices.Clone(ruleLists), func(kind string) bool { return !has(rule, kind) })
	ways, weights := []string{"every", "times"}, []float64{0.3, 0.3}
	way := func(good bool, name string, weight float64) {
		if good {
			ways, weights = append(ways, name), append(weights, weight)
		}
	}
	way(len(numbers) > 0, "when", 1.5)
	way(len(kinds) > 0, "parts", 0.6)
	way(has(rule, "resize"), "scale", 1)
	way(highestStage(rules) > 1, "stage", 0.4)
	switch weighted(d, ways, weights) {
	case "when":
		found := oneOf(d, numbers)
		before, err := strconv.ParseFloat(when[found[0]:found[1]], 64)
		if err != nil {
			panic(err) // the condition was good
		}
		if before != 0 {
			before = float64(before * d.Factor(0.3))
		} else {
			before = math.Abs(d.Normal(0.3))
		}
		if changed := when[:found[0]] + decimal(before) + when[found[1]:]; len([]rune(changed)) <= longestWhen {
			rule["when"] = changed
		}
	case "parts":
		kind := oneOf(d, kinds)
		rule[kind] = c.otherParts(list(rule, kind))
	case "scale":
		entry := oneOf(d, objects(rule, "resize"))
		entry["scale"] = c.scale(number(entry, "scale", 1))
	case "stage":
		if has(rule, "stage") && d.Chance(0.4) {
			delete(rule, "stage")
		} else {
			rule["stage"] = float64(d.Count(1, highestStage(rules)))
		}
	case "every":
		rule["every"] = rounded(min(max(float64(number(rule, "every", 1)*d.Factor(0.5)), 0.1), 600), 3)
	case "times":
		rule["times"] = float64(min(max(whole(rule, "times", 1)+oneOf(d, []int{-1, 1, 1, 2}), 1), mostUses))
	}
}

// otherParts returns the parts that a rule names with one more, one less, or another one.
func (c *developmentChange) otherParts(names array) array {
	d := c.draw
	what := oneOf(d, []string{"more", "less", "another"})
	switch {
	case what == "less" && len(names) > 1:
		names = removed(names, oneOf(d, names))
	case what == "more" && len(names) < mostRuleParts:
		names = append(names, oneOf(d, c.hangs.names))
	default:
		part := oneOf(d, c.hangs.names)
		names[d.Count(0, len(names)-1)] = part
	}
	return anyOf(distinct(texts(names)))
}

// distinct returns names without those that were there before.
func distinct(names []string) []string {
	var found []string
	for _, name := range names {
		if !slices.Contains(found, name) {
			found = append(found, name)
		}
	}
	return found
}

func (c *developmentChange) age() float64 { return min(max(float64(2*c.draw.Factor(0.8)), 0.1), 20) }
func (c *developmentChange) every() float64 {
	return rounded(min(max(c.draw.Factor(0.6), 0.1), 600), 3)
}

func (c *developmentChange) scale(before float64) float64 {
	return rounded(min(max(float64(before*c.draw.Factor(0.3)), 0.25), 4), 6)
}

// decimal returns a number as an expression has it, with six digits at most behind the point.
func decimal(value float64) string {
	digits := strconv.FormatFloat(value, 'f', 6, 64)
	return strings.TrimRight(strings.TrimRight(digits, "0"), ".")
}

// carryOverDevelopment fits the later and the development of a document to a body that has changed, whole, with its
// sensors: parts that are gone are later no more, and named by no rule. What is new and hangs on a part that is later is
// later too, and grows with it. A rule that is of no use then goes, and so does one whose condition asks for what is gone.
func carryOverDevelopment(document object, body *Body) {
	if len(list(document, "later")) == 0 && len(list(document, "development")) == 0 {
		return
	}
	hangs := hangingOf(body)
	gone := func(name string) bool { return hangs.by[name] == nil }
	later := slices.DeleteFunc(texts(list(document, "later")), gone)
	var rules []object
	for _, rule := range objects(document, "development") {
		rules = append(rules, pruned(rule, gone))
	}
	for _, name := range unborn(body, later) {
		if slices.Contains(later, name) {
			continue
		}
		later = append(later, name)
		base := hangs.by[name].other(name)
		for _, rule := range rules {
			grow := texts(list(rule, "grow"))
			if slices.Contains(grow, base) && len(grow) < mostRuleParts && !slices.Contains(grow, name) {
				rule["grow"] = anyOf(append(grow, name))
			}
		}
	}
	delete(document, "later")
	delete(document, "development")
	if len(later) > 0 {
		document["later"] = anyOf(later)
	}
	left := array{}
	for _, rule := range rules {
		if problems, _ := readRules([]object{rule}, body); len(problems) == 0 {
			left = append(left, rule)
		}
	}
	if len(left) > 0 {
		document["development"] = left
	}
}

// pruned returns a rule without the parts that are gone.
func pruned(rule object, gone func(string) bool) object {
	left := maps.Clone(rule)
	set := func(name string, items array) {
		if left[name] = items; len(items) == 0 {
			delete(left, name)
		}
	}
	for _, name := range ruleLists {
		if has(rule, name) {
			set(name, anyOf(slices.DeleteFunc(texts(list(rule, name)), gone)))
		}
	}
	if has(rule, "resize") {
		set("resize", slices.DeleteFunc(slices.Clone(list(rule, "resize")), func(each any) bool {
			return gone(text(each.(object), "part", ""))
		}))
	}
	return left
}
