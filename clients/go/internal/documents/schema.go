package documents

import (
	"maps"
	"regexp"
	"slices"
	"strconv"
	"strings"
	"unicode/utf8"
)

// Schema is what a value must be: the part of JSON Schema that the documents of brains need, as tools/go_schemas.py
// writes it.
type Schema struct {
	Type       string             `json:"type"`
	Const      any                `json:"const"`
	Enum       []any              `json:"enum"`
	Minimum    *float64           `json:"minimum"`
	Maximum    *float64           `json:"maximum"`
	MinLength  int                `json:"minLength"`
	MaxLength  *int               `json:"maxLength"`
	MinItems   int                `json:"minItems"`
	MaxItems   *int               `json:"maxItems"`
	Items      *Schema            `json:"items"`
	Required   []string           `json:"required"`
	Properties map[string]*Schema `json:"properties"`
	Default    any                `json:"default"`
	Closed     bool               `json:"x-closed"` // has no other properties
	Order      []string           `json:"x-order"`  // of the properties
	Pattern    *Pattern           `json:"x-pattern"`
	Words      string             `json:"x-words"` // for what is allowed
}

// Pattern is a regular expression that a text must match.
type Pattern struct{ *regexp.Regexp }

// UnmarshalText reads the expression.
func (p *Pattern) UnmarshalText(text []byte) (err error) {
	p.Regexp, err = regexp.Compile(string(text))
	return err
}

// Check returns the problems of a value as an *Error, or nil. Of arrays that are too long it tells first, and looks at
// nothing else then.
func (s *Schema) Check(value any) error {
	var findings Findings
	s.tooLong(&findings, value, "")
	if len(findings.found) == 0 {
		s.check(&findings, value, "")
	}
	return findings.Err()
}

func (s *Schema) tooLong(findings *Findings, value any, path string) {
	switch value := value.(type) {
	case map[string]any:
		for _, name := range s.Order {
			if field, there := value[name]; there {
				s.Properties[name].tooLong(findings, field, join(path, name))
			}
		}
	case []any:
		if s.MaxItems != nil && len(value) > *s.MaxItems {
			findings.Add(path, "expected %s, got %d", s.Words, len(value))
		} else if s.Items != nil {
			for i, item := range value {
				if s.Items.tooLong(findings, item, join(path, strconv.Itoa(i))); findings.Full() {
					return
				}
			}
		}
	}
}

func (s *Schema) check(findings *Findings, value any, path string) {
	if findings.Full() {
		return
	}
	if !s.fits(value) {
		findings.Add(path, "expected %s, got %s", s.Words, Excerpt(value))
		return
	}
	switch value := value.(type) {
	case map[string]any:
		for _, name := range s.Required {
			if _, there := value[name]; !there {
				findings.Add(join(path, name), "is missing; expected %s", s.Properties[name].Words)
			}
		}
		for _, name := range slices.Sorted(maps.Keys(value)) {
			if part := s.Properties[name]; part != nil {
				part.check(findings, value[name], join(path, name))
			} else if s.Closed {
				findings.Add(join(path, name), "there is no such field; there are %s", strings.Join(s.Order, ", "))
			}
		}
	case []any:
		for i, item := range value {
			s.Items.check(findings, item, join(path, strconv.Itoa(i)))
		}
	}
}

// fits tells whether a value is what it must be, what it holds aside.
func (s *Schema) fits(value any) bool {
	if s.Const != nil {
		return value == s.Const
	}
	if s.Enum != nil {
		text, is := value.(string)
		return is && slices.Contains(s.Enum, any(text))
	}
	switch value := value.(type) {
	case float64:
		return s.Type == "number" && !(s.Minimum != nil && value < *s.Minimum) && !(s.Maximum != nil && value > *s.Maximum)
	case string:
		count := utf8.RuneCountInString(value)
		return s.Type == "string" && count >= s.MinLength && !(s.MaxLength != nil && count > *s.MaxLength) &&
			(s.Pattern == nil || s.Pattern.MatchString(value))
	case []any:
		return s.Type == "array" && len(value) >= s.MinItems
	case map[string]any:
		return s.Type == "object"
	}
	return false
}

// Complete fills in the defaults of a sound document.
func (s *Schema) Complete(value any) {
	switch value := value.(type) {
	case map[string]any:
		for name, part := range s.Properties {
			if field, there := value[name]; there {
				part.Complete(field)
			} else if part.Default != nil {
				value[name] = part.Default
			}
		}
	case []any:
		if s.Items.Type == "object" {
			for _, item := range value {
				s.Items.Complete(item)
			}
		}
	}
}

// join returns a pointer and one step more.
func join(path, key string) string {
	key = strings.ReplaceAll(strings.ReplaceAll(key, "~", "~0"), "/", "~1")
	if path == "" {
		return key
	}
	return path + "/" + key
}
