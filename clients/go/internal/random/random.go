// Package random draws what numpy's Generator(PCG64(seed)) draws: the same numbers, in the same order, from the same seed.
//
// It has the draws that the variation of genomes is made of: doubles, whole numbers, normal ones. PCG64 is that of
// M. O'Neill (2014), seeded as numpy's SeedSequence does; whole numbers are drawn as D. Lemire (2019) says, and normal
// ones by the ziggurat of G. Marsaglia and W. W. Tsang (2000), by numpy's tables.
package random

import (
	"math"
	"math/big"
	"math/bits"

	"nmes/internal/elementary"
)

// Generator is a stream of numbers. It is for one goroutine.
type Generator struct {
	high, low         uint64 // the state, 128 bits
	stepHigh, stepLow uint64 // what is added at each step, odd
	spare             uint32 // the upper half of a number of which only the lower was used
	spared            bool
}

const (
	multiplierHigh = 2549297995355413924
	multiplierLow  = 4865540595714422341
)

// New returns the generator of a seed, a whole number that is not negative, of any size.
func New(seed *big.Int) *Generator {
	words := spread(seed)
	g := &Generator{stepHigh: words[2]<<1 | words[3]>>63, stepLow: words[3]<<1 | 1}
	g.step()
	var carry uint64
	g.low, carry = bits.Add64(g.low, words[1], 0)
	g.high, _ = bits.Add64(g.high, words[0], carry)
	g.step()
	return g
}

func (g *Generator) step() {
	high, low := bits.Mul64(g.low, multiplierLow)
	high += g.high*multiplierLow + g.low*multiplierHigh
	var carry uint64
	g.low, carry = bits.Add64(low, g.stepLow, 0)
	g.high, _ = bits.Add64(high, g.stepHigh, carry)
}

// Uint64 returns 64 bits.
func (g *Generator) Uint64() uint64 {
	g.step()
	return bits.RotateLeft64(g.high^g.low, -int(g.high>>58))
}

// uint32 returns 32 bits: the lower half of 64, then the upper one, whatever else is drawn in between.
func (g *Generator) uint32() uint32 {
	if g.spared {
		g.spared = false
		return g.spare
	}
	whole := g.Uint64()
	g.spare, g.spared = uint32(whole>>32), true
	return uint32(whole)
}

// Float64 returns a number from 0 to below 1.
func (g *Generator) Float64() float64 { return float64(g.Uint64()>>11) / (1 << 53) }

// Count returns a whole number from low to high, both included. They are less than 2^32 - 1 apart.
func (g *Generator) Count(low, high int) int {
	if low == high {
		return low
	}
	span := uint64(high-low) + 1
	product := uint64(g.uint32()) * span
	if uint64(uint32(product)) < span {
		least := (1<<32 - span) % span
		for uint64(uint32(product)) < least {
			product = uint64(g.uint32()) * span
		}
	}
	return low + int(product>>32)
}

const (
	tail        = 3.6541528853610087963519472518 // where the lowest layer of the ziggurat ends
	tailInverse = 0.27366123732975827203338247596
)

// Normal returns a normally distributed number with mean 0 and standard deviation 1.
func (g *Generator) Normal() float64 {
	for {
		whole := g.Uint64()
		layer := whole & 0xff
		negative := whole>>8&1 == 1
		place := whole >> 9 & 0x000fffffffffffff
		x := float64(float64(place) * math.Float64frombits(widths[layer]))
		if negative {
			x = -x
		}
		if place < inside[layer] {
			return x
		}
		if layer == 0 {
			return g.beyond(place>>8&1 == 1)
		}
		above, here := math.Float64frombits(heights[layer-1]), math.Float64frombits(heights[layer])
		if float64((above-here)*g.Float64())+here < elementary.Exp(float64(float64(-0.5*x)*x)) {
			return x
		}
	}
}

func (g *Generator) beyond(negative bool) float64 {
	for {
		x := -float64(tailInverse * math.Log1p(-g.Float64()))
		y := -math.Log1p(-g.Float64())
		if y+y > float64(x*x) {
			if negative {
				return -(tail + x)
			}
			return tail + x
		}
	}
}

// spread returns the 256 bits that numpy's SeedSequence makes of a seed.
func spread(seed *big.Int) [4]uint64 {
	const (
		initial, factor   = 0x43b0d7e5, 0x931e8875
		initial2, factor2 = 0x8b51f9dd, 0x58f38ded
		left, right       = 0xca01f9dd, 0x4973f715
	)
	hashing := uint32(initial)
	hashed := func(value uint32) uint32 {
		value ^= hashing
		hashing *= factor
		value *= hashing
		return value ^ value>>16
	}
	mixed := func(x, y uint32) uint32 {
		result := x*left - y*right
		return result ^ result>>16
	}
	var words []uint32
	for rest := new(big.Int).Set(seed); rest.Sign() > 0; rest.Rsh(rest, 32) {
		words = append(words, uint32(new(big.Int).And(rest, big.NewInt(math.MaxUint32)).Uint64()))
	}
	var pool [4]uint32
	for i := range pool {
		word := uint32(0)
		if i < len(words) {
			word = words[i]
		}
		pool[i] = hashed(word)
	}
	for from := range pool {
		for to := range pool {
			if from != to {
				pool[to] = mixed(pool[to], hashed(pool[from]))
			}
		}
	}
	for i := len(pool); i < len(words); i++ {
		for to := range pool {
			pool[to] = mixed(pool[to], hashed(words[i]))
		}
	}
	hashing = initial2
	var result [4]uint64
	for i := range 2 * len(result) {
		value := pool[i%len(pool)] ^ hashing
		hashing *= factor2
		value *= hashing
		value ^= value >> 16
		result[i/2] |= uint64(value) << (32 * (i % 2))
	}
	return result
}
