// Package elementary has sin, cos, exp and tanh with the bits that the reference implementation computes them with.
//
// That one asks the C library. What is done here, in which order and where it is rounded is what GNU's 2.36 does on
// processors of x86-64 that multiply and add at once: within 0.55 of the last place, tanh within 2. Go's own functions
// are as good, but round otherwise, and a network with a memory makes a metre of the last bit. Other versions, other
// libraries and processors of another kind may round otherwise too: there Python differs from itself.
//
// Whose work is followed, under which licences, and why no other source would do is in NOTICE, at the root of the module.
//
// FMA is written wherever that library fuses. Go may fuse more by itself, on arm64, ppc64, s390x and riscv64, and on
// amd64 from GOAMD64=v3: an explicit conversion, float64(a*b), keeps a product that is rounded rounded.
package elementary

import "math"

// Sin returns the sine of an angle, rad; NaN for what is not finite.
func Sin(x float64) float64 {
	switch size := math.Abs(x); {
	case upper(size) < 0x3e500000: // 2^-26
		return x
	case upper(size) < 0x3feb6000: // 0.855
		return sine(x, 0)
	case upper(size) < 0x400368fd: // 2.426
		return math.Copysign(cosine(halfPi-size, halfPiRest), x)
	default:
		quarters, angle, rest := reduced(x)
		return turned(quarters, angle, rest)
	}
}

// Cos returns the cosine of an angle, rad; NaN for what is not finite.
func Cos(x float64) float64 {
	switch size := math.Abs(x); {
	case upper(size) < 0x3e400000: // 2^-27
		return 1
	case upper(size) < 0x3feb6000:
		return cosine(x, 0)
	case upper(size) < 0x400368fd:
		angle := halfPi - size + halfPiRest
		return sine(angle, (halfPi-size-angle)+halfPiRest)
	default:
		quarters, angle, rest := reduced(x)
		return turned(quarters+1, angle, rest)
	}
}

// upper returns the upper half of a positive number's bits: where methods change is told by these.
func upper(size float64) uint64 { return math.Float64bits(size) >> 32 }

// sine returns the sine of an angle of at most 0.86 in two parts, by that of the multiple of 1/128 that is nearest.
func sine(angle, rest float64) float64 {
	if math.Abs(angle) < 0.126 {
		square := float64(angle * angle)
		sum := math.FMA(square, -2.5022014848318398e-08, 2.755729806860771e-06)
		sum = math.FMA(square, sum, -0.00019841269834414642)
		sum = math.FMA(square, sum, 0.008333333333332329)
		sum = math.FMA(square, sum, -0.16666666666666666)
		return angle + math.FMA(square, math.FMA(sum, angle, -float64(0.5*rest)), rest)
	}
	if angle <= 0 {
		rest = -rest
	}
	node, away := nearest(math.Abs(angle))
	square := float64(away * away)
	odd := away + math.FMA(float64(away*square), math.FMA(square, sine5, sine3), rest)
	even := math.FMA(away, rest, float64(square*math.FMA(square, math.FMA(square, cosine6, cosine4), 0.5)))
	more := math.FMA(odd, node.cos, math.FMA(-even, node.sin, math.FMA(odd, node.cosRest, node.sinRest)))
	return math.Copysign(node.sin+more, angle)
}

// cosine returns the cosine of such an angle.
func cosine(angle, rest float64) float64 {
	if angle < 0 {
		rest = -rest
	}
	node, away := nearest(math.Abs(angle))
	away += rest
	square := float64(away * away)
	odd := math.FMA(float64(away*square), math.FMA(square, sine5, sine3), away)
	even := float64(square * math.FMA(square, math.FMA(square, cosine6, cosine4), 0.5))
	more := math.FMA(-odd, node.sin, math.FMA(-even, node.cos, math.FMA(-odd, node.sinRest, node.cosRest)))
	return node.cos + more
}

// Of the sine and the cosine of less than 1/256.
const (
	sine3, sine5     = -0.16666666666666488, 0.008333332142857223
	cosine4, cosine6 = -0.04166666666666644, 0.001388888740079376
)

// nearest returns the node that is nearest to a positive angle, and how far the angle is from there.
func nearest(size float64) (*node, float64) {
	sum := size + 0x1.8p45 // the last bit of which is 1/128
	return &nodes[math.Float64bits(sum)&127], size - (sum - 0x1.8p45)
}

// turned returns the sine of an angle and so many quarters of a turn.
func turned(quarters uint64, angle, rest float64) float64 {
	value := 0.0
	if quarters&1 == 0 {
		value = sine(angle, rest)
	} else {
		value = cosine(angle, rest)
	}
	if quarters&2 == 0 {
		return value
	}
	return -value
}

// reduced returns an angle as quarters of a turn and what is left of it, in two parts (W. Cody and W. Waite, 1980).
func reduced(x float64) (quarters uint64, angle, rest float64) {
	if !(math.Abs(x) < 105414350) {
		return reducedFar(x)
	}
	sum := math.FMA(x, 0.6366197723675814, 0x1.8p52)
	count := sum - 0x1.8p52
	left := math.FMA(-count, quarter[1], math.FMA(-count, quarter[0], x))
	near := math.FMA(-count, quarter[2], left)
	rest = math.FMA(-count, quarter[2], left-near)
	angle = math.FMA(-count, quarter[3], near)
	rest += math.FMA(-count, quarter[3], near-angle)
	return math.Float64bits(sum), angle, rest
}

