// Package genome reads and judges the documents of creatures, and changes them, as NMES itself does.
//
//	walker, err := genome.Parse(text)
//	...
//	child, err := genome.Mutate(walker, genome.NewDraw(7, "genome", 0), genome.Change{})
//	fmt.Println(child.Kind, child.Genome.Hash)
//
// A document is as docs/genomes.md tells: a body, of cubes and joints or as a graph that grows into them; sensors,
// voices, rules of development; and a brain. Equal documents have equal hashes, here and there, and from the same seed
// comes the same mutant.
package genome

import (
	"fmt"
	"strings"
)

// Genome is one creature, as data. It is not to be changed, so that any number of goroutines may share it.
type Genome struct {
	Name string
	// SHA-256 of the document in canonical form, 64 hexadecimal digits.
	Hash string
	// Grown where the document has a graph.
	Body Body

	document object
}

// Problem is what is wrong with one value of a document.
type Problem struct {
	// The JSON Pointer of the value, without its leading slash.
	Path string `json:"path"`
	// What is wrong, for people.
	Message string `json:"message"`
}

// DocumentError is what is wrong with a document.
type DocumentError struct {
	// Up to 20 of the body and 20 of the brain, and one more of either where there are others.
	Problems []Problem
}

func (e *DocumentError) Error() string {
	lines := make([]string, 0, mostProblems+1)
	for i, problem := range e.Problems {
		if i == mostProblems {
			lines = append(lines, "and more")
			break
		}
		lines = append(lines, strings.TrimPrefix(problem.Path+": "+problem.Message, ": "))
	}
	return "genome: " + strings.Join(lines, "\n")
}

func refused(path, words string) *DocumentError { return &DocumentError{[]Problem{{path, words}}} }

// Parse reads the bytes of a genome's file. The error is a *DocumentError.
func Parse(text []byte) (*Genome, error) {
	document, wrong := parse(text)
	if wrong != nil {
		return nil, wrong
	}
	return read(document)
}

// New returns the genome of a document, whatever Go has it as: maps, or structs of a program's own; it is copied. The
// error is a *DocumentError.
func New(document any) (*Genome, error) {
	copied, wrong := plain(document)
	if wrong != nil {
		return nil, wrong
	}
	return read(copied)
}

// Check returns everything that is wrong with the bytes of a genome's file, its brain too; nothing for a good one.
func Check(text []byte) []Problem {
	document, wrong := parse(text)
	if wrong != nil {
		return wrong.Problems
	}
	return problemsIn(document)
}

func problemsIn(document any) []Problem {
	found := inspectBody(document)
	return append(found.problems, inspectBrain(document, found)...)
}

// read returns a genome whose body and whose brain, if there is one, are good.
func read(document any) (*Genome, error) {
	found := inspectBody(document)
	if problems := append(found.problems, inspectBrain(document, found)...); len(problems) > 0 {
		return nil, &DocumentError{problems}
	}
	fields := document.(object)
	return &Genome{Name: text(fields, "name", ""), Hash: hashOf(fields), Body: *found.body, document: fields}, nil
}

// Document returns the document as it was given, nothing filled in: a new copy, of map[string]any, []any, string, bool,
// int64, uint64, float64 and nil.
func (g *Genome) Document() map[string]any { return cloned(g.document) }

// MarshalJSON returns the document, with its keys sorted.
func (g *Genome) MarshalJSON() ([]byte, error) { return write(g.document), nil }

// Expanded returns the same creature with its cubes and joints written out in place of a graph.
func (g *Genome) Expanded() (*Genome, error) {
	graph, grows := g.document["body"].(object)["graph"].(object)
	if !grows {
		return g, nil
	}
	body, wrong := grow(graph)
	if wrong != nil {
		return nil, wrong
	}
	document := g.Document()
	document["body"] = body
	return read(document)
}

// BrainKind returns the kind of its brain, or "" where it has none.
func (g *Genome) BrainKind() string {
	brain, _ := g.document["brain"].(object)
	return text(brain, "kind", "")
}

func (g *Genome) String() string { return fmt.Sprintf("Genome(%s, %s)", quoted(g.Name), g.Hash[:16]) }
