package genome

import (
	"bytes"
	"crypto/sha256"
	"encoding/hex"
	"encoding/json"
	"errors"
	"fmt"
	"math"
	"slices"
	"strconv"
	"unicode/utf16"
	"unicode/utf8"
)

// object and array are JSON's; numbers are int64, uint64 and float64.
type (
	object = map[string]any
	array  = []any
)

const (
	mostNesting    = 200
	mostContainers = 1 << 16
	mostValues     = 1 << 22 // a digit and a comma become many times as many bytes
	largestFile    = 80 << 20
	wholeBelow     = 1 << 53 // beyond this not every whole number is a float64
)

// parse reads strict JSON: no duplicate keys, no number that is infinite as a double, neither too deep nor too much.
func parse(text []byte) (any, *DocumentError) {
	if len(text) > largestFile {
		return nil, refused("", fmt.Sprintf("it has over %d MiB, more than a genome may have", largestFile>>20))
	}
	if bytes.Count(text, []byte(",")) > mostValues {
		return nil, refused("", "more than 4,194,304 values")
	}
	if brackets := bytes.Count(text, []byte("[")) + bytes.Count(text, []byte("{")); brackets > mostContainers {
		return nil, refused("", "more than 65,536 arrays and objects")
	}
	for at := 0; at < len(text); {
		character, size := utf8.DecodeRune(text[at:])
		if character == utf8.RuneError && size == 1 {
			return nil, refused("", fmt.Sprintf("invalid UTF-8 at byte %d", at))
		}
		at += size
	}
	p := &parser{text: text}
	value, err := p.value(1)
	if err == nil {
		if p.space(); p.at < len(text) {
			err = p.unexpected("the end")
		}
	}
	if err != nil {
		return nil, refused("", err.Error())
	}
	return value, nil
}

var errDeep = fmt.Errorf("nested more than %d deep", mostNesting)

type parser struct {
	text []byte
	at   int
}

func (p *parser) unexpected(wanted string) error {
	before := p.text[:p.at]
	line, column := bytes.Count(before, []byte("\n"))+1, p.at-bytes.LastIndexByte(before, '\n')
	return fmt.Errorf("not strict JSON: expected %s at line %d column %d", wanted, line, column)
}

func (p *parser) space() {
	for p.at < len(p.text) && bytes.IndexByte([]byte(" \t\n\r"), p.text[p.at]) >= 0 {
		p.at++
	}
}

// next tells whether the next character, behind white space, is this one, and takes it then.
func (p *parser) next(character byte) bool {
	p.space()
	if p.at < len(p.text) && p.text[p.at] == character {
		p.at++
		return true
	}
	return false
}

func (p *parser) value(depth int) (any, error) {
	p.space()
	rest := p.text[p.at:]
	for word, value := range map[string]any{"true": true, "false": false, "null": nil} {
		if bytes.HasPrefix(rest, []byte(word)) {
			p.at += len(word)
			return value, nil
		}
	}
	switch {
	case len(rest) == 0:
		return nil, p.unexpected("a value")
	case rest[0] == '"':
		return p.string()
	case rest[0] == '{' || rest[0] == '[':
		if depth > mostNesting {
			return nil, errDeep
		}
		if rest[0] == '{' {
			return p.object(depth)
		}
		return p.array(depth)
	}
	return p.number()
}

func (p *parser) object(depth int) (any, error) {
	p.at++
	fields := object{}
	for first := true; ; first = false {
		if first && p.next('}') {
			return fields, nil
		}
		p.space()
		begin := p.at
		if p.at == len(p.text) || p.text[p.at] != '"' {
			return nil, p.unexpected("a key")
		}
		key, err := p.string()
		if err != nil {
			return nil, err
		}
		if _, known := fields[key]; known {
			p.at = begin
			return nil, p.unexpected("a key that is not there already")
		}
		if !p.next(':') {
			return nil, p.unexpected("':'")
		}
		if fields[key], err = p.value(depth + 1); err != nil {
			return nil, err
		}
		if p.next('}') {
			return fields, nil
		}
		if !p.next(',') {
			return nil, p.unexpected("',' or '}'")
		}
	}
}

func (p *parser) array(depth int) (any, error) {
	p.at++
	items := array{}
	if p.next(']') {
		return items, nil
	}
	for {
		item, err := p.value(depth + 1)
		if err != nil {
			return nil, err
		}
		items = append(items, item)
		if p.next(']') {
			return items, nil
		}
		if !p.next(',') {
			return nil, p.unexpected("',' or ']'")
		}
	}
}

