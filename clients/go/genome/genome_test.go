package genome_test

import (
	"encoding/json"
	"errors"
	"fmt"
	"strings"
	"sync"
	"testing"

	"nmes/genome"
)

// hopper is the worked example of docs/genomes.md.
const hopper = `{"format": "nmes-genome/1", "name": "hopper", "body": {"cubes": [
	{"id": "torso", "size": [0.4, 0.2, 0.3], "mass": 3, "position": [0, 0.5, 0]},
	{"id": "foot", "size": [0.3, 0.1, 0.3], "mass": 1, "position": [0, 0.05, 0]}], "joints": [
	{"id": "leg", "cube1": "torso", "cube2": "foot", "type": "slide", "anchor": [0, 0.2, 0], "axis": [0, 1, 0],
	 "limits": [-0.2, 0.2], "motor": {"mode": "position", "range": [-0.2, 0.2], "max_effort": 200}}]},
	"brain": {"kind": "sine", "oscillators": [{"motor": "leg", "amplitude": 1, "frequency": 1.5}]}}`

// What nmes itself says of it, and of its descendant after forty mutations.
const (
	hopperHash     = "0e30ffe70558912e084f115e1dcc47b20399561b0bf244860df0637d0251f693"
	descendantHash = "7d21adc69ef4e05114e9219363f1f55566e229cc255f51bfacf833a2f08f0654"
)

func parsed(t testing.TB, text string) *genome.Genome {
	t.Helper()
	read, err := genome.Parse([]byte(text))
	if err != nil {
		t.Fatal(err)
	}
	return read
}

func Example() {
	parent, err := genome.Parse([]byte(hopper))
	if err != nil {
		fmt.Println(err)
		return
	}
	child, err := genome.Mutate(parent, genome.NewDraw(7, "genome", 0), "", genome.Requirements{})
	if err != nil {
		fmt.Println(err)
		return
	}
	fmt.Println(child.Kind, child.Genome.Hash)
	// Output: resize-part 9e69b8c7055c1eea2347eabf7977cc936432aea13dfe2818267ba8c1f87b44a9
}

func ExampleCheck() {
	wrong := strings.Replace(strings.Replace(hopper, `"cube2": "foot"`, `"cube2": "fot"`, 1), `"mass": 3`, `"mass": -3`, 1)
	for _, problem := range genome.Check([]byte(wrong)) {
		fmt.Println(problem.Path, problem.Message)
	}
	// Output:
	// body/cubes/0/mass expected a number from 0.001 to 10,000 kg, got -3
	// body/joints/0/cube2 there is no cube 'fot'; did you mean foot?
}

func TestTheHashIsThatOfTheCreature(t *testing.T) {
	if hash := parsed(t, hopper).Hash; hash != hopperHash {
		t.Error(hash)
	}
	same := strings.NewReplacer(`"mass": 3`, `"mass": 3.0`, " ", "").Replace(hopper)
	if hash := parsed(t, same).Hash; hash != hopperHash {
		t.Error(hash)
	}
	if hash := parsed(t, strings.Replace(hopper, `"mass": 3`, `"mass": 3.0000001`, 1)).Hash; hash == hopperHash {
		t.Error("another creature has the same hash")
	}
}

func TestFortyMutationsLeadWhereTheyLeadInPython(t *testing.T) {
	creature := parsed(t, hopper)
	for number := range 40 {
		mutant, err := genome.Mutate(creature, genome.NewDraw(7, "genome", number), "", genome.Requirements{})
		if err != nil {
			t.Fatal(err)
		}
		if parents := mutant.Genome.Document()["parents"].([]any); parents[0] != creature.Hash {
			t.Errorf("the parent is %s, not %s", parents, creature.Hash)
		}
		creature = mutant.Genome
	}
	if creature.Hash != descendantHash {
		t.Error(creature.Hash)
	}
}

func TestManyGoroutinesMayMutateTheSameParent(t *testing.T) {
	parent := parsed(t, hopper)
	hashes := make([]string, 64)
	var all sync.WaitGroup
	for i := range hashes {
		all.Add(1)
		go func() {
			defer all.Done()
			mutant, err := genome.Mutate(parent, genome.NewDraw(int64(i%8), "genome", 0), "", genome.Requirements{})
			if err != nil {
				t.Error(err)
				return
			}
			hashes[i] = mutant.Genome.Hash
		}()
	}
	all.Wait()
	for i, hash := range hashes {
		if hash != hashes[i%8] {
			t.Errorf("seed %d has two mutants", i%8)
		}
	}
	if again := parsed(t, hopper); again.Hash != parent.Hash {
		t.Error("the parent has changed")
	}
}

