package brain_test

import (
	"errors"
	"fmt"
	"strings"
	"testing"

	"nmes/brain"
)

func Example() {
	document := `{"kind": "mlp", "inputs": ["*.position", "root.up.y"], "outputs": ["hip", "knee"],
	  "layers": [{"weights": [[0.5, -1], [1, 0.25]], "biases": [0, 0.1]}]}`
	controller, err := brain.Load([]byte(document), []string{"hip.position", "knee.position", "root.up.y"}, []string{"hip", "knee"})
	if err != nil {
		fmt.Println(err)
		return
	}
	controls := make([]float64, 2)
	controller.Reset(0, 1.0/60)
	controller.Step([]float64{0.5, 0.1, 1}, controls)
	fmt.Println(controls)
	// Output: [-0.6043677771171636 0.7397830512740042]
}

func ExampleError() {
	_, err := brain.Load([]byte(`{"kind": "sine", "oscillators": [{"motor": "hipp", "phase": 1000}]}`), nil, []string{"hip", "knee"})
	var refused *brain.Error
	if errors.As(err, &refused) {
		fmt.Println(refused.Problems[0].Path)
	}
	fmt.Println(err)
	_, err = brain.Load([]byte(`{"kind": "sine", "oscillators": [{"motor": "hipp"}]}`), nil, []string{"hip", "knee"})
	fmt.Println(err)
	// Output:
	// oscillators/0/phase
	// oscillators/0/phase: expected a number from -100 to 100 rad, got 1000
	// oscillators/0/motor: there is no motor "hipp"; there are hip, knee
}

func TestADocumentOfMillionsOfValuesIsRefusedUnread(t *testing.T) {
	const told = "more than 4,194,304 values"
	text := "no JSON" + strings.Repeat(",", 1<<22)
	if _, err := brain.Load([]byte(text), nil, nil); err == nil || err.Error() == told {
		t.Errorf("there may be so many: %v", err)
	}
	if _, err := brain.Load([]byte(text+","), nil, nil); err == nil || err.Error() != told {
		t.Error(err)
	}
}

func TestWhatAProgramMayNotDoPanics(t *testing.T) {
	load := func() *brain.Brain {
		controller, err := brain.Load([]byte(`{"kind": "sine", "oscillators": [{"motor": "*"}]}`), []string{"s"}, []string{"a", "b"})
		if err != nil {
			t.Fatal(err)
		}
		return controller
	}
	for what, act := range map[string]func(*brain.Brain){
		"a step before Reset":   func(b *brain.Brain) { b.Step([]float64{0}, []float64{0, 0}) },
		"too few sensors":       func(b *brain.Brain) { b.Reset(0, 0.1); b.Step(nil, []float64{0, 0}) },
		"too few controls":      func(b *brain.Brain) { b.Reset(0, 0.1); b.Step([]float64{0}, []float64{0}) },
		"a control step of 0 s": func(b *brain.Brain) { b.Reset(0, 0) },
	} {
		func() {
			defer func() {
				if recover() == nil {
					t.Error(what)
				}
			}()
			act(load())
		}()
	}
}
