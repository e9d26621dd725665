package genome

import "fmt"

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
	// Mass of a cube, of that of another to which a joint joins it.
	Neighbours *float64
	// Of each motor: of a slide's, of the body's weight; of a hinge's, of weight times size.
	Effort *float64
	// Of each cube.
	Restitution *float64
}

// check returns the reasons why a body is not within the limits, in words; none if it is.
func (l *Limits) check(body *Body) []string {
	var reasons []string
	beyond := func(limit *float64, value float64) bool { return limit != nil && value > float64(*limit*(1.0+1e-9)) }
	low, high := body.Bounds()
	edges := minus(high, low)
	size, mass := max(edges[0], edges[1], edges[2]), body.Mass()
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
	var ratios []float64
	for i := range body.Joints {
		joint := &body.Joints[i]
		ratios = append(ratios, body.cube(joint.Cube1).Mass/body.cube(joint.Cube2).Mass)
		unlike.see(ratios[i], joint.ID)
		if joint.Motor != nil {
			weight := float64(gravity * mass)
			if joint.Type != "slide" {
				weight = float64(weight * size)
			}
			strong.see(joint.Motor.MaxEffort/weight, joint.ID)
		}
	}
	for i, ratio := range ratios {
		unlike.see(1/ratio, body.Joints[i].ID)
	}
	each := func(limit *float64, found worst, words string) {
		if beyond(limit, found.value) {
			reasons = append(reasons, fmt.Sprintf(words, quoted(found.name), short(found.value), short(*limit)))
		}
	}
	each(l.Density, dense, "cube %s has %s kg/m^3, at most %s are allowed")
	each(l.Neighbours, unlike, "joint %s joins masses of 1 to %s, at most 1 to %s are allowed")
	each(l.Restitution, bouncy, "cube %s has a restitution of %s, at most %s is allowed")
	each(l.Effort, strong, "the motor of joint %s has an effort of %s, at most %s is allowed")
	return reasons
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
