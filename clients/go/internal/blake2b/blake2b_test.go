package blake2b

import (
	"encoding/hex"
	"strings"
	"testing"
)

func TestHashesAreThoseOfPythonsHashlib(t *testing.T) {
	for _, each := range []struct {
		text   string
		size   int
		wanted string
	}{
		{"", 16, "cae66941d9efbd404e4d88758ea67670"},
		{"abc", 16, "cf4ab791c62b8d2b2109c90275287816"},
		{strings.Repeat("a", 128), 6, "5e7c18fe921b"},
		{strings.Repeat("a", 129), 32, "2f64744a6de0d2c0b56e64cf6e29a5aaa255010d415d51c75ccc82f73dccd865"},
		{strings.Repeat("xyz", 1000), 32, "d135e1580d74592daceaa95a835a08ca1c8d9e4aab79f67543399a96ebdb6e03"},
	} {
		if got := hex.EncodeToString(Sum([]byte(each.text), each.size)); got != each.wanted {
			t.Errorf("of %d bytes: %s, not %s", len(each.text), got, each.wanted)
		}
	}
}
