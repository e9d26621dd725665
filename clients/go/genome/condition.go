package genome

import (
	"fmt"
	"math"
	"regexp"
	"slices"
	"strconv"
	"strings"
	"unicode/utf8"
)

// A condition is an expression in Google's Common Expression Language over a few names. It is judged here, not followed:
// a world does that. It can add, compare and choose, and nothing else, so its cost is bounded by its
// length, and that by its schema.

const (
	deepestCondition = 30
	isNumber         = "a number"
	isTruth          = "true or false"
)

var (
	conditionNames     = []string{"age", "energy", "cubes", "mass", "stage"}
	conditionFunctions = []string{"abs", "exp", "log", "max", "min", "sqrt"}
	conditionToken     = regexp.MustCompile(`^(?:([ \t\r\n]+)` +
		`|((?:[0-9]+(?:\.[0-9]+)?|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)` +
		`|([A-Za-z_][A-Za-z0-9_]*)` +
		`|("[^"\\\r\n]*"|'[^'\\\r\n]*')` +
		`|(<=|>=|==|!=|&&|\|\||[-+*/<>!?:().,]))`)
	tokenKinds = []string{"space", "number", "name", "string", "mark"}
)

type token struct {
	kind, text string // kind "end" behind the last
	at         int
}

// conditionReader reads one expression. Each method of the grammar returns the kind of value that it has read.
type conditionReader struct {
	text   string
	parts  map[string][]string // what may be asked of things that have ids, with those ids
	tokens []token
	next   int
	depth  int
}

// refusal ends the reading of an expression.
type refusal struct{ words string }

// wrongCondition returns in words what is wrong with a condition; nothing where nothing is.
func wrongCondition(text string, parts map[string][]string) (words string) {
	defer func() {
		switch end := recover().(type) {
		case nil:
		case refusal:
			words = end.words
		default:
			panic(end)
		}
	}()
	r := &conditionReader{text: text, parts: parts}
	r.split()
	start := r.token()
	kind := r.choice()
	if r.token().kind != "end" {
		r.refuse(r.token().at, "expected an operator or the end, found %s", r.here())
	}
	if kind != isTruth {
		r.refuse(start.at, "it must give %s, but gives %s", isTruth, kind)
	}
	return ""
}

func (r *conditionReader) refuse(at int, format string, values ...any) {
	before := r.text[:at]
	line := strings.Count(before, "\n") + 1
	column := utf8.RuneCountInString(before[strings.LastIndexByte(before, '\n')+1:]) + 1
	panic(refusal{fmt.Sprintf("line %d, column %d: ", line, column) + fmt.Sprintf(format, values...)})
}

func (r *conditionReader) split() {
	for at := 0; at < len(r.text); {
		found := conditionToken.FindStringSubmatch(r.text[at:])
		if found == nil {
			character, _ := utf8.DecodeRuneInString(r.text[at:])
			if character == '"' || character == '\'' {
				r.refuse(at, "this text has no end, or a backslash in it here")
			}
			r.refuse(at, "%s means nothing here", quoted(string(character)))
		}
		kind := tokenKinds[slices.IndexFunc(found[1:], func(group string) bool { return group != "" })]
		if kind != "space" {
			r.tokens = append(r.tokens, token{kind, found[0], at})
		}
		at += len(found[0])
	}
	r.tokens = append(r.tokens, token{"end", "", len(r.text)})
}

func (r *conditionReader) token() token { return r.tokens[r.next] }

func (r *conditionReader) here() string {
	if r.token().kind == "end" {
		return "the end"
	}
	return quoted(r.token().text)
}

func (r *conditionReader) take() token {
	r.next++
	return r.tokens[r.next-1]
}

func (r *conditionReader) is(marks ...string) bool {
	return r.token().kind == "mark" && slices.Contains(marks, r.token().text)
}

func (r *conditionReader) expect(mark, why string) {
	if !r.is(mark) {
		r.refuse(r.token().at, "expected %s %s, found %s", quoted(mark), why, r.here())
	}
	r.take()
}

func (r *conditionReader) want(expected, kind string, at int, what string) {
	if kind != expected {
		r.refuse(at, "%s takes %s, but this is %s", what, expected, kind)
	}
}

// chain reads operands of one precedence, and of one kind if there are several.
func (r *conditionReader) chain(below func() string, kind string, marks ...string) string {
	at := r.token().at
	value := below()
	for r.is(marks...) {
		mark := r.take().text
		r.want(kind, value, at, mark)
		at = r.token().at
		r.want(kind, below(), at, mark)
	}
	return value
}

