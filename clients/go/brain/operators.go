package brain

import (
	"errors"
	"fmt"
	"maps"
	"math"
	"slices"
	"strings"

	"nmes/internal/elementary"
)

// operator applies one to tensors. What it does besides reading them once it adds to products, before it does it.
type operator func(arguments []*tensor, attributes map[string]attribute, products *int) (*tensor, error)

var add = elementwise(func(a, b float64) float64 { return a + b })

// operators are those that are known here, which is what feedforward policies are exported to.
var operators = map[string]operator{
	"Add": add,
	"Sub": elementwise(func(a, b float64) float64 { return a - b }),
	"Mul": elementwise(func(a, b float64) float64 { return float64(a * b) }),
	"Div": elementwise(func(a, b float64) float64 { return a / b }),
	"Max": elementwise(func(a, b float64) float64 { return max(a, b) }),
	"Min": elementwise(func(a, b float64) float64 { return min(a, b) }),

	"Tanh":     each(elementary.Tanh),
	"Sigmoid":  each(activations["sigmoid"]),
	"Sin":      each(elementary.Sin),
	"Cos":      each(elementary.Cos),
	"Relu":     each(func(x float64) float64 { return max(x, 0) }),
	"Abs":      each(math.Abs),
	"Neg":      each(func(x float64) float64 { return -x }),
	"Sqrt":     each(math.Sqrt),
	"Identity": each(func(x float64) float64 { return x }),
	"Dropout":  each(func(x float64) float64 { return x }), // it does nothing but in training

	"Constant": constant, "MatMul": matMul, "Gemm": gemm, "Clip": clip, "Elu": elu, "LeakyRelu": leakyRelu,
	"Reshape": reshape, "Flatten": flatten,
}

func operatorNames() string { return strings.Join(slices.Sorted(maps.Keys(operators)), ", ") }

var errArguments = errors.New("it has other arguments than are known here")

func each(function func(float64) float64) operator {
	return func(arguments []*tensor, _ map[string]attribute, _ *int) (*tensor, error) {
		if len(arguments) == 0 || arguments[0] == nil {
			return nil, errArguments
		}
		of := arguments[0]
		values := make([]float64, len(of.values))
		for i, value := range of.values {
			values[i] = function(value)
		}
		return rounded(of.kind, of.shape, values), nil
	}
}

// elementwise applies a function of two numbers to tensors, of which each axis is as long as the other's, or 1.
func elementwise(function func(a, b float64) float64) operator {
	return func(arguments []*tensor, _ map[string]attribute, products *int) (*tensor, error) {
		if len(arguments) != 2 || arguments[0] == nil || arguments[1] == nil {
			return nil, errArguments
		}
		a, b := arguments[0], arguments[1]
		shape := make([]int, max(len(a.shape), len(b.shape)))
		for i := range shape {
			x, y := axis(a.shape, i-len(shape)), axis(b.shape, i-len(shape))
			if shape[i] = max(x, y); x != y && min(x, y) != 1 {
				return nil, fmt.Errorf("shapes %v and %v do not go together", a.shape, b.shape)
			}
		}
		if size(shape) < 0 {
			return nil, errShape
		}
		if *products += size(shape) * max(1, len(shape)); *products > mostProducts {
			return nil, errLong
		}
		values := make([]float64, size(shape))
		for i := range values {
			values[i] = function(a.values[place(i, shape, a.shape)], b.values[place(i, shape, b.shape)])
		}
		return rounded(a.kind, shape, values), nil
	}
}

// axis returns the length of an axis, counted from the last, which is -1; 1 where there is none.
func axis(shape []int, at int) int {
	if at += len(shape); at >= 0 {
		return shape[at]
	}
	return 1
}

// place returns where in a tensor of a shape the value stands that belongs to the i-th of a larger one.
func place(i int, larger, shape []int) int {
	at, step := 0, 1
	for k := len(larger) - 1; k >= 0; k-- {
		length := axis(shape, k-len(larger))
		if length > 1 {
			at += i % larger[k] * step
		}
		step *= length
		i /= larger[k]
	}
	return at
}

func constant(_ []*tensor, attributes map[string]attribute, _ *int) (*tensor, error) {
	if value := attributes["value"].tensor; value != nil {
		return value, nil
	}
	if number, there := attributes["value_float"]; there {
		return &tensor{single, nil, []float64{number.number}}, nil
	}
	return nil, errArguments
}

// matMul multiplies a row, or rows, with a matrix.
func matMul(arguments []*tensor, _ map[string]attribute, products *int) (*tensor, error) {
	if len(arguments) != 2 || arguments[0] == nil || arguments[1] == nil || len(arguments[1].shape) != 2 || len(arguments[0].shape) == 0 {
		return nil, errArguments
	}
	a, b := arguments[0], arguments[1]
	inner, columns := b.shape[0], b.shape[1]
	if axis(a.shape, -1) != inner {
		return nil, fmt.Errorf("shapes %v and %v do not go together", a.shape, b.shape)
	}
	shape := append(slices.Clone(a.shape[:len(a.shape)-1]), columns)
	if size(shape) < 0 {
		return nil, errShape
	}
	if *products += size(shape) * inner; *products > mostProducts {
		return nil, errLong
	}
	values := make([]float64, size(shape))
	for row := range size(shape[:len(shape)-1]) {
		out := values[row*columns : (row+1)*columns]
		for k, x := range a.values[row*inner : (row+1)*inner] {
			for column, weight := range b.values[k*columns : (k+1)*columns] {
				out[column] += float64(x * weight)
			}
		}
	}
	return rounded(a.kind, shape, values), nil
}

