package brain

// weigh writes the weighted sums of a row of numbers.
func weigh(weights [][]float64, row, sums []float64) {
	for i := range sums {
		sums[i] = product(weights[i], row)
	}
}

// weighByColumns is weigh for the matrix of what sensors are to the first layer, which the reference implementation has
// in memory column by column: then numpy adds one column after the other.
func weighByColumns(weights [][]float64, row, sums []float64) {
	for i := range sums {
		sums[i] = 0
		for j, weight := range weights[i] {
			sums[i] += float64(weight * row[j])
		}
	}
}

// product returns a sum of products, added up as numpy's einsum does with vectors of two: even and odd places apart,
// eight at a time, of which the last comes first.
func product(weights, row []float64) float64 {
	even, odd := 0.0, 0.0
	for len(weights) >= 8 {
		w, x := (*[8]float64)(weights), (*[8]float64)(row)
		even = float64(w[0]*x[0]) + (float64(w[2]*x[2]) + (float64(w[4]*x[4]) + (float64(w[6]*x[6]) + even)))
		odd = float64(w[1]*x[1]) + (float64(w[3]*x[3]) + (float64(w[5]*x[5]) + (float64(w[7]*x[7]) + odd)))
		weights, row = weights[8:], row[8:]
	}
	for len(weights) >= 2 {
		even += float64(weights[0] * row[0])
		odd += float64(weights[1] * row[1])
		weights, row = weights[2:], row[2:]
	}
	if len(weights) == 1 {
		even += float64(weights[0] * row[0])
	}
	return even + odd
}

// total returns a sum, added up as numpy's does: in pairs.
func total(values []float64) float64 {
	switch count := len(values); {
	case count < 8:
		sum := 0.0
		for _, value := range values {
			sum += value
		}
		return sum
	case count <= 128:
		s := *(*[8]float64)(values)
		at := 8
		for ; at+8 <= count; at += 8 {
			for i := range s {
				s[i] += values[at+i]
			}
		}
		sum := ((s[0] + s[1]) + (s[2] + s[3])) + ((s[4] + s[5]) + (s[6] + s[7]))
		for _, value := range values[at:] {
			sum += value
		}
		return sum
	default:
		half := count / 2
		half -= half % 8
		return total(values[:half]) + total(values[half:])
	}
}
