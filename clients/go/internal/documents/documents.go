// Package documents reads JSON that people write and share, strictly and within bounds, and judges it by its schema.
package documents

import (
	"bytes"
	"encoding/json"
	"errors"
	"fmt"
	"io"
	"strconv"
	"strings"
	"unicode"
	"unicode/utf8"
)

// Bounds of a document's text.
const (
	nesting    = 200
	containers = 1 << 16 // what an array or an object costs does not show in the length of its text
	values     = 1 << 22 // a digit and a comma become many times as many bytes
	longest    = 80 << 20
)

// most is how many problems an error lists.
const most = 20

// Problem is what is wrong with one value of a document.
type Problem struct {
	// The JSON Pointer of the value, without its leading slash; empty for the document itself.
	Path string
	// For people.
	Message string
}

// Error is a document that is not as it must be.
type Error struct {
	// At most 20.
	Problems []Problem
	// Whether there are others.
	More bool
}

func (e *Error) Error() string {
	lines := make([]string, 0, len(e.Problems)+1)
	for _, problem := range e.Problems {
		line := problem.Message
		if problem.Path != "" {
			line = Visible(problem.Path) + ": " + line
		}
		lines = append(lines, line)
	}
	if e.More {
		lines = append(lines, "and more")
	}
	return strings.Join(lines, "\n")
}

// Refused returns an error of one problem, with the document itself.
func Refused(format string, values ...any) *Error {
	return &Error{Problems: []Problem{{"", fmt.Sprintf(format, values...)}}}
}

// Findings collects problems, as many as an error lists.
type Findings struct{ found []Problem }

// Add notes a problem.
func (f *Findings) Add(path, format string, values ...any) {
	if !f.Full() {
		f.found = append(f.found, Problem{path, fmt.Sprintf(format, values...)})
	}
}

// Full tells whether there are more problems than are listed: nothing else need be looked at.
func (f *Findings) Full() bool { return len(f.found) > most }

// Err returns the error, nil without problems.
func (f *Findings) Err() error {
	if len(f.found) == 0 {
		return nil
	}
	return &Error{f.found[:min(len(f.found), most)], f.Full()}
}

// Parse reads strict JSON: UTF-8, no key twice in an object, no number that is infinite as a double. Numbers are
// float64.
func Parse(text []byte) (any, error) {
	if len(text) > longest {
		return nil, Refused("longer than %d MiB", longest>>20)
	}
	if bytes.Count(text, []byte(",")) > values {
		return nil, Refused("more than 4,194,304 values")
	}
	if !utf8.Valid(text) {
		return nil, Refused("not UTF-8")
	}
	if bytes.Count(text, []byte("["))+bytes.Count(text, []byte("{")) > containers {
		return nil, Refused("more than 65,536 arrays and objects")
	}
	if err := json.Unmarshal(text, new(json.RawMessage)); err != nil {
		return nil, Refused("not strict JSON: %v", err)
	}
	decoder := json.NewDecoder(bytes.NewReader(text))
	decoder.UseNumber()
	value, err := read(decoder, text, 0)
	if err != nil {
		return nil, Refused("not strict JSON: %v", err)
	}
	return value, nil
}

// read reads the next value of text that is JSON.
func read(decoder *json.Decoder, text []byte, depth int) (any, error) {
	if depth > nesting {
		return nil, fmt.Errorf("nested more than %d deep", nesting)
	}
	begin := decoder.InputOffset()
	token, err := decoder.Token()
	if err != nil {
		return nil, err
	}
	switch token := token.(type) {
	case json.Number:
		number, err := strconv.ParseFloat(string(token), 64)
		if err != nil {
			return nil, errors.New("a number is too large for a double")
		}
		if token == "-0" { // a whole number, which has no sign
			return 0.0, nil
		}
		return number, nil
	case string:
		return token, whole(token, text[begin:decoder.InputOffset()])
	case json.Delim:
		if token == '[' {
			return readArray(decoder, text, depth)
		}
		return readObject(decoder, text, depth)
	}
	return token, nil
}

func readArray(decoder *json.Decoder, text []byte, depth int) (any, error) {
	items := []any{}
	for decoder.More() {
		item, err := read(decoder, text, depth+1)
		if err != nil {
			return nil, err
		}
		items = append(items, item)
	}
	_, err := decoder.Token()
	return items, err
}

func readObject(decoder *json.Decoder, text []byte, depth int) (any, error) {
	fields := map[string]any{}
	for decoder.More() {
		name, err := read(decoder, text, depth)
		if err != nil {
			return nil, err
		}
		key := name.(string) // which the syntax is known to have here
		if _, twice := fields[key]; twice {
			return nil, fmt.Errorf("the key %s is there twice", Excerpt(key))
		}
		if fields[key], err = read(decoder, text, depth+1); err != nil {
			return nil, err
		}
	}
	_, err := decoder.Token()
	return fields, err
}

// whole refuses a text with half of a surrogate pair, for which the decoder puts U+FFFD.
func whole(text string, written []byte) error {
	if strings.ContainsRune(text, unicode.ReplacementChar) && bytes.Contains(bytes.ToLower(written), []byte(`\ud`)) {
		return errors.New("a text with half of a surrogate pair")
	}
	return nil
}

// Excerpt returns the beginning of a value's JSON, for a message.
func Excerpt(value any) string {
	var text bytes.Buffer
	encoder := json.NewEncoder(&limited{&text, 400})
	if err := encoder.Encode(value); err != nil && !errors.Is(err, errFull) {
		return fmt.Sprintf("a %T", value)
	}
	runes := []rune(Visible(strings.TrimSuffix(text.String(), "\n")))
	if len(runes) > 80 {
		return string(runes[:77]) + "..."
	}
	return string(runes)
}

var errFull = errors.New("enough")

// limited takes so many bytes.
type limited struct {
	out  io.Writer
	left int
}

func (l *limited) Write(data []byte) (int, error) {
	taken := min(len(data), l.left)
	l.left -= taken
	n, err := l.out.Write(data[:taken])
	if err == nil && taken < len(data) {
		err = errFull
	}
	return n, err
}

// Visible returns a text with what does not print written as an escape: it may come from anybody.
func Visible(text string) string {
	return strings.Map(func(r rune) rune {
		if r == ' ' || unicode.IsPrint(r) {
			return r
		}
		return unicode.ReplacementChar
	}, text)
}