func (p *parser) string() (string, error) {
	p.at++
	var text []byte
	for p.at < len(p.text) {
		character := p.text[p.at]
		switch {
		case character == '"':
			p.at++
			return string(text), nil
		case character < ' ':
			return "", p.unexpected("no control character")
		case character != '\\':
			text = append(text, character)
			p.at++
		default:
			escaped, err := p.escape()
			if err != nil {
				return "", err
			}
			text = utf8.AppendRune(text, escaped)
		}
	}
	return "", p.unexpected("the end of a string")
}

func (p *parser) escape() (rune, error) {
	if p.at+1 < len(p.text) {
		if i := bytes.IndexByte([]byte(`"\/bfnrt`), p.text[p.at+1]); i >= 0 {
			p.at += 2
			return rune("\"\\/\b\f\n\r\t"[i]), nil
		}
	}
	high, good := p.unit()
	if good && !utf16.IsSurrogate(high) {
		p.at += 6
		return high, nil
	}
	if good {
		p.at += 6
		if low, paired := p.unit(); paired {
			if both := utf16.DecodeRune(high, low); both != utf8.RuneError {
				p.at += 6
				return both, nil
			}
		}
	}
	return 0, p.unexpected("a good escape")
}

// unit returns the \uXXXX that stands here.
func (p *parser) unit() (rune, bool) {
	if p.at+6 > len(p.text) || p.text[p.at] != '\\' || p.text[p.at+1] != 'u' {
		return 0, false
	}
	value, err := strconv.ParseUint(string(p.text[p.at+2:p.at+6]), 16, 16)
	return rune(value), err == nil
}

func (p *parser) number() (any, error) {
	begin, whole := p.at, true
	digits := func() int {
		first := p.at
		for p.at < len(p.text) && '0' <= p.text[p.at] && p.text[p.at] <= '9' {
			p.at++
		}
		return p.at - first
	}
	take := func(characters string) bool {
		if p.at < len(p.text) && bytes.IndexByte([]byte(characters), p.text[p.at]) >= 0 {
			p.at++
			return true
		}
		return false
	}
	take("-")
	if !take("0") && digits() == 0 {
		return nil, p.unexpected("a value")
	}
	if take(".") {
		whole = false
		if digits() == 0 {
			return nil, p.unexpected("a digit")
		}
	}
	if take("eE") {
		whole = false
		take("+-")
		if digits() == 0 {
			return nil, p.unexpected("a digit")
		}
	}
	text := string(p.text[begin:p.at])
	if whole {
		if value, err := strconv.ParseInt(text, 10, 64); err == nil {
			return value, nil
		}
		if value, err := strconv.ParseUint(text, 10, 64); err == nil {
			return value, nil
		}
	}
	value, err := strconv.ParseFloat(text, 64)
	if err != nil && math.IsInf(value, 0) {
		p.at = begin
		return nil, p.unexpected("a number that is finite as a double")
	}
	return value, nil
}

// plain returns any data that JSON can hold as this package has them: a new copy.
func plain(data any) (any, *DocumentError) {
	text, err := json.Marshal(data)
	if err != nil {
		return nil, refused("", "this is not JSON data: "+err.Error())
	}
	value, wrong := parse(text)
	return value, wrong
}

// cloned returns a deep copy of JSON data.
func cloned[T any](value T) T {
	copied, _ := copyOf(value).(T)
	return copied
}

func copyOf(value any) any {
	switch value := value.(type) {
	case object:
		fields := make(object, len(value))
		for key, item := range value {
			fields[key] = copyOf(item)
		}
		return fields
	case array:
		items := make(array, len(value))
		for i, item := range value {
			items[i] = copyOf(item)
		}
		return items
	}
	return value
}

// write returns JSON without white space; canonically, keys are sorted and whole numbers have no fraction.
func write(value any) []byte          { return written(nil, value, false) }
func writeCanonical(value any) []byte { return written(nil, value, true) }

func hashOf(document any) string {
	sum := sha256.Sum256(writeCanonical(document))
	return hex.EncodeToString(sum[:])
}