// Half of pi as a sum of two numbers, and of four of which the first three are short.
const halfPi, halfPiRest = 0x1.921fb54442d18p0, 0x1.1a62633145c07p-54

var quarter = [4]float64{0x1.921fb58p0, -0x1.dde973cp-27, -0x1.cb3b398p-55, -0x1.d747f23e32ed7p-83}

// Exp returns e to the power of x, which is at most 512: 2^(k/128), by a table, times e to what is left.
func Exp(x float64) float64 {
	switch size := math.Abs(x); {
	case size < 0x1p-54:
		return 1 + x
	case x < -1075: // -Inf too
		return 0
	case math.IsNaN(x):
		return x
	}
	sum := math.FMA(x, 0x1.71547652b82fep7, 0x1.8p52)
	count := sum - 0x1.8p52
	left := math.FMA(count, -0x1.cf79abc9e3b3ap-47, math.FMA(count, -0x1.62e42fefa0000p-8, x))
	power := &powers[math.Float64bits(sum)&127]
	square := float64(left * left)
	more := math.FMA(math.FMA(left, 0x1.555555555543cp-3, 0x1.ffffffffffdbdp-2), square, left+power.rest)
	more = math.FMA(float64(square*square), math.FMA(left, 0x1.1111167a4d017p-7, 0x1.55555cf172b91p-5), more)
	exponent := (math.Float64bits(sum) &^ 127) << 45 // a negative one wraps around
	if math.Abs(x) < 512 {
		scale := math.Float64frombits(math.Float64bits(power.value) + exponent)
		return math.FMA(scale, more, scale)
	}
	return small(math.Float64frombits(math.Float64bits(power.value)+exponent+1022<<52), more)
}

// small returns scale (1 + more) / 2^1022, which may be too small for 53 bits: it is rounded once, to what there are.
func small(scale, more float64) float64 {
	more = float64(scale * more)
	value := scale + more
	if value < 1 {
		lost := scale - value + more
		sum := 1 + value
		lost = 1 - sum + value + lost
		value = sum + lost - 1
	}
	return float64(0x1p-1022 * value)
}

// Tanh returns the hyperbolic tangent.
func Tanh(x float64) float64 {
	size := math.Abs(x)
	switch {
	case size < 0x1p-55:
		return float64(x * (1 + x))
	case size < 1:
		less := lessOne(-float64(2 * size))
		return math.Copysign(-less/(less+2), x)
	case size < 22:
		return math.Copysign(1-2/(lessOne(float64(2*size))+2), x)
	case math.IsNaN(x):
		return x
	}
	return math.Copysign(1, x)
}

// lessOne returns e to the power of x less 1, for an x from -2 to -2^-54 or from 2 to 44: no others come from Tanh.
//
// The method is that of FDLIBM (K. C. Ng, 1993): with x = k ln 2 + r, by a rational function of r.
func lessOne(x float64) float64 {
	k, lost := 0, 0.0
	if size := upper(math.Abs(x)); size > 0x3fd62e42 { // ln 2 / 2
		high, low := x+0x1.62e42feep-1, -0x1.a39ef35793c76p-33
		k = -1
		if size >= 0x3ff0a2b2 { // 1.5 ln 2
			k = int(float64(0x1.71547652b82fep0*x) + math.Copysign(0.5, x))
			high, low = math.FMA(-float64(k), 0x1.62e42feep-1, x), float64(float64(k)*0x1.a39ef35793c76p-33)
		}
		x = high - low
		lost = (high - x) - low
	}
	half := float64(0.5 * x)
	square := float64(x * half)
	fourth := float64(square * square)
	sum := math.FMA(fourth, math.FMA(square, -0x1.4ce199eaadbb7p-14, 0x1.a01a019fe5585p-10), math.FMA(square, -0x1.11111111110f4p-5, 1))
	sum = math.FMA(float64(fourth*fourth), math.FMA(square, -0x1.afdb76e09c32dp-23, 0x1.0cfca86e65239p-18), sum)
	by := math.FMA(-sum, half, 3)
	e := float64((sum - by) / math.FMA(-x, by, 6) * square)
	if k == 0 {
		return x - math.FMA(e, x, -square)
	}
	e = math.FMA(e-lost, x, -lost) - square
	switch {
	case k == -1:
		return float64(0.5*(x-e)) - 0.5
	case k < 0 || k > 56:
		return scaled(1-(e-x), k) - 1
	case k < 20:
		return scaled((1-scaled(1, -k))-(e-x), k)
	}
	return scaled(x-(e+scaled(1, -k))+1, k)
}

// scaled returns x 2^k, neither of which leaves the exponents that there are.
func scaled(x float64, k int) float64 {
	return math.Float64frombits(math.Float64bits(x) + uint64(k)<<52)
}
