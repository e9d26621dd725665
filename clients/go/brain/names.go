package brain

import (
	"fmt"
	"slices"
	"strings"

	"nmes/internal/documents"
)

const (
	mostWildcards = 256 // entries with wildcards in one document: each is held against all names
	mostListed    = 12  // names that a message lists
)

// names ties the entries of a document to the sensors and motors of a body, and collects what is wrong.
type names struct {
	documents.Findings
	inputs, outputs []string
	wildcards       int
	unknown         map[[2]string]bool
}

// match returns the indices of the names that an entry stands for: its own, else those that fit its wildcards.
func (n *names) match(entry string, all []string, what, path string) []int {
	if at := slices.Index(all, entry); at >= 0 {
		return []int{at}
	}
	var indices []int
	if strings.ContainsAny(entry, "*?") {
		if n.wildcards++; n.wildcards > mostWildcards {
			n.Add(path, "a brain has at most %d entries with wildcards", mostWildcards)
			return nil
		}
		for i, name := range all {
			if fits([]rune(entry), []rune(name)) {
				indices = append(indices, i)
			}
		}
	}
	if len(indices) == 0 {
		n.noSuch(entry, all, what, path)
	}
	return indices
}

// noSuch notes that there is no such name, once for each.
func (n *names) noSuch(name string, all []string, what, path string) {
	if key := [2]string{name, what}; !n.unknown[key] {
		n.unknown[key] = true
		n.Add(path, "there is no %s %s; there %s", what, documents.Excerpt(name), listed(all, what))
	}
}

func listed(all []string, what string) string {
	if len(all) == 0 {
		return fmt.Sprintf("are no %ss at all", what)
	}
	more := ""
	if len(all) > mostListed {
		more = fmt.Sprintf(" and %d more", len(all)-mostListed)
	}
	return "are " + documents.Visible(strings.Join(all[:min(len(all), mostListed)], ", ")) + more
}

// owners deals names out to entries: for each name the index of its entry, or -1. A name belongs to the entry that is
// this very name, else to the first entry whose wildcards fit it.
func (n *names) owners(entries, all []string, what string, path func(int) string) []int {
	owner := make([]int, len(all))
	for i := range owner {
		owner[i] = -1
	}
	matches := make([][]int, len(entries))
	var order, later []int
	for number, entry := range entries {
		matches[number] = n.match(entry, all, what, path(number))
		if slices.Contains(all, entry) {
			order = append(order, number)
		} else {
			later = append(later, number)
		}
	}
	for _, number := range append(order, later...) {
		dealt := false
		for _, i := range matches[number] {
			if owner[i] < 0 {
				owner[i], dealt = number, true
			}
		}
		if len(matches[number]) > 0 && !dealt {
			n.Add(path(number), "every %s that %s stands for has another entry", what, documents.Excerpt(entries[number]))
		}
	}
	return owner
}

// fits tells whether a name fits a pattern: * stands for any characters, also none, and ? for any one. It takes time in
// proportion to the name's length times the pattern's at most.
func fits(pattern, name []rune) bool {
	star, from, p := -1, 0, 0
	for i := 0; i < len(name); {
		switch {
		case p < len(pattern) && pattern[p] == '*':
			star, from = p, i
			p++
		case p < len(pattern) && (pattern[p] == '?' || pattern[p] == name[i]):
			p++
			i++
		case star >= 0: // the last * takes one more
			from++
			p, i = star+1, from
		default:
			return false
		}
	}
	for p < len(pattern) && pattern[p] == '*' {
		p++
	}
	return p == len(pattern)
}

// entries are those of a network's inputs and outputs, dealt out to a body's sensors and motors.
type entries struct {
	names           *names
	inputs, outputs side
}

// side is one of the two.
type side struct {
	field, what string
	listed      bool
	count       int
	owner       []int // for each of the body's names the index of its entry, or -1
}

// sides is the part of a document that says which sensors and motors are meant; nil for all in their order.
type sides struct {
	Inputs  []string `json:"inputs"`
	Outputs []string `json:"outputs"`
}

func newEntries(given sides, n *names) entries {
	deal := func(field, what string, listed, all []string) side {
		result := side{field: field, what: what, listed: listed != nil}
		if listed == nil {
			listed = all
		}
		result.count = len(listed)
		result.owner = n.owners(listed, all, what, func(i int) string { return fmt.Sprintf("%s/%d", field, i) })
		return result
	}
	return entries{n, deal("inputs", "sensor", given.Inputs, n.inputs), deal("outputs", "motor", given.Outputs, n.outputs)}
}

// expect compares a length with the number of entries of one side.
func (e *entries) expect(path string, got int, s *side, each string) {
	switch {
	case got == s.count:
	case s.listed:
		e.names.Add(path, "has %d %s, and there must be %d, one for each entry of %s", got, each, s.count, s.field)
	default:
		e.names.Add(path, "has %d %s, and the body has %d %ss: a list '%s' would say which are meant", got, each, s.count, s.what, s.field)
	}
}

// spread returns a matrix with a column for each entry as one with a column for each sensor, and others behind.
func (e *entries) spread(matrix [][]float64, behind int) [][]float64 {
	result := make([][]float64, len(matrix))
	for i, row := range matrix {
		result[i] = make([]float64, len(e.inputs.owner)+behind)
		for sensor, entry := range e.inputs.owner {
			if entry >= 0 {
				result[i][sensor] = row[entry]
			}
		}
	}
	return result
}

// pick writes to each motor the value of its entry, or 0.
func pick(owner []int, values, controls []float64) {
	for motor, entry := range owner {
		controls[motor] = 0
		if entry >= 0 {
			controls[motor] = within(-1, 1, values[entry])
		}
	}
}

// hear writes what sensors read, kept within the limit.
func hear(sensors, row []float64) {
	for i, value := range sensors {
		row[i] = within(-limit, limit, value)
	}
}
