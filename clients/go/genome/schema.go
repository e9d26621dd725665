package genome

import (
	_ "embed"
	"encoding/json"
	"fmt"
	"math"
	"regexp"
	"slices"
	"strconv"
	"strings"
	"sync"
	"unicode/utf8"
)

// mostProblems is how many problems of a document are told.
const (
	mostProblems = 20
	mostUnknown  = 100 // fields that there are none of, above which an object is not looked into
)

//go:embed schemas.json
var schemaText []byte

// schemas are the JSON Schemas of genomes and of the kinds of brains, by name, as tools/go_schemas.py wrote them.
var schemas = sync.OnceValue(func() map[string]*schema {
	var read map[string]*schema
	if err := json.Unmarshal(schemaText, &read); err != nil {
		panic(err) // they are part of the program
	}
	for _, each := range read {
		each.prepare()
	}
	return read
})

// schema is what JSON Schema says of a value; words say it to people.
type schema struct {
	Type       string             `json:"type"`
	Words      string             `json:"x-words"`
	Properties map[string]*schema `json:"properties"`
	Order      []string           `json:"x-order"`
	Required   []string           `json:"required"`
	Closed     bool               `json:"x-closed"` // has no other properties
	Items      *schema            `json:"items"`
	MinItems   *int               `json:"minItems"`
	MaxItems   *int               `json:"maxItems"`
	Unique     bool               `json:"uniqueItems"`
	Contains   *schema            `json:"contains"`
	MinLength  *int               `json:"minLength"`
	MaxLength  *int               `json:"maxLength"`
	Pattern    string             `json:"x-pattern"` // as Go writes one
	Minimum    *float64           `json:"minimum"`
	Maximum    *float64           `json:"maximum"`
	Enum       []string           `json:"enum"`
	Const      *string            `json:"const"`
	AnyOf      []*schema          `json:"anyOf"`
	Default    any                `json:"default"`
	Parameter  bool               `json:"x-parameter"`

	pattern *regexp.Regexp
}

func (s *schema) prepare() {
	if s.Pattern != "" {
		s.pattern = regexp.MustCompile(s.Pattern)
	}
	for _, part := range s.Properties {
		part.prepare()
	}
	for _, part := range append(slices.Clone(s.AnyOf), s.Items, s.Contains) {
		if part != nil {
			part.prepare()
		}
	}
}

// place is the way to a value: keys, and indices of arrays as int.
type place []any

func (p place) pointer() string {
	keys := make([]string, len(p))
	for i, key := range p {
		switch key := key.(type) {
		case int:
			keys[i] = strconv.Itoa(key)
		case string:
			keys[i] = strings.ReplaceAll(strings.ReplaceAll(key, "~", "~0"), "/", "~1")
		}
	}
	return strings.Join(keys, "/")
}

func (p place) then(key any) place { return append(slices.Clone(p), key) }

// unsound is one value of a document that is not as its schema says.
type unsound struct {
	at    place
	words string
}

// problemsOf returns the problems that a schema has with a value, at most one more than are told.
//
// Arrays that are too long come first: where there are any, nothing else is looked at.
func problemsOf(s *schema, value any) []unsound {
	f := &finder{}
	f.long(s, value, nil)
	if len(f.found) == 0 {
		f.look(s, value, nil)
	}
	return f.found
}

type finder struct{ found []unsound }

func (f *finder) full() bool { return len(f.found) > mostProblems }

func (f *finder) add(at place, format string, values ...any) {
	if !f.full() {
		f.found = append(f.found, unsound{slices.Clone(at), fmt.Sprintf(format, values...)})
	}
}

// long finds the arrays that have more items than they may, without looking into them, and fields by the hundred.
func (f *finder) long(s *schema, value any, at place) {
	switch value := value.(type) {
	case object:
		for _, name := range s.Order {
			if part, there := value[name]; there {
				f.long(s.Properties[name], part, at.then(name))
			}
		}
		if s.Closed && len(value) > len(s.Properties)+mostUnknown {
			for _, name := range sortedKeys(value) {
				if s.Properties[name] == nil && !f.full() {
					f.add(at.then(name), "there is no such field")
				}
			}
		}
	case array:
		switch {
		case s.MaxItems != nil && len(value) > *s.MaxItems:
			f.add(at, "expected %s, got %s", s.Words, thousands(len(value)))
		case s.Items != nil && (s.Items.Properties != nil || s.Items.Items != nil):
			for i, item := range value {
				f.long(s.Items, item, at.then(i))
			}
		}
	}
}