func (r *conditionReader) choice() string {
	r.depth++
	if r.depth > deepestCondition {
		r.refuse(r.token().at, "it is nested more than %d deep", deepestCondition)
	}
	at := r.token().at
	value := r.either()
	if r.is("?") {
		r.want(isTruth, value, at, "?")
		r.take()
		value = r.either()
		r.expect(":", "between the two choices")
		at = r.token().at
		if that := r.choice(); that != value {
			r.refuse(at, "the choice before ':' is %s, but this is %s", value, that)
		}
	}
	r.depth--
	return value
}

func (r *conditionReader) either() string { return r.chain(r.both, isTruth, "||") }
func (r *conditionReader) both() string   { return r.chain(r.relation, isTruth, "&&") }

func (r *conditionReader) relation() string {
	at := r.token().at
	value := r.sum()
	for r.is("<", "<=", ">", ">=", "==", "!=") {
		mark := r.take().text
		if mark != "==" && mark != "!=" {
			r.want(isNumber, value, at, mark)
		}
		at = r.token().at
		r.want(value, r.sum(), at, mark+" after "+value)
		value = isTruth
	}
	return value
}

func (r *conditionReader) sum() string     { return r.chain(r.product, isNumber, "+", "-") }
func (r *conditionReader) product() string { return r.chain(r.signed, isNumber, "*", "/") }

func (r *conditionReader) signed() string {
	if !r.is("-", "!") {
		return r.member()
	}
	mark, kind := r.token().text, isTruth
	if mark == "-" {
		kind = isNumber
	}
	for r.is(mark) {
		r.take()
	}
	at := r.token().at
	r.want(kind, r.member(), at, mark)
	return kind
}

func (r *conditionReader) member() string {
	token := r.token()
	switch {
	case token.kind == "number":
		r.take()
		if value, _ := strconv.ParseFloat(token.text, 64); math.IsInf(value, 0) {
			r.refuse(token.at, "this number is too large")
		}
		return isNumber
	case token.kind == "name":
		return r.name()
	case r.is("("):
		r.take()
		value := r.choice()
		r.expect(")", "after what is in parentheses")
		return value
	case token.kind == "string":
		r.refuse(token.at, `there is no text in an objective but the id in cube("id")`)
	}
	r.refuse(token.at, "expected a value, found %s", r.here())
	return ""
}

func (r *conditionReader) name() string {
	word := r.take()
	if word.text == "true" || word.text == "false" {
		return isTruth
	}
	known, ofPart := r.parts[word.text]
	switch {
	case ofPart:
		r.part(word, known)
	case r.is("("):
		r.call(word)
	case !slices.Contains(conditionNames, word.text):
		r.refuse(word.at, "there is no quantity %s%s", quoted(clipped(word.text, mostExcerpt)), nearest(word.text, conditionNames))
	}
	return isNumber
}

func (r *conditionReader) call(name token) {
	if !slices.Contains(conditionFunctions, name.text) {
		near := nearest(name.text, conditionFunctions)
		r.refuse(name.at, "there is no function %s%s", quoted(clipped(name.text, mostExcerpt)), near)
	}
	count := 0
	for count == 0 || r.is(",") {
		r.take()
		at := r.token().at
		r.want(isNumber, r.choice(), at, name.text+"()")
		count++
	}
	r.expect(")", "after the arguments of "+name.text)
	many := name.text == "min" || name.text == "max"
	if many && count < 2 {
		r.refuse(name.at, "%s takes two numbers or more, not %d", name.text, count)
	}
	if !many && count > 1 {
		r.refuse(name.at, "%s takes one number, not %d", name.text, count)
	}
}

// part reads the id in sense("foot.touch"), and looks whether there is such a thing.
func (r *conditionReader) part(word token, known []string) {
	r.expect("(", "and an id after "+word.text)
	token := r.token()
	if token.kind != "string" {
		r.refuse(token.at, `expected an id in quotes, as in %s("leg"), found %s`, word.text, r.here())
	}
	name := token.text[1 : len(token.text)-1]
	if !slices.Contains(known, name) {
		r.refuse(token.at, "there is none %s%s", quoted(clipped(name, mostExcerpt)), nearest(name, known))
	}
	r.take()
	r.expect(")", "after the id")
}
