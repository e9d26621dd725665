package genome_test

import (
	"fmt"
	"strings"
	"testing"

	"nmes/genome"
)

// with returns the hopper with other fields in place of its brain.
func with(fields string) []byte {
	text, _, _ := strings.Cut(hopper, `"brain"`)
	return []byte(text + fields + "}")
}

func repeated(count int, item func(int) string) string {
	items := make([]string, count)
	for i := range items {
		items[i] = item(i)
	}
	return "[" + strings.Join(items, ", ") + "]"
}

// TestOfTheLargestBadDocumentsNoMoreIsToldThanOfOthers has documents of whose names each could be held against all.
func TestOfTheLargestBadDocumentsNoMoreIsToldThanOfOthers(t *testing.T) {
	letters := func(i int) string { return strings.Repeat(string(rune('a'+i%26)), 50) + fmt.Sprint(i) }
	for name, text := range map[string][]byte{
		"links to nowhere": with(`"brain": {"kind": "graph", "nodes": [{"id": "out", "motor": "leg"}], "links": ` +
			repeated(16384, func(i int) string { return fmt.Sprintf(`{"sensor": "%s", "to": "%s"}`, letters(i), letters(i+1)) }) + "}"),
		"wildcards": with(`"brain": {"kind": "graph", "nodes": [{"id": "out", "motor": "leg"}], "links": ` +
			repeated(16384, func(i int) string { return fmt.Sprintf(`{"sensor": "*a*b*c*%d", "to": "out"}`, i) }) + "}"),
		"rules of nothing": with(`"development": ` + repeated(64, func(i int) string {
			names := repeated(16, func(j int) string { return `"` + letters(16*i+j) + `"` })
			return fmt.Sprintf(`{"when": "%s1 > 0", "grow": %s}`, strings.Repeat("-", 490), names)
		})),
		"sensors of nothing": with(`"sensors": ` +
			repeated(1024, func(i int) string { return fmt.Sprintf(`{"type": "touch", "cube": "*%s*"}`, letters(i)[:40]) })),
		"a million numbers": with(`"brain": {"kind": "mlp", "layers": [{"biases": [0], "weights": ` + repeated(256, func(int) string {
			return repeated(4096, func(int) string { return "1e9" })
		}) + "}]}"),
	} {
		if problems := genome.Check(text); len(problems) != 21 {
			t.Errorf("%s: %d problems", name, len(problems))
		}
	}
}

func TestADocumentOfMillionsOfValuesIsRefusedUnread(t *testing.T) {
	const told = "more than 4,194,304 values"
	text := "no JSON" + strings.Repeat(",", 1<<22)
	if problems := genome.Check([]byte(text)); len(problems) != 1 || problems[0].Message == told {
		t.Errorf("there may be so many: %v", problems)
	}
	if problems := genome.Check([]byte(text + ",")); len(problems) != 1 || problems[0].Message != told {
		t.Errorf("%v", problems)
	}
}