func written(text []byte, value any, canonical bool) []byte {
	switch value := value.(type) {
	case nil:
		return append(text, "null"...)
	case bool:
		return strconv.AppendBool(text, value)
	case int64:
		return strconv.AppendInt(text, value, 10)
	case uint64:
		return strconv.AppendUint(text, value, 10)
	case float64:
		if canonical && value == math.Trunc(value) && math.Abs(value) < wholeBelow {
			return strconv.AppendInt(text, int64(value), 10)
		}
		return appendFloat(text, value)
	case string:
		return appendString(text, value)
	case array:
		text = append(text, '[')
		for i, item := range value {
			if i > 0 {
				text = append(text, ',')
			}
			text = written(text, item, canonical)
		}
		return append(text, ']')
	case object:
		text = append(text, '{')
		for i, key := range sortedKeys(value) {
			if i > 0 {
				text = append(text, ',')
			}
			text = append(appendString(text, key), ':')
			text = written(text, value[key], canonical)
		}
		return append(text, '}')
	}
	panic(fmt.Sprintf("genome: a %T is nothing that JSON has", value)) // a fault of this package
}

func sortedKeys[T any](fields map[string]T) []string {
	keys := make([]string, 0, len(fields))
	for key := range fields {
		keys = append(keys, key)
	}
	slices.Sort(keys)
	return keys
}

// appendFloat writes the shortest decimal that is the same double: plain from 0.00001 to below 1e16.
func appendFloat(text []byte, value float64) []byte {
	size := math.Abs(value)
	if size != 0 && (size < 1e-5 || size >= 1e16) {
		short := strconv.FormatFloat(value, 'e', -1, 64)
		at := bytes.IndexByte([]byte(short), 'e')
		sign, digits := short[at+1], short[at+2:]
		if len(digits) == 2 && digits[0] == '0' {
			digits = digits[1:]
		}
		text = append(text, short[:at+1]...)
		if sign == '-' {
			text = append(text, '-')
		} else {
			text = append(text, '+')
		}
		return append(text, digits...)
	}
	text = strconv.AppendFloat(text, value, 'f', -1, 64)
	if value == math.Trunc(value) {
		text = append(text, ".0"...)
	}
	return text
}

func appendString(text []byte, value string) []byte {
	text = append(text, '"')
	for i := range len(value) {
		switch character := value[i]; {
		case character == '"' || character == '\\':
			text = append(text, '\\', character)
		case character >= ' ':
			text = append(text, character)
		default:
			if at := bytes.IndexByte([]byte("\b\f\n\r\t"), character); at >= 0 {
				text = append(text, '\\', "bfnrt"[at])
			} else {
				text = fmt.Appendf(text, "\\u%04x", character)
			}
		}
	}
	return append(text, '"')
}

// equal tells whether two values are the same JSON: 1 and 1.0 are.
func equal(one, other any) bool {
	if a, number := numberOf(one); number {
		b, too := numberOf(other)
		return too && a == b
	}
	switch one := one.(type) {
	case array:
		list, too := other.(array)
		return too && slices.EqualFunc(one, list, equal)
	case object:
		fields, too := other.(object)
		if !too || len(one) != len(fields) {
			return false
		}
		for key, value := range one {
			if item, there := fields[key]; !there || !equal(value, item) {
				return false
			}
		}
		return true
	}
	return one == other
}

func numberOf(value any) (float64, bool) {
	switch value := value.(type) {
	case float64:
		return value, true
	case int64:
		return float64(value), true
	case uint64:
		return float64(value), true
	}
	return 0, false
}

var errNumber = errors.New("no number")

// number returns a number of a document that its schema has accepted, or else the default.
func number(fields object, name string, otherwise float64) float64 {
	value, there := fields[name]
	if !there {
		return otherwise
	}
	return mustNumber(value)
}

func mustNumber(value any) float64 {
	result, good := numberOf(value)
	if !good {
		panic(errNumber) // its schema would have refused it
	}
	return result
}

func whole(fields object, name string, otherwise int) int {
	return int(number(fields, name, float64(otherwise)))
}

func text(fields object, name, otherwise string) string {
	if value, there := fields[name].(string); there {
		return value
	}
	return otherwise
}

// list returns the array of a name, empty where there is none.
func list(fields object, name string) array {
	items, _ := fields[name].(array)
	return items
}

// objects returns the objects of an array of a document that its schema has accepted.
func objects(fields object, name string) []object {
	items := list(fields, name)
	result := make([]object, len(items))
	for i, item := range items {
		result[i] = item.(object)
	}
	return result
}

func texts(items array) []string {
	result := make([]string, len(items))
	for i, item := range items {
		result[i] = item.(string)
	}
	return result
}

func numbers(items array) []float64 {
	result := make([]float64, len(items))
	for i, item := range items {
		result[i] = mustNumber(item)
	}
	return result
}

// anyOf returns an array of a document.
func anyOf[T any](items []T) array {
	result := make(array, len(items))
	for i, item := range items {
		result[i] = item
	}
	return result
}

func has(fields object, name string) bool {
	_, there := fields[name]
	return there
}
