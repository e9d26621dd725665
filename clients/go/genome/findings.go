package genome

import (
	"fmt"
	"slices"
	"strings"
)

const (
	mostWildcards = 256 // entries with wildcards in one brain: each is held against all names
	mostNames     = 12  // that a message lists
)

// bodyNames are the sensors and motors that a brain is for. Where the body, which is wrong itself, may have others, the
// brain that names them is not blamed: unsure has sensor, motor or both then.
type bodyNames struct {
	inputs, outputs []string
	unsure          map[string]bool
}

func (n *bodyNames) of(what string) []string {
	if what == "sensor" {
		return n.inputs
	}
	return n.outputs
}

// findings collects the problems of a brain, and matches its names and wildcards. Behind the last problem that is told
// it takes no more.
type findings struct {
	names     bodyNames
	found     []Problem
	unknown   map[[2]string]*unknownName
	wildcards int
}

// unknownName is one that there is not: which problem tells of it, with which hint, and where else it stands.
type unknownName struct {
	index  int
	hint   string
	others []string
}

func placeOf(pointer string) string { return strings.TrimSuffix("brain/"+pointer, "/") }

func (f *findings) full() bool { return len(f.found) > mostProblems }

func (f *findings) add(pointer, format string, values ...any) {
	if !f.full() {
		f.found = append(f.found, Problem{placeOf(pointer), fmt.Sprintf(format, values...)})
	}
}

// noted notes that there is no such name: once, with all places where it stands.
func (f *findings) noted(name string, names []string, what, pointer string) {
	if f.full() {
		return
	}
	key := [2]string{name, what}
	before := f.unknown[key]
	switch {
	case f.names.unsure[what]:
		if before == nil {
			f.unknown[key] = &unknownName{}
		}
	case before != nil:
		before.others = append(before.others, placeOf(pointer))
		words := fmt.Sprintf("there is no %s %s%s%s", what, quoted(name), norAt(before.others), before.hint)
		f.found[before.index].Message = words
	default:
		hint := didYouMean(name, names)
		if hint == "" {
			hint = "; there " + listed(names, what)
		}
		f.unknown[key] = &unknownName{index: len(f.found), hint: hint}
		f.add(pointer, "there is no %s %s%s", what, quoted(name), hint)
	}
}

func (f *findings) isUnknown(name, what string) bool { return f.unknown[[2]string{name, what}] != nil }

func listed(names []string, what string) string {
	if len(names) == 0 {
		return fmt.Sprintf("are no %ss at all", what)
	}
	verb, more := "are", ""
	if len(names) == 1 {
		verb = "is"
	}
	if len(names) > mostNames {
		more = fmt.Sprintf(" and %d more", len(names)-mostNames)
	}
	return fmt.Sprintf("%s %s%s", verb, strings.Join(names[:min(len(names), mostNames)], ", "), more)
}

// match returns the indices of the names that an entry stands for: its own, else those that fit its wildcards.
func (f *findings) match(entry, what, pointer string) []int {
	names := f.names.of(what)
	if at := slices.Index(names, entry); at >= 0 {
		return []int{at}
	}
	var indices []int
	if isPattern(entry) {
		f.wildcards++
		if f.wildcards > mostWildcards {
			if f.wildcards == mostWildcards+1 {
				f.add(pointer, "a brain has at most %d entries with wildcards", mostWildcards)
			}
			return nil
		}
		for i, name := range names {
			if fits(entry, name) {
				indices = append(indices, i)
			}
		}
	}
	if len(indices) == 0 {
		f.noted(entry, names, what, pointer)
	}
	return indices
}

// owners deals names out to entries; it returns for each name the index of its entry, or -1. A name belongs to the entry
// that is this very name, else to the first entry whose wildcards fit it.
func (f *findings) owners(entries []string, what string, pointer func(int) string) []int {
	names := f.names.of(what)
	owner := slices.Repeat([]int{-1}, len(names))
	matches := make([][]int, len(entries))
	var exact, others []int
	for number, entry := range entries {
		matches[number] = f.match(entry, what, pointer(number))
		if slices.Contains(names, entry) {
			exact = append(exact, number)
		} else {
			others = append(others, number)
		}
	}
	for _, number := range append(exact, others...) {
		free := false
		for _, i := range matches[number] {
			if owner[i] < 0 {
				owner[i], free = number, true
			}
		}
		if len(matches[number]) > 0 && !free {
			f.add(pointer(number), "every %s that %s stands for has another entry", what, quoted(entries[number]))
		}
	}
	return owner
}
