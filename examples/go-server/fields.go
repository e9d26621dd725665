package main

// What the fields of commands may hold. The bounds are those of the project's JSON Schemas.

import (
	"fmt"
	"math"
	"strconv"
	"unicode"
	"unicode/utf8"
)

// failure is what an `error` reply tells.
type failure struct {
	code, message, field string
}

func invalid(field, format string, values ...any) *failure {
	return &failure{"invalid", field + ": " + fmt.Sprintf(format, values...), field}
}

// check says what is wrong with a value that stands at a path.
type check func(value any, path string) *failure

type field struct {
	name     string
	required bool
	check    check
}

// validate checks the fields of a command, and leaves out those that nobody knows.
func validate(given map[string]any, fields []field) *failure {
	for _, f := range fields {
		value, there := given[f.name]
		if !there {
			if f.required {
				return invalid(f.name, "is missing")
			}
			continue
		}
		if wrong := f.check(value, f.name); wrong != nil {
			return wrong
		}
	}
	return nil
}

func between(low, high float64) check {
	return func(value any, path string) *failure {
		if n, isNumber := value.(number); !isNumber || n.value < low || n.value > high {
			return invalid(path, "expected a number from %g to %g", low, high)
		}
		return nil
	}
}

func wholeBetween(low, high float64) check {
	return func(value any, path string) *failure {
		n, isNumber := value.(number)
		if !isNumber || n.value != math.Trunc(n.value) || n.value < low || n.value > high {
			return invalid(path, "expected a whole number from %.0f to %.0f", low, high)
		}
		return nil
	}
}

func numbers(least, most int, each check) check {
	return func(value any, path string) *failure {
		items, isArray := value.([]any)
		if !isArray || len(items) < least || len(items) > most {
			return invalid(path, "expected %d to %d numbers", least, most)
		}
		for i, item := range items {
			if wrong := each(item, path+"/"+strconv.Itoa(i)); wrong != nil {
				return wrong
			}
		}
		return nil
	}
}

func vector(bound float64) check {
	return numbers(3, 3, between(-bound, bound))
}

// notZero asks that one number be at least a millionth in size.
func notZero(inner check) check {
	return func(value any, path string) *failure {
		if wrong := inner(value, path); wrong != nil {
			return wrong
		}
		for _, item := range value.([]any) {
			if math.Abs(item.(number).value) >= 1e-6 {
				return nil
			}
		}
		return invalid(path, "expected numbers that are not all 0")
	}
}

// object asks for an object whose known fields pass their checks.
func object(fields map[string]check) check {
	return func(value any, path string) *failure {
		given, isObject := value.(map[string]any)
		if !isObject {
			return invalid(path, "expected an object")
		}
		for _, key := range sorted(fields) {
			if inner, there := given[key]; there {
				if wrong := fields[key](inner, path+"/"+key); wrong != nil {
					return wrong
				}
			}
		}
		return nil
	}
}

// notes asks for an object of a few numbers by name.
func notes(value any, path string) *failure {
	given, isObject := value.(map[string]any)
	if !isObject || len(given) > 32 {
		return invalid(path, "expected an object of at most 32 numbers")
	}
	for key, number := range given {
		if wrong := nameLength(key, path); wrong != nil {
			return wrong
		}
		if wrong := between(-1e15, 1e15)(number, path+"/"+key); wrong != nil {
			return wrong
		}
	}
	return nil
}

func nameLength(key, path string) *failure {
	if count := utf8.RuneCountInString(key); count < 1 || count > 64 {
		return invalid(path, "expected names of 1 to 64 characters")
	}
	return nil
}

func boolean(value any, path string) *failure {
	if _, isBool := value.(bool); !isBool {
		return invalid(path, "expected true or false")
	}
	return nil
}

func text(longest int) check {
	return func(value any, path string) *failure {
		if s, isString := value.(string); !isString || utf8.RuneCountInString(s) > longest {
			return invalid(path, "expected a string of at most %d characters", longest)
		}
		return nil
	}
}

func nameUpTo(longest int) check {
	return func(value any, path string) *failure {
		s, isString := value.(string)
		count := utf8.RuneCountInString(s)
		if !isString || count < 1 || count > longest {
			return invalid(path, "expected a name of 1 to %d characters", longest)
		}
		for _, r := range s {
			if unicode.IsSpace(r) || unicode.IsControl(r) || unicode.Is(unprintable, r) {
				return invalid(path, "expected a name without white space")
			}
		}
		return nil
	}
}

var unprintable = &unicode.RangeTable{R16: []unicode.Range16{
	{0xad, 0xad, 1}, {0x200b, 0x200f, 1}, {0x2028, 0x202e, 1}, {0x2060, 0x206f, 1}, {0xfeff, 0xfeff, 1},
	{0xfff9, 0xffff, 1},
}}

var name = nameUpTo(128)

func oneOf(choices ...string) check {
	return func(value any, path string) *failure {
		for _, choice := range choices {
			if value == choice {
				return nil
			}
		}
		return invalid(path, "expected one of %v", choices)
	}
}

func rotation(value any, path string) *failure {
	turn := between(-1000, 1000)
	if items, isArray := value.([]any); isArray && len(items) == 4 {
		return notZero(numbers(4, 4, turn))(value, path)
	}
	return numbers(3, 3, turn)(value, path)
}

func size(value any, path string) *failure {
	edge := between(0.001, 1000)
	if _, isArray := value.([]any); isArray {
		return numbers(3, 3, edge)(value, path)
	}
	return edge(value, path)
}

// floats returns the numbers of a valid array, or those given if there is none.
func floats(value any, otherwise ...float64) []float64 {
	items, there := value.([]any)
	if !there {
		return otherwise
	}
	result := make([]float64, len(items))
	for i, item := range items {
		result[i] = item.(number).value
	}
	return result
}

func float(value any, otherwise float64) float64 {
	if n, there := value.(number); there {
		return n.value
	}
	return otherwise
}

func vec(value any, otherwise ...float64) Vec {
	v := floats(value, otherwise...)
	return Vec{v[0], v[1], v[2]}
}
