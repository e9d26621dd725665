package random

import (
	"crypto/sha256"
	"encoding/binary"
	"encoding/hex"
	"math/big"
	"slices"
	"testing"
)

// What is drawn here is what numpy 2.4 draws by Generator(PCG64(seed)): random(), integers(low, high + 1) and
// standard_normal(), in turn.

func of(t *testing.T, seed string) *Generator {
	t.Helper()
	number, good := new(big.Int).SetString(seed, 10)
	if !good {
		t.Fatal(seed)
	}
	return New(number)
}

func TestDoublesAreThoseOfNumpy(t *testing.T) {
	for seed, wanted := range map[string][]float64{
		"0":                              {0.6369616873214543, 0.2697867137638703, 0.04097352393619469, 0.016527635528529094},
		"1":                              {0.5118216247002567, 0.9504636963259353, 0.14415961271963373, 0.9486494471372439},
		"4294967295":                     {0.2519435680449965, 0.21906579628685663, 0.28728472043517017, 0.6189813025326831},
		"18446744073709563961":           {0.9798065138848988, 0.23274412229227692, 0.43870622989734964, 0.7762193657568877},
		"123456789012345678901234567890": {0.34543790416273246, 0.33578336166567657, 0.15099490459335874, 0.9170506721453346},
		"1461501637330902918203684832716283019655932542983": {0.872908525547428, 0.3242371290640921, 0.10916288915244698, 0.05923228527230873},
	} {
		g := of(t, seed)
		for i, value := range wanted {
			if got := g.Float64(); got != value {
				t.Errorf("seed %s: number %d is %v, not %v", seed, i, got, value)
			}
		}
	}
}

// TestWholeNumbersAreThoseOfNumpy also draws others in between: half of the bits of a number wait for the next.
func TestWholeNumbersAreThoseOfNumpy(t *testing.T) {
	g := of(t, "20261123")
	var got []int
	for i := range 12 {
		got = append(got, g.Count(0, i), g.Count(-3, 1<<31+i))
		if i%3 == 0 {
			g.Float64()
		}
	}
	wanted := []int{
		0, 94706336, 1, 1119615152, 1, 1571307031, 3, 1108481045,
		0, 168001065, 0, 905933080, 0, 1937629666, 7, 1763723540,
		5, 1997772677, 9, 1348185625, 10, 184414202, 1, 1039692016,
	}
	if !slices.Equal(got, wanted) {
		t.Errorf("%v, not %v", got, wanted)
	}
}

// TestTwoHundredThousandNormalNumbersAreThoseOfNumpy reaches all ways through the ziggurat, its tail some 50 times.
func TestTwoHundredThousandNormalNumbersAreThoseOfNumpy(t *testing.T) {
	const wanted = "00cd22ce9d60ed2b68bb6b3434c9091878ce1257b2e545833ed230429ba72165"
	g, sum, beyond := of(t, "98765432109876543210"), sha256.New(), 0
	for range 200_000 {
		value := g.Normal()
		if value > tail || value < -tail {
			beyond++
		}
		_ = binary.Write(sum, binary.LittleEndian, value)
	}
	if got := hex.EncodeToString(sum.Sum(nil)); got != wanted || beyond < 20 {
		t.Errorf("the digest is %s, with %d of the tail", got, beyond)
	}
}
