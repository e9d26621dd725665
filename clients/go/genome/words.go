package genome

import (
	"cmp"
	"fmt"
	"slices"
	"strconv"
	"strings"
	"unicode"
	"unicode/utf8"
)

const (
	mostExcerpt                        = 80 // characters of somebody's value that a message repeats
	mostCompared, mostKnown, mostClose = 24, 256, 4
	alike                              = 0.6 // how like a name must be to be meant
	mostPlaces                         = 8
	mostListed                         = 60 // names that a message of an expression lists
)

// excerpt returns the beginning of a value's JSON, for a message.
func excerpt(value any) string {
	return clipped(strings.ReplaceAll(string(write(value)), "<", `\u003c`), mostExcerpt)
}

func clipped(words string, most int) string {
	if utf8.RuneCountInString(words) <= most {
		return words
	}
	return string([]rune(words)[:most-3]) + "..."
}

// quoted returns a text as Python repeats it, in quotes.
func quoted(words string) string {
	quote := byte('\'')
	if strings.Contains(words, "'") && !strings.Contains(words, `"`) {
		quote = '"'
	}
	result := []byte{quote}
	for _, character := range words {
		switch {
		case character == rune(quote) || character == '\\':
			result = append(result, '\\', byte(character))
		case character == '\n' || character == '\r' || character == '\t':
			result = append(result, '\\', "nrt"[strings.IndexRune("\n\r\t", character)])
		case character == ' ' || unicode.IsPrint(character):
			result = utf8.AppendRune(result, character)
		case character < 0x100:
			result = fmt.Appendf(result, `\x%02x`, character)
		case character < 0x10000:
			result = fmt.Appendf(result, `\u%04x`, character)
		default:
			result = fmt.Appendf(result, `\U%08x`, character)
		}
	}
	return string(append(result, quote))
}

func quotedAll(words []string) string {
	result := make([]string, len(words))
	for i, word := range words {
		result[i] = quoted(word)
	}
	return strings.Join(result, ", ")
}

// short returns a number with six digits at most, and shorter with three.
func short(value float64) string   { return strconv.FormatFloat(value, 'g', 6, 64) }
func shorter(value float64) string { return strconv.FormatFloat(value, 'g', 3, 64) }

// thousands returns a whole number with commas.
func thousands(value int) string {
	digits := strconv.Itoa(value)
	for at := len(digits) - 3; at > 0; at -= 3 {
		digits = digits[:at] + "," + digits[at:]
	}
	return digits
}

// norAt returns words for the other places where the same is wrong.
func norAt(places []string) string {
	if len(places) == 0 {
		return ""
	}
	more := ""
	if len(places) > mostPlaces {
		more = fmt.Sprintf(" and %d more", len(places)-mostPlaces)
	}
	return fmt.Sprintf(" (nor at %s%s)", strings.Join(places[:min(len(places), mostPlaces)], ", "), more)
}

// fits tells whether a name fits a pattern: * stands for any characters, also none, and ? for any one.
//
// It takes time in proportion to the name's length times the pattern's at most.
func fits(pattern, name string) bool {
	if !strings.ContainsAny(pattern, "*?") {
		return pattern == name
	}
	p, n := []rune(pattern), []rune(name)
	at, from, star := 0, 0, -1
	for i := 0; i < len(n); {
		switch {
		case at < len(p) && p[at] == '*':
			star, from = at, i
			at++
		case at < len(p) && (p[at] == '?' || p[at] == n[i]):
			at++
			i++
		case star >= 0:
			from++
			at, i = star+1, from
		default:
			return false
		}
	}
	for at < len(p) && p[at] == '*' {
		at++
	}
	return at == len(p)
}

func isPattern(name string) bool { return strings.ContainsAny(name, "*?") }

func fitting(pattern string, names []string) []string {
	var found []string
	for _, name := range names {
		if fits(pattern, name) {
			found = append(found, name)
		}
	}
	return found
}

type likeness struct {
	ratio float64
	name  string
}

func (l likeness) compare(other likeness) int {
	return cmp.Or(cmp.Compare(l.ratio, other.ratio), cmp.Compare(l.name, other.name))
}

// didYouMean returns "; did you mean leg?", to stand behind a message about an unknown name, or nothing if none is near.
func didYouMean(name string, known []string) string {
	b := cut(name, mostCompared)
	var rough []likeness
	for _, other := range known[:min(len(known), mostKnown)] {
		a := cut(other, mostCompared)
		if mostRatio(len(a), len(b)) >= alike {
			if ratio := quickRatio(a, b); ratio >= alike {
				rough = append(rough, likeness{ratio, other})
			}
		}
	}
	slices.SortFunc(rough, func(one, other likeness) int { return other.compare(one) })
	best := likeness{}
	for _, each := range rough[:min(len(rough), mostClose)] {
		if near := (likeness{ratio(cut(each.name, mostCompared), b), each.name}); near.compare(best) > 0 {
			best = near
		}
	}
	if best.ratio < alike {
		return ""
	}
	return fmt.Sprintf("; did you mean %s?", best.name)
}

// nearest returns the same of an expression, or else what there is.
func nearest(name string, known []string) string {
	b := cut(name, mostExcerpt)
	best := likeness{}
	for _, other := range known {
		a := []rune(other)
		if mostRatio(len(a), len(b)) >= alike && quickRatio(a, b) >= alike {
			if near := (likeness{ratio(a, b), other}); near.ratio >= alike && near.compare(best) > 0 {
				best = near
			}
		}
	}
	switch {
	case best.name != "":
		return fmt.Sprintf("; did you mean %s?", best.name)
	case len(known) == 0:
		return ""
	case len(known) > mostListed:
		return fmt.Sprintf("; there are %s and %d more", strings.Join(known[:mostListed], ", "), len(known)-mostListed)
	}
	return "; there are " + strings.Join(known, ", ")
}

func cut(words string, most int) []rune {
	runes := []rune(words)
	return runes[:min(len(runes), most)]
}

// What follows is the likeness of two texts by J. Ratcliff and D. Metzener (1988), as Python's difflib has it.

func share(matches, a, b int) float64 {
	if a+b == 0 {
		return 1
	}
	return float64(2.0*float64(matches)) / float64(a+b)
}

func mostRatio(a, b int) float64 { return share(min(a, b), a, b) }

func quickRatio(a, b []rune) float64 {
	left := map[rune]int{}
	for _, character := range b {
		left[character]++
	}
	matches := 0
	for _, character := range a {
		if left[character] > 0 {
			matches++
		}
		left[character]--
	}
	return share(matches, len(a), len(b))
}

func ratio(a, b []rune) float64 { return share(matching(a, b), len(a), len(b)) }

// matching returns how many characters are in the longest common part, and in those on either side of it.
func matching(a, b []rune) int {
	at, there, most := 0, 0, 0
	lengths := make([]int, len(b)+1)
	for i := range a {
		for j := len(b) - 1; j >= 0; j-- {
			if a[i] != b[j] {
				lengths[j+1] = 0
				continue
			}
			lengths[j+1] = lengths[j] + 1
		}
		for j := range b { // of those equally long the first in a, and there the first in b
			if lengths[j+1] > most {
				most = lengths[j+1]
				at, there = i-most+1, j-most+1
			}
		}
	}
	if most == 0 {
		return 0
	}
	return most + matching(a[:at], b[:there]) + matching(a[at+most:], b[there+most:])
}