// gemm is alpha A B + beta C, where A and B may be transposed.
func gemm(arguments []*tensor, attributes map[string]attribute, products *int) (*tensor, error) {
	if len(arguments) < 2 || arguments[0] == nil || arguments[1] == nil || len(arguments[0].shape) != 2 || len(arguments[1].shape) != 2 {
		return nil, errArguments
	}
	a, b := arguments[0], arguments[1]
	if attributes["transA"].integer != 0 {
		a = transposed(a)
	}
	if attributes["transB"].integer != 0 {
		b = transposed(b)
	}
	result, err := matMul([]*tensor{a, b}, nil, products)
	if err != nil {
		return nil, err
	}
	alpha, beta := factor(attributes, "alpha", 1), factor(attributes, "beta", 1)
	for i := range result.values {
		result.values[i] = float64(alpha * result.values[i])
	}
	if len(arguments) < 3 || arguments[2] == nil {
		return rounded(result.kind, result.shape, result.values), nil
	}
	c := &tensor{arguments[2].kind, arguments[2].shape, slices.Clone(arguments[2].values)}
	for i := range c.values {
		c.values[i] = float64(beta * c.values[i])
	}
	return add([]*tensor{result, c}, nil, products)
}

func transposed(t *tensor) *tensor {
	rows, columns := t.shape[0], t.shape[1]
	values := make([]float64, len(t.values))
	for i, value := range t.values {
		values[i%columns*rows+i/columns] = value
	}
	return &tensor{t.kind, []int{columns, rows}, values}
}

// factor returns an attribute that is a number, or what it is if left out.
func factor(attributes map[string]attribute, name string, otherwise float64) float64 {
	if number, there := attributes[name]; there {
		return number.number
	}
	return otherwise
}

func clip(arguments []*tensor, attributes map[string]attribute, products *int) (*tensor, error) {
	low, high := factor(attributes, "min", math.Inf(-1)), factor(attributes, "max", math.Inf(1))
	for i, bound := range []*float64{&low, &high} {
		if len(arguments) > i+1 && arguments[i+1] != nil {
			if len(arguments[i+1].values) != 1 {
				return nil, errArguments
			}
			*bound = arguments[i+1].values[0]
		}
	}
	return each(func(x float64) float64 { return within(low, high, x) })(arguments[:min(1, len(arguments))], nil, products)
}

func elu(arguments []*tensor, attributes map[string]attribute, products *int) (*tensor, error) {
	alpha := factor(attributes, "alpha", 1)
	return each(func(x float64) float64 {
		if x >= 0 {
			return x
		}
		return float64(alpha * math.Expm1(x))
	})(arguments, nil, products)
}

func leakyRelu(arguments []*tensor, attributes map[string]attribute, products *int) (*tensor, error) {
	alpha := float64(float32(factor(attributes, "alpha", 0.01)))
	return each(func(x float64) float64 {
		if x >= 0 {
			return x
		}
		return float64(alpha * x)
	})(arguments, nil, products)
}

func reshape(arguments []*tensor, _ map[string]attribute, _ *int) (*tensor, error) {
	if len(arguments) != 2 || arguments[0] == nil || arguments[1] == nil {
		return nil, errArguments
	}
	of := arguments[0]
	if len(arguments[1].values) > mostAxes {
		return nil, errShape
	}
	shape, open := []int{}, -1
	for i, each := range arguments[1].values {
		length := int(within(-1, mostValues+1, each))
		switch {
		case length == 0 && i < len(of.shape):
			length = of.shape[i]
		case length == -1:
			open, length = i, 1
		}
		shape = append(shape, length)
	}
	if open >= 0 && size(shape) > 0 {
		shape[open] = len(of.values) / size(shape)
	}
	if size(shape) != len(of.values) {
		return nil, fmt.Errorf("%d numbers are no shape %v", len(of.values), shape)
	}
	return &tensor{of.kind, shape, of.values}, nil
}

func flatten(arguments []*tensor, attributes map[string]attribute, _ *int) (*tensor, error) {
	if len(arguments) != 1 || arguments[0] == nil {
		return nil, errArguments
	}
	of, at := arguments[0], 1
	if given, there := attributes["axis"]; there {
		at = int(given.integer)
	}
	if at < 0 {
		at += len(of.shape)
	}
	if at < 0 || at > len(of.shape) {
		return nil, errArguments
	}
	return &tensor{of.kind, []int{size(of.shape[:at]), size(of.shape[at:])}, of.values}, nil
}
