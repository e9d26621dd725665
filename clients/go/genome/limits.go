package genome

import (
	"fmt"
	"math"
)

const gravity = 9.81 // m/s^2, by which efforts are judged, wherever a body is

// Limits are the limits of a creature's body; nil is no limit.
type Limits struct {
	// How many cubes.
	Cubes *float64
	// Of all of them, kg.
	Mass *float64
	// Longest edge of the box around the body, m.
	Size *float64
	// Of each cube, kg/m^3.
	Density *float64
	// Mass of a cube, of that of another to which a joint joins it; of a body that develops, in the sizes to which its
	// rules may bring them.
	Neighbours *float64
	// Of each motor: of a slide's, of the body's weight; of a hinge's, of weight times size; of one that develops, of the
	// lightest that its rules can leave.
	Effort *float64
	// Of each cube.
	Restitution *float64
	// Least and most of each cube that sets its own; others have that of the ground.
	Friction *[2]float64
}

// check returns the reasons why a body is not within the limits, in words; none if it is.
func (l *Limits) check(body *Body) []string {
	var reasons []string
	beyond := func(limit *float64, value float64) bool { return limit != nil && value > float64(*limit*(1.0+1e-9)) }
	size, mass := body.size(), body.Mass()
	whole := func(limit *float64, value float64, words string) {
		if beyond(limit, value) {
			reasons = append(reasons, fmt.Sprintf("the body has "+words, short(value), short(*limit)))
		}
	}
	whole(l.Cubes, float64(len(body.Cubes)), "%s cubes, at most %s are allowed")
	whole(l.Mass, mass, "%s kg, at most %s are allowed")
	whole(l.Size, size, "%s m from end to end, at most %s are allowed")

	// The worst of its cubes, pairs and motors.
	var dense, bouncy, unlike, strong worst
	for _, cube := range body.Cubes {
		dense.see(cube.Mass/volume(cube.Shape, cube.Size), cube.ID)
		if cube.Restitution != nil {
			bouncy.see(*cube.Restitution, cube.ID)
		}
	}
	may := ""
	if len(body.Development) > 0 {
		may = " as the body may develop"
	}
	small, large := scales(body)
	least, most := map[string]float64{}, map[string]float64{}
	for _, cube := range body.Cubes {
		least[cube.ID] = float64(cube.Mass * cubed(small, cube.ID))
		most[cube.ID] = float64(cube.Mass * cubed(large, cube.ID))
	}
	for _, joint := range body.Joints {
		unlike.see(most[joint.Cube1]/least[joint.Cube2], joint.ID)
	}
	for _, joint := range body.Joints {
		unlike.see(most[joint.Cube2]/least[joint.Cube1], joint.ID)
	}
	for i, light := range leastLeft(body) {
		joint := &body.Joints[i]
		if joint.Motor == nil {
			continue
		}
		weight := float64(gravity * light.Mass())
		if joint.Type != "slide" {
			weight = float64(weight * light.size())
		}
		strong.see(joint.Motor.MaxEffort/weight, joint.ID)
	}
	each := func(limit *float64, found worst, words string) {
		if beyond(limit, found.value) {
			reasons = append(reasons, fmt.Sprintf(words, quoted(found.name), short(found.value), short(*limit)))
		}
	}
	each(l.Density, dense, "cube %s has %s kg/m^3, at most %s are allowed")
	each(l.Neighbours, unlike, "joint %s joins masses of 1 to %s"+may+", at most 1 to %s are allowed")
	each(l.Restitution, bouncy, "cube %s has a restitution of %s, at most %s is allowed")
	each(l.Effort, strong, "the motor of joint %s has an effort of %s"+may+", at most %s is allowed")
	return append(reasons, l.slippery(body)...)
}

// slippery returns why the surfaces of a body are none: the cube whose own friction is farthest below or above.
func (l *Limits) slippery(body *Body) []string {
	if l.Friction == nil {
		return nil
	}
	low, high := l.Friction[0], l.Friction[1]
	value, name, farthest := low, "", math.Inf(-1)
	for _, cube := range body.Cubes {
		if cube.Friction == nil {
			continue
		}
		if by := max(low-*cube.Friction, *cube.Friction-high); by > farthest {
			value, name, farthest = *cube.Friction, cube.ID, by
		}
	}
	if low <= value && value <= high {
		return nil
	}
	return []string{fmt.Sprintf("cube %s has a friction of %s, from %s to %s is allowed",
		quoted(name), short(value), short(low), short(high))}
}

// cubed returns the third power of a scale, which is 1 where there is none.
func cubed(scales map[string]float64, part string) float64 {
	if scale, there := scales[part]; there {
		return math.Pow(scale, 3)
	}
	return 1
}

// worst is the greatest of some values, the first of equals, and whose it is.
type worst struct {
	value float64
	name  string
}

func (w *worst) see(value float64, name string) {
	if value > w.value {
		w.value, w.name = value, name
	}
}
