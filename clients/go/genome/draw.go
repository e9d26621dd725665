package genome

import (
	"math"
	"math/big"
	"slices"
	"strconv"

	"nmes/internal/blake2b"
	"nmes/internal/elementary"
	"nmes/internal/random"
)

// Draw is a stream of random choices that follow from a seed and a path of names, and from nothing else. Two draws with
// another seed or another path have nothing to do with each other. It is for one goroutine.
type Draw struct{ numbers *random.Generator }

// NewDraw returns the choices of a seed, for what its path says: strings and whole numbers, as "genome", 0. Those of
// `nmes genome mutate --seed 7` are NewDraw(7, "genome", 0), NewDraw(7, "genome", 1) and so on.
func NewDraw(seed int64, path ...any) *Draw {
	names := array{strconv.FormatInt(seed, 10)}
	for _, part := range path {
		if index, isInt := part.(int); isInt {
			part = int64(index)
		}
		names = append(names, part)
	}
	entropy := blake2b.Sum(write(names), 16)
	slices.Reverse(entropy) // they are the digits of a number, the least first
	return &Draw{random.New(new(big.Int).SetBytes(entropy))}
}

// Chance returns true in this part of the cases, from 0 to 1.
func (d *Draw) Chance(part float64) bool { return d.numbers.Float64() < part }

// Uniform returns a number between the two, all alike.
func (d *Draw) Uniform(low, high float64) float64 {
	return low + float64((high-low)*d.numbers.Float64())
}

// Count returns a whole number from low to high, both included.
func (d *Draw) Count(low, high int) int { return d.numbers.Count(low, high) }

// Normal returns a normally distributed number with mean 0 and this standard deviation.
func (d *Draw) Normal(spread float64) float64 { return float64(spread * d.numbers.Normal()) }

// Factor returns a positive factor whose logarithm has this standard deviation: x and 1 / x are as likely.
func (d *Draw) Factor(spread float64) float64 { return elementary.Exp(d.Normal(spread)) }

// oneOf returns one of some values, all alike; weighted by weights that need not sum to 1.
func oneOf[T any](d *Draw, values []T) T { return values[d.Count(0, len(values)-1)] }

func weighted[T any](d *Draw, values []T, weights []float64) T {
	total := 0.0
	for _, weight := range weights {
		total += weight
	}
	place := d.Uniform(0, total)
	for i, value := range values {
		if place -= weights[i]; place < 0 {
			return value
		}
	}
	return values[len(values)-1]
}

// direction returns a vector of length 1: one of the three axes mostly, else any.
func (d *Draw) direction() Vector {
	var vector Vector
	if d.Chance(0.75) {
		vector[d.Count(0, 2)] = 1
		return vector
	}
	for {
		for k := range vector {
			vector[k] = d.Uniform(-1, 1)
		}
		if square := dot(vector, vector); 0.01 < square && square <= 1 {
			for k := range vector {
				vector[k] = rounded(vector[k]/math.Sqrt(square), 6)
			}
			return vector
		}
	}
}
