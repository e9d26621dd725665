package elementary

import (
	"math"
	"math/big"
	"sync"
)

// The tables are computed when the program begins, in a tenth of a millisecond, with digits to spare.
const precision = 320

// node has the sine and the cosine of a multiple of 1/128, each as a sum of two numbers.
type node struct{ sin, sinRest, cos, cosRest float64 }

// nodes are those from 0 to 109/128; no angle that is looked up is larger.
var nodes = func() (table [128]node) {
	sine, cosine := new(big.Float).SetPrec(precision), exact(1)
	first := exact(1.0 / 128)
	stepSine, stepCosine := series(first, 1), series(first, 0)
	for i := range 110 {
		entry := &table[i]
		entry.sin, entry.sinRest = parts(sine)
		entry.cos, entry.cosRest = parts(cosine)
		sine, cosine = plus(times(sine, stepCosine), times(cosine, stepSine)), minus(times(cosine, stepCosine), times(sine, stepSine))
	}
	return table
}()

// power is 2^(k/128) as value (1 + rest).
type power struct{ value, rest float64 }

// powers are those from k = 0. What is kept of each is less k/128 in the exponent, which is added with the rest of it.
var powers = func() (table [128]power) {
	root := exact(2)
	for range 7 {
		root = new(big.Float).SetPrec(precision).Sqrt(root)
	}
	value := exact(1)
	for i := range table {
		rounded, _ := value.Float64()
		rest, _ := minus(new(big.Float).SetPrec(precision).Quo(value, exact(rounded)), exact(1)).Float64()
		table[i] = power{rounded, rest}
		value = times(value, root)
	}
	return table
}()

func exact(x float64) *big.Float { return new(big.Float).SetPrec(precision).SetFloat64(x) }

func plus(x, y *big.Float) *big.Float  { return new(big.Float).SetPrec(precision).Add(x, y) }
func minus(x, y *big.Float) *big.Float { return new(big.Float).SetPrec(precision).Sub(x, y) }
func times(x, y *big.Float) *big.Float { return new(big.Float).SetPrec(precision).Mul(x, y) }

// series returns the sum of x^n / n! with alternating signs, over the odd n or the even ones.
func series(x *big.Float, from int64) *big.Float {
	term := exact(1)
	if from == 1 {
		term = x
	}
	sum := exact(0)
	for n := from; n < from+50; n += 2 {
		sum = plus(sum, term)
		divisor := exact(float64((n + 1) * (n + 2)))
		term = new(big.Float).SetPrec(precision).Quo(times(times(term, x), x), divisor)
		term.Neg(term)
	}
	return sum
}

// parts returns a number as the nearest one, and the nearest to what that lacks.
func parts(x *big.Float) (value, rest float64) {
	value, _ = x.Float64()
	rest, _ = minus(x, exact(value)).Float64()
	return value, rest
}

// far has room for the quarters of the largest number, for their fraction, and for where that is nearly nothing.
const far = 1400

// exactHalfPi is by J. Machin's formula: pi / 4 = 4 arctan 1/5 - arctan 1/239.
var exactHalfPi = sync.OnceValue(func() *big.Float {
	arctan := func(inverse int64) *big.Int {
		term := new(big.Int).Lsh(big.NewInt(1), far)
		term.Quo(term, big.NewInt(inverse))
		sum := new(big.Int)
		for n := int64(1); term.Sign() != 0; n += 2 {
			sum.Add(sum, new(big.Int).Quo(term, big.NewInt(n)))
			term.Quo(term, big.NewInt(-inverse*inverse))
		}
		return sum
	}
	sum := new(big.Int).Lsh(arctan(5), 2)
	sum.Sub(sum, arctan(239)).Lsh(sum, 1)
	value := new(big.Float).SetPrec(far).SetInt(sum)
	return value.SetMantExp(value, -far)
})

// reducedFar is reduced for large angles, exactly: it takes some microseconds.
func reducedFar(x float64) (quarters uint64, angle, rest float64) {
	if math.IsInf(x, 0) || math.IsNaN(x) {
		return 0, math.NaN(), math.NaN()
	}
	whole := new(big.Float).SetPrec(far).SetFloat64(x)
	count := new(big.Float).SetPrec(far).Quo(whole, exactHalfPi())
	count.Add(count, big.NewFloat(math.Copysign(0.5, x)))
	turns, _ := count.Int(nil)
	count.SetInt(turns)
	left := whole.Sub(whole, count.Mul(count, exactHalfPi()))
	angle, _ = left.Float64()
	rest, _ = left.Sub(left, big.NewFloat(angle)).Float64()
	return turns.And(turns, big.NewInt(3)).Uint64(), angle, rest
}
