package main

// Strict JSON: RFC 8259 as narrowed by I-JSON, RFC 7493. The standard library's decoder takes the last of duplicate
// keys, mends lone surrogates and nests 10,000 deep, so that frames are read here; it still writes the replies.

import (
	"fmt"
	"math"
	"strconv"
	"unicode/utf16"
	"unicode/utf8"
)

const nesting = 200

// number is kept as it was written too, for whole numbers that a float64 cannot hold.
type number struct {
	value float64
	text  string
}

// message is a JSON object: what its fields hold (nil, bool, number, string, []any, map[string]any), and the id as it
// was written.
type message struct {
	fields map[string]any
	id     []byte
}

// parse reads one frame. The error is one that the peer is told.
func parse(frame []byte) (message, *failure) {
	if !utf8.Valid(frame) {
		return message{}, &failure{code: "bad_frame", message: "the frame is not UTF-8"}
	}
	p := &parser{data: frame}
	value, err := p.document()
	if err != nil {
		return message{}, &failure{code: "bad_json", message: fmt.Sprintf("%v at byte %d", err, p.at)}
	}
	fields, isObject := value.(map[string]any)
	if !isObject {
		return message{}, &failure{code: "bad_frame", message: "expected a JSON object"}
	}
	return message{fields, p.id}, nil
}

type parser struct {
	data  []byte
	at    int
	depth int
	id    []byte // of the outermost object
}

func (p *parser) document() (any, error) {
	p.white()
	value, err := p.value()
	if err != nil {
		return nil, err
	}
	p.white()
	if p.at < len(p.data) {
		return nil, fmt.Errorf("more follows the value")
	}
	return value, nil
}

func (p *parser) white() {
	for p.at < len(p.data) && isWhite(p.data[p.at]) {
		p.at++
	}
}

func isWhite(b byte) bool {
	return b == ' ' || b == '\t' || b == '\n' || b == '\r'
}

// next returns the byte that comes, or 0, which is nowhere part of JSON, at the end.
func (p *parser) next() byte {
	if p.at < len(p.data) {
		return p.data[p.at]
	}
	return 0
}

func (p *parser) value() (any, error) {
	switch b := p.next(); {
	case b == '{':
		return p.nested(p.object)
	case b == '[':
		return p.nested(p.array)
	case b == '"':
		return p.text()
	case b == '-' || isDigit(b):
		return p.number()
	}
	for word, value := range map[string]any{"true": true, "false": false, "null": nil} {
		if end := p.at + len(word); end <= len(p.data) && string(p.data[p.at:end]) == word {
			p.at = end
			return value, nil
		}
	}
	return nil, fmt.Errorf("expected a value")
}

func (p *parser) nested(read func() (any, error)) (any, error) {
	if p.depth++; p.depth > nesting {
		return nil, fmt.Errorf("nested more than %d deep", nesting)
	}
	p.at++
	value, err := read()
	p.depth--
	return value, err
}

func (p *parser) object() (any, error) {
	fields := map[string]any{}
	if p.white(); p.next() == '}' {
		p.at++
		return fields, nil
	}
	for {
		p.white()
		if p.next() != '"' {
			return nil, fmt.Errorf("expected a key")
		}
		key, err := p.text()
		if err != nil {
			return nil, err
		}
		if _, twice := fields[key]; twice {
			return nil, fmt.Errorf("the key %q comes twice", key)
		}
		if p.white(); p.next() != ':' {
			return nil, fmt.Errorf("expected ':'")
		}
		p.at++
		p.white()
		start := p.at
		value, err := p.value()
		if err != nil {
			return nil, err
		}
		fields[key] = value
		if key == "id" && p.depth == 1 {
			p.id = p.data[start:p.at]
		}
		p.white()
		switch p.next() {
		case ',':
			p.at++
		case '}':
			p.at++
			return fields, nil
		default:
			return nil, fmt.Errorf("expected ',' or '}'")
		}
	}
}

func (p *parser) array() (any, error) {
	items := []any{}
	if p.white(); p.next() == ']' {
		p.at++
		return items, nil
	}
	for {
		p.white()
		value, err := p.value()
		if err != nil {
			return nil, err
		}
		items = append(items, value)
		p.white()
		switch p.next() {
		case ',':
			p.at++
		case ']':
			p.at++
			return items, nil
		default:
			return nil, fmt.Errorf("expected ',' or ']'")
		}
	}
}

func isDigit(b byte) bool {
	return '0' <= b && b <= '9'
}

func (p *parser) digits() bool {
	start := p.at
	for isDigit(p.next()) {
		p.at++
	}
	return p.at > start
}

func (p *parser) number() (any, error) {
	start := p.at
	if p.next() == '-' {
		p.at++
	}
	if p.next() == '0' {
		p.at++
	} else if !p.digits() {
		return nil, fmt.Errorf("expected a digit")
	}
	if p.next() == '.' {
		if p.at++; !p.digits() {
			return nil, fmt.Errorf("expected a digit")
		}
	}
	if b := p.next(); b == 'e' || b == 'E' {
		p.at++
		if b := p.next(); b == '+' || b == '-' {
			p.at++
		}
		if !p.digits() {
			return nil, fmt.Errorf("expected a digit")
		}
	}
	text := string(p.data[start:p.at])
	value, _ := strconv.ParseFloat(text, 64) // the only possible error is a number that is out of range
	if math.IsInf(value, 0) {
		return nil, fmt.Errorf("the number is too large")
	}
	return number{value, text}, nil
}

func (p *parser) text() (string, error) {
	p.at++
	var text []byte
	for {
		switch b := p.next(); {
		case p.at >= len(p.data):
			return "", fmt.Errorf("a string has no end")
		case b == '"':
			p.at++
			return string(text), nil
		case b == '\\':
			p.at++
			character, err := p.escape()
			if err != nil {
				return "", err
			}
			text = utf8.AppendRune(text, character)
		case b < ' ':
			return "", fmt.Errorf("a control character in a string")
		default:
			text = append(text, b)
			p.at++
		}
	}
}

var escapes = map[byte]rune{
	'"': '"', '\\': '\\', '/': '/', 'b': '\b', 'f': '\f', 'n': '\n', 'r': '\r', 't': '\t',
}

func (p *parser) escape() (rune, error) {
	b := p.next()
	p.at++
	if b != 'u' {
		if character, known := escapes[b]; known {
			return character, nil
		}
		return 0, fmt.Errorf("there is no such escape")
	}
	first, err := p.unit()
	if err != nil || !utf16.IsSurrogate(first) {
		return first, err
	}
	if p.at+1 < len(p.data) && p.data[p.at] == '\\' && p.data[p.at+1] == 'u' {
		p.at += 2
		second, err := p.unit()
		if err != nil {
			return 0, err
		}
		if pair := utf16.DecodeRune(first, second); pair != utf8.RuneError {
			return pair, nil
		}
	}
	return 0, fmt.Errorf("a lone surrogate")
}

func (p *parser) unit() (rune, error) {
	if p.at+4 > len(p.data) {
		return 0, fmt.Errorf("expected four hexadecimal digits")
	}
	for _, b := range p.data[p.at : p.at+4] {
		if !isDigit(b) && !('a' <= b|32 && b|32 <= 'f') {
			return 0, fmt.Errorf("expected four hexadecimal digits")
		}
	}
	value, err := strconv.ParseUint(string(p.data[p.at:p.at+4]), 16, 16)
	p.at += 4
	return rune(value), err
}