func TestADocumentIsACopy(t *testing.T) {
	creature := parsed(t, hopper)
	document := creature.Document()
	document["body"].(map[string]any)["cubes"].([]any)[0].(map[string]any)["mass"] = 9.0
	if text, err := json.Marshal(creature); err != nil || strings.Contains(string(text), "9.0") {
		t.Error(string(text), err)
	}
	heavier, err := genome.New(document)
	if err != nil || heavier.Body.Mass() != 10 {
		t.Error(heavier, err)
	}
	text, err := json.Marshal(heavier)
	if err != nil || parsed(t, string(text)).Hash != heavier.Hash {
		t.Error(string(text), err)
	}
}

func TestAGraphGrows(t *testing.T) {
	chain := parsed(t, `{"format": "nmes-genome/1", "name": "chain", "body": {"graph": {"root": "link",
		"parts": [{"id": "link", "size": 0.2, "recursive_limit": 4}],
		"connections": [{"from": "link", "to": "link", "face": "+x"}]}}}`)
	if cubes := chain.Body.Cubes; len(cubes) != 4 || cubes[3].ID != "link.4" {
		t.Error(cubes)
	}
	expanded, err := chain.Expanded()
	if err != nil || len(expanded.Body.Joints) != 3 || expanded.Hash == chain.Hash {
		t.Error(expanded, err)
	}
	endless := `{"format": "nmes-genome/1", "name": "x", "body": {"graph": {"root": "a",
		"parts": [{"id": "a", "size": 0.2, "recursive_limit": 64}], "connections": [
		{"from": "a", "to": "a", "face": "+x"}, {"from": "a", "to": "a", "face": "+y"}, {"from": "a", "to": "a", "face": "+z"}]}}}`
	if problems := genome.Check([]byte(endless)); len(problems) != 1 || !strings.Contains(problems[0].Message, "more than 256 cubes") {
		t.Error(problems)
	}
}

func TestWhatStrangersSendIsBounded(t *testing.T) {
	for name, text := range map[string]string{
		"too deep":        strings.Repeat("[", 100_000) + strings.Repeat("]", 100_000),
		"deep":            strings.Repeat("[", 201) + strings.Repeat("]", 201),
		"many arrays":     "[" + strings.Repeat("[],", 70_000) + "[]]",
		"not JSON":        "{'name': 1}",
		"a key twice":     `{"name": 1, "name": 2}`,
		"infinite":        "1e400",
		"half a pair":     `"\ud800x"`,
		"not UTF-8":       "\"\xff\"",
		"cut off":         hopper[:200],
		"something else":  "[1, 2, 3]",
		"thousands wrong": `{"sensors": [` + strings.Repeat(`{"type": 1}, `, 1000) + `{}]}`,
		"many fields":     `{"x1": 0` + manyFields(5000) + `}`,
	} {
		problems := genome.Check([]byte(text))
		if len(problems) == 0 || len(problems) > 42 {
			t.Errorf("%s: %d problems", name, len(problems))
		}
		_, err := genome.Parse([]byte(text))
		var wrong *genome.DocumentError
		if !errors.As(err, &wrong) || len(err.Error()) > 20_000 {
			t.Errorf("%s: %v", name, err)
		}
	}
}

func manyFields(count int) string {
	var text strings.Builder
	for i := range count {
		fmt.Fprintf(&text, `, "field%d": %d`, i, i)
	}
	return text.String()
}

func TestWhatCannotBeMutatedIsAnErrorThatSaysWhy(t *testing.T) {
	creature := parsed(t, hopper)
	model := strings.Replace(hopper, `{"kind": "sine", "oscillators": [{"motor": "leg", "amplitude": 1, "frequency": 1.5}]}`,
		`{"kind": "onnx", "model": ""}`, 1)
	for _, each := range []struct {
		parent     *genome.Genome
		kind, code string
		words      string
	}{
		{creature, "wieghts", "unknown_mutation", "did you mean weights?"},
		{creature, "recursion", "no_offspring", "nothing of that kind to change"},
		{parsed(t, model), "", "unsupported", "ONNX"},
	} {
		_, err := genome.Mutate(each.parent, genome.NewDraw(0), each.kind, genome.Requirements{})
		var refused *genome.VariationError
		if !errors.As(err, &refused) || refused.Code != each.code || !strings.Contains(refused.Message, each.words) {
			t.Errorf("%s: %v", each.kind, err)
		}
	}
	light := 0.1
	_, err := genome.Mutate(creature, genome.NewDraw(0), "", genome.Requirements{Limits: genome.Limits{Mass: &light}})
	if err == nil || !strings.Contains(err.Error(), "at most 0.1 are allowed") {
		t.Error(err)
	}
}

func BenchmarkMutate(b *testing.B) {
	creature := parsed(b, hopper)
	for i := 0; b.Loop(); i++ {
		if _, err := genome.Mutate(creature, genome.NewDraw(int64(i)), "", genome.Requirements{}); err != nil {
			b.Fatal(err)
		}
	}
}
