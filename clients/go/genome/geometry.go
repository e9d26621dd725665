package genome

import (
	"fmt"
	"math"
	"slices"
	"strconv"

	"nmes/internal/elementary"
)

// Vector is x, y (up), z, in m. Quaternion is x, y, z, w.
type (
	Vector     = [3]float64
	Quaternion = [4]float64
)

var upright = Quaternion{0, 0, 0, 1}

// Products are turned into float64 before they are added, so that no processor adds and multiplies at once: that would
// give other bits, and other genomes.

func plus(a, b Vector) Vector  { return Vector{a[0] + b[0], a[1] + b[1], a[2] + b[2]} }
func minus(a, b Vector) Vector { return Vector{a[0] - b[0], a[1] - b[1], a[2] - b[2]} }

// times and over multiply and divide number by number.
func times(a, b Vector) Vector {
	return Vector{float64(a[0] * b[0]), float64(a[1] * b[1]), float64(a[2] * b[2])}
}
func over(a, b Vector) Vector { return Vector{a[0] / b[0], a[1] / b[1], a[2] / b[2]} }

func dot(a, b Vector) float64 {
	return float64(a[0]*b[0]) + float64(a[1]*b[1]) + float64(a[2]*b[2])
}

func cross(a, b Vector) Vector {
	return Vector{
		float64(a[1]*b[2]) - float64(a[2]*b[1]),
		float64(a[2]*b[0]) - float64(a[0]*b[2]),
		float64(a[0]*b[1]) - float64(a[1]*b[0]),
	}
}

func normalized(q Quaternion) Quaternion {
	n := math.Sqrt(float64(q[0]*q[0]) + float64(q[1]*q[1]) + float64(q[2]*q[2]) + float64(q[3]*q[3]))
	return Quaternion{q[0] / n, q[1] / n, q[2] / n, q[3] / n}
}

func conjugate(q Quaternion) Quaternion { return Quaternion{-q[0], -q[1], -q[2], q[3]} }

// multiply returns the rotation b followed by a.
func multiply(a, b Quaternion) Quaternion {
	return Quaternion{
		float64(a[3]*b[0]) + float64(a[0]*b[3]) + float64(a[1]*b[2]) - float64(a[2]*b[1]),
		float64(a[3]*b[1]) - float64(a[0]*b[2]) + float64(a[1]*b[3]) + float64(a[2]*b[0]),
		float64(a[3]*b[2]) + float64(a[0]*b[1]) - float64(a[1]*b[0]) + float64(a[2]*b[3]),
		float64(a[3]*b[3]) - float64(a[0]*b[0]) - float64(a[1]*b[1]) - float64(a[2]*b[2]),
	}
}

// rotate turns a vector by a unit quaternion.
func rotate(q Quaternion, v Vector) Vector {
	x, y, z, w := q[0], q[1], q[2], q[3]
	tx := float64(2.0 * (float64(y*v[2]) - float64(z*v[1])))
	ty := float64(2.0 * (float64(z*v[0]) - float64(x*v[2])))
	tz := float64(2.0 * (float64(x*v[1]) - float64(y*v[0])))
	return Vector{
		v[0] + float64(w*tx) + float64(y*tz) - float64(z*ty),
		v[1] + float64(w*ty) + float64(z*tx) - float64(x*tz),
		v[2] + float64(w*tz) + float64(x*ty) - float64(y*tx),
	}
}

// fromEuler converts angles, rad, in the order Y, X, Z.
func fromEuler(x, y, z float64) Quaternion {
	cx, sx := elementary.Cos(x/2), elementary.Sin(x/2)
	cy, sy := elementary.Cos(y/2), elementary.Sin(y/2)
	cz, sz := elementary.Cos(z/2), elementary.Sin(z/2)
	product := func(a, b, c float64) float64 { return float64(float64(a*b) * c) }
	return Quaternion{
		product(cy, sx, cz) + product(sy, cx, sz),
		product(sy, cx, cz) - product(cy, sx, sz),
		product(cy, cx, sz) - product(sy, sx, cz),
		product(cy, cx, cz) + product(sy, sx, sz),
	}
}

// rounded returns the number of so many decimal digits behind the point that is nearest.
func rounded(value float64, digits int) float64 {
	nearest, err := strconv.ParseFloat(strconv.FormatFloat(value, 'f', digits, 64), 64)
	if err != nil {
		panic(err) // it was written a moment ago
	}
	return nearest
}

// -- shapes ----------------------------------------------------------------------------------------------------------

const longer = 1.01 // than it is wide: the least that a capsule which is made to fit is

var pi = math.Pi // a double: what is divided by it is, too

// misfit returns in words what is wrong with the edges of a shape; nothing where nothing is.
func misfit(shape string, size Vector) string {
	x, y, z := size[0], size[1], size[2]
	if shape == "sphere" && !(x == y && y == z) {
		return fmt.Sprintf("a sphere has three equal edges, not %s, %s and %s", short(x), short(y), short(z))
	}
	if shape != "capsule" && shape != "cylinder" {
		return ""
	}
	across, along := acrossAndAlong(size)
	if across != size[(lies(size)+1)%3] {
		return fmt.Sprintf("a %s has two equal edges, across it; %s, %s and %s all differ", shape, short(x), short(y), short(z))
	}
	if shape == "capsule" && !(along > across) {
		return fmt.Sprintf("a capsule is longer than it is wide, and %s is not more than %s", short(along), short(across))
	}
	return ""
}

