package brain

import (
	"encoding/binary"
	"errors"
	"fmt"
	"math"

	"nmes/internal/documents"
)

// What a model's file may be.
const (
	mostFields = 200_000 // of all messages; a model has some for each node and tensor
	mostValues = 1 << 24 // of all tensors together
	mostAxes   = 8       // of a tensor
)

var (
	errCut   = errors.New("a field is longer than what holds it")
	errShape = fmt.Errorf("a tensor may have %d axes, none of them of 0, and %d numbers in all", mostAxes, mostValues)
)

// protoField is a field of a message of Protobuf: a whole number, or bytes.
type protoField struct {
	number int
	wire   int
	value  uint64
	bytes  []byte
}

// protoReader reads messages, of which all together have a bounded number of fields.
type protoReader struct{ fields, values int }

// message calls take with each field of a message.
func (r *protoReader) message(data []byte, take func(protoField) error) error {
	for len(data) > 0 {
		if r.fields++; r.fields > mostFields {
			return fmt.Errorf("it has more than %d fields", mostFields)
		}
		key, n := binary.Uvarint(data)
		if n <= 0 {
			return errors.New("a number has no end")
		}
		if data = data[n:]; key > math.MaxUint32 {
			return fmt.Errorf("there is no field %d", key>>3)
		}
		field := protoField{number: int(key >> 3), wire: int(key & 7)}
		size := uint64(0)
		switch field.wire {
		case 0, 2:
			value, n := binary.Uvarint(data)
			if n <= 0 {
				return errors.New("a number has no end")
			}
			data, field.value = data[n:], value
			if field.wire == 2 {
				size = value
			}
		case 1:
			size = 8
		case 5:
			size = 4
		default:
			return fmt.Errorf("there is no wire type %d", field.wire)
		}
		if size > uint64(len(data)) {
			return errCut
		}
		field.bytes, data = data[:size], data[size:]
		if err := take(field); err != nil {
			return err
		}
	}
	return nil
}

// integers returns the whole numbers of a repeated field, packed or not.
func (f protoField) integers() ([]int64, error) {
	if f.wire == 0 {
		return []int64{int64(f.value)}, nil
	}
	var result []int64
	for data := f.bytes; len(data) > 0; {
		value, n := binary.Uvarint(data)
		if n <= 0 {
			return nil, errors.New("a number has no end")
		}
		result, data = append(result, int64(value)), data[n:]
	}
	return result, nil
}

// numbers returns the numbers of so many bytes each, of a repeated field, packed or not.
func (f protoField) numbers(size int) ([]float64, error) {
	if len(f.bytes)%size != 0 {
		return nil, errCut
	}
	result := make([]float64, 0, len(f.bytes)/size)
	for data := f.bytes; len(data) > 0; data = data[size:] {
		if size == 4 {
			result = append(result, float64(math.Float32frombits(binary.LittleEndian.Uint32(data))))
		} else {
			result = append(result, math.Float64frombits(binary.LittleEndian.Uint64(data)))
		}
	}
	return result, nil
}

// Types of the elements of tensors.
const (
	single  = 1
	integer = 7
	double  = 11
)

// tensor is an array of numbers with a shape; singles and whole numbers are kept as doubles.
type tensor struct {
	kind   int
	shape  []int
	values []float64
}

// size returns how many values a shape has; -1 for one that a tensor may not have. Axes of 0 are among these: of
// what has no values there could be any number of rows, at no cost that is counted.
func size(shape []int) int {
	if len(shape) > mostAxes {
		return -1
	}
	count := 1
	for _, each := range shape {
		if each < 1 || each > mostValues || count*each > mostValues {
			return -1
		}
		count *= each
	}
	return count
}

// tensor reads a TensorProto, and its name.
func (r *protoReader) tensor(data []byte) (string, *tensor, error) {
	name, result := "", &tensor{}
	var raw []byte
	err := r.message(data, func(f protoField) (err error) {
		var values []float64
		switch f.number {
		case 1:
			var sizes []int64
			sizes, err = f.integers()
			for _, each := range sizes {
				result.shape = append(result.shape, int(min(max(each, -1), mostValues+1)))
			}
		case 2:
			result.kind = int(min(f.value, 1000))
		case 4:
			values, err = f.numbers(4)
		case 7:
			var whole []int64
			whole, err = f.integers()
			for _, each := range whole {
				values = append(values, float64(each))
			}
		case 8:
			name = string(f.bytes)
		case 9:
			raw = f.bytes
		case 10:
			values, err = f.numbers(8)
		case 13, 14:
			if f.number == 13 || f.value != 0 {
				err = errors.New("keeps numbers in other files; a brain must hold all of its own")
			}
		}
		result.values = append(result.values, values...)
		return err
	})
	if err != nil {
		return "", nil, err
	}
	if raw != nil {
		if result.values, err = result.unpacked(raw); err != nil {
			return "", nil, err
		}
	}
	count := size(result.shape)
	if count < 0 {
		return "", nil, errShape
	}
	if count != len(result.values) {
		return "", nil, fmt.Errorf("the tensor %s has %d numbers, which are not those of its shape", documents.Excerpt(name), len(result.values))
	}
	if r.values += count; r.values > mostValues {
		return "", nil, fmt.Errorf("it has more than %d numbers", mostValues)
	}
	return name, result, nil
}

func (t *tensor) unpacked(raw []byte) ([]float64, error) {
	switch t.kind {
	case single:
		return protoField{bytes: raw}.numbers(4)
	case double:
		return protoField{bytes: raw}.numbers(8)
	case integer:
		if len(raw)%8 != 0 {
			return nil, errCut
		}
		var values []float64
		for ; len(raw) > 0; raw = raw[8:] {
			values = append(values, float64(int64(binary.LittleEndian.Uint64(raw))))
		}
		return values, nil
	}
	return nil, fmt.Errorf("numbers of type %d are not known here; there are floats, doubles and int64", t.kind)
}