// look finds what is wrong with a value and all in it, each keyword of its schema by itself.
func (f *finder) look(s *schema, value any, at place) {
	if f.full() {
		return
	}
	expected := func(bad bool) {
		if bad {
			f.add(at, "expected %s, got %s", s.Words, excerpt(value))
		}
	}
	expected(!s.typed(value))
	expected(s.Const != nil && value != any(*s.Const))
	if s.Enum != nil {
		word, isText := value.(string)
		expected(!isText || !slices.Contains(s.Enum, word))
	}
	if s.AnyOf != nil {
		expected(!slices.ContainsFunc(s.AnyOf, func(choice *schema) bool { return choice.accepts(value) }))
	}
	switch value := value.(type) {
	case string:
		length := utf8.RuneCountInString(value)
		expected(s.MinLength != nil && length < *s.MinLength)
		expected(s.MaxLength != nil && length > *s.MaxLength)
		expected(s.pattern != nil && !s.pattern.MatchString(value))
	case array:
		f.items(s, value, at, expected)
	case object:
		f.fields(s, value, at)
	default:
		if number, good := numberOf(value); good {
			expected(s.Minimum != nil && number < *s.Minimum)
			expected(s.Maximum != nil && number > *s.Maximum)
		}
	}
}

func (f *finder) items(s *schema, value array, at place, expected func(bool)) {
	expected(s.MinItems != nil && len(value) < *s.MinItems)
	expected(s.MaxItems != nil && len(value) > *s.MaxItems)
	expected(s.Unique && repeats(value))
	expected(s.Contains != nil && !slices.ContainsFunc(value, s.Contains.accepts))
	if s.Items == nil {
		return
	}
	for i, item := range value {
		if f.full() {
			return
		}
		f.look(s.Items, item, at.then(i))
	}
}

func (f *finder) fields(s *schema, value object, at place) {
	for _, name := range s.Required {
		if !has(value, name) {
			words := "any JSON value"
			if part := s.Properties[name]; part != nil {
				words = part.Words
			}
			f.add(at.then(name), "is missing; expected %s", words)
		}
	}
	for _, name := range s.Order {
		if part, there := value[name]; there {
			f.look(s.Properties[name], part, at.then(name))
		}
	}
	if s.Closed {
		for _, name := range sortedKeys(value) {
			if s.Properties[name] == nil && !f.full() {
				f.add(at.then(name), "there is no such field%s", didYouMean(name, s.Order))
			}
		}
	}
}

func (s *schema) accepts(value any) bool {
	f := &finder{}
	f.look(s, value, nil)
	return len(f.found) == 0
}

// typed tells whether a value is of a schema's type; 1.0 is an integer too.
func (s *schema) typed(value any) bool {
	good := true
	switch s.Type {
	case "object":
		_, good = value.(object)
	case "array":
		_, good = value.(array)
	case "string":
		_, good = value.(string)
	case "boolean":
		_, good = value.(bool)
	case "number":
		_, good = numberOf(value)
	case "integer":
		number, isNumber := numberOf(value)
		good = isNumber && number == math.Trunc(number)
	}
	return good
}

func repeats(items array) bool {
	seen := map[string]bool{}
	for _, item := range items {
		key := string(writeCanonical(item))
		if seen[key] {
			return true
		}
		seen[key] = true
	}
	return false
}

// without returns a copy of a document without the fields that problems are about. Of a problem inside an array the
// field that holds the array goes; one that is about all of the data changes nothing.
func without(document any, blamed []unsound) any {
	copied := cloned(document)
	for _, problem := range blamed {
		last := -1
		for i, key := range problem.at {
			if _, named := key.(string); named {
				last = i
			}
		}
		if last < 0 {
			continue
		}
		part := copied
		for _, key := range problem.at[:last] {
			part = inside(part, key)
		}
		if fields, good := part.(object); good {
			delete(fields, problem.at[last].(string))
		}
	}
	return copied
}

func inside(value, key any) any {
	switch value := value.(type) {
	case object:
		name, _ := key.(string)
		return value[name]
	case array:
		if i, good := key.(int); good && i < len(value) {
			return value[i]
		}
	}
	return nil
}

// complete returns a sound document with its defaults filled in: a new copy.
func complete(s *schema, value object) object {
	full := cloned(value)
	for _, name := range s.Order {
		part := s.Properties[name]
		item, there := full[name]
		if !there {
			if part.Default == nil {
				continue
			}
			item = cloned(part.Default)
		}
		switch {
		case part.Type == "object":
			item = complete(part, item.(object))
		case part.Items != nil && part.Items.Type == "object":
			items := item.(array)
			for i := range items {
				items[i] = complete(part.Items, items[i].(object))
			}
		}
		full[name] = item
	}
	return full
}