// lies returns the own axis along which a capsule or a cylinder of this size lies.
func lies(size Vector) int {
	switch {
	case size[0] == size[2]:
		return 1
	case size[1] == size[2]:
		return 0
	}
	return 2
}

func acrossAndAlong(size Vector) (float64, float64) {
	axis := lies(size)
	return size[(axis+2)%3], size[axis]
}

// volume returns that of a shape, m^3.
func volume(shape string, size Vector) float64 {
	if shape == "box" {
		return float64(float64(size[0]*size[1]) * size[2])
	}
	across, along := acrossAndAlong(size)
	ball := float64(float64(float64(pi/6.0*across)*across) * across)
	switch shape {
	case "sphere":
		return ball
	case "cylinder":
		return float64(float64(float64(pi/4.0*across)*across) * along)
	}
	return float64(float64(float64(pi/4.0*across)*across)*(along-across)) + ball
}

// fitted returns the size that a shape may have which is nearest to one that it may not have, of about its volume.
func fitted(shape string, size Vector) Vector {
	if misfit(shape, size) == "" {
		return size
	}
	order := []int{0, 1, 2}
	slices.SortStableFunc(order, func(i, j int) int {
		switch {
		case size[i] < size[j]:
			return -1
		case size[i] > size[j]:
			return 1
		}
		return 0
	})
	low, middle, high := order[0], order[1], order[2]
	if shape == "sphere" {
		edge := math.Sqrt(float64(math.Sqrt(float64(size[low]*size[high])) * size[middle]))
		return Vector{edge, edge, edge}
	}
	axis, other := high, low
	if shape == "cylinder" && float64(size[middle]*size[middle]) > float64(size[low]*size[high]) {
		axis, other = low, high
	}
	across := math.Sqrt(float64(size[middle] * size[other]))
	along := size[axis]
	if shape == "capsule" {
		along = math.Max(along, float64(longer*across))
	}
	result := Vector{across, across, across}
	result[axis] = along
	return result
}

// -- boxes -----------------------------------------------------------------------------------------------------------

// axesOf returns a cube's own directions.
func axesOf(cube *Cube) [3]Vector {
	q := cube.Quaternion
	return [3]Vector{rotate(q, Vector{1, 0, 0}), rotate(q, Vector{0, 1, 0}), rotate(q, Vector{0, 0, 1})}
}

// cornersOf returns the eight corners of a cube, m.
func cornersOf(cube *Cube) [8]Vector {
	var corners [8]Vector
	axes := axesOf(cube)
	for i := range corners {
		for k := range 3 {
			sign := func(axis int) float64 {
				if i>>(2-axis)&1 == 1 {
					return 0.5
				}
				return -0.5
			}
			sum := float64(float64(sign(0)*cube.Size[0]) * axes[0][k])
			sum += float64(float64(sign(1)*cube.Size[1]) * axes[1][k])
			sum += float64(float64(sign(2)*cube.Size[2]) * axes[2][k])
			corners[i][k] = sum + cube.Position[k]
		}
	}
	return corners
}

const parallel = 1e-6 // sine of the angle below which edges count as parallel

// depth returns how far two boxes overlap, m: not above 0 where they do not.
//
// By the separating axis theorem: of two boxes, the faces' normals and the cross products of the edges.
func depth(one, other *box) float64 {
	arm, deepest := minus(other.centre, one.centre), math.Inf(1)
	try := func(axis Vector) {
		reach := extent(axis, one) + extent(axis, other)
		deepest = math.Min(deepest, reach-math.Abs(dot(axis, arm)))
	}
	for _, axis := range append(one.axes[:], other.axes[:]...) {
		try(axis)
	}
	for _, a := range one.axes {
		for _, b := range other.axes {
			axis := cross(a, b)
			if length := math.Sqrt(dot(axis, axis)); length >= parallel {
				try(Vector{axis[0] / length, axis[1] / length, axis[2] / length})
			}
		}
	}
	return deepest
}

func extent(axis Vector, b *box) float64 {
	sum := 0.0
	for i, half := range b.halves {
		sum += float64(math.Abs(dot(axis, b.axes[i])) * half)
	}
	return sum
}

// box is where a cube is: its centre, own directions, and halves of its edges, m.
type box struct {
	centre Vector
	axes   [3]Vector
	halves Vector
}

func boxesOf(cubes []Cube) []box {
	boxes := make([]box, len(cubes))
	for i := range cubes {
		size := cubes[i].Size
		boxes[i] = box{cubes[i].Position, axesOf(&cubes[i]), Vector{size[0] / 2, size[1] / 2, size[2] / 2}}
	}
	return boxes
}

// near tells whether the balls around two boxes meet.
func near(one, other *box) bool {
	arm := minus(one.centre, other.centre)
	reach := math.Sqrt(dot(one.halves, one.halves)) + math.Sqrt(dot(other.halves, other.halves))
	return dot(arm, arm) < float64(reach*reach)
}
