package genome

import (
	"math"
	"slices"
)

var (
	jointKinds   = []string{"hinge", "slide", "fixed", "pin", "conetwist"}
	jointWeights = []float64{0.72, 0.12, 0.08, 0.04, 0.04}
	reaches      = map[string]float64{"hinge": 1.2, "slide": 0.2} // rad, m: how far usual limits are from 0
)

const planarKinds = 4 // so many of them stay in a plane

// jointChange is one change of a joint: of a part of a graph, or between two cubes. The effort of its motor is in
// proportion to the weight of the body, kg, and to the length of what it moves, m.
type jointChange struct {
	joint       object
	draw        *Draw
	weight, arm float64
	planar      bool
}

// drawJoint draws what a joint is, but for where: type, axis, limits, motor.
func drawJoint(draw *Draw, weight, arm float64, planar bool) object {
	c := &jointChange{object{}, draw, weight, arm, planar}
	kinds, weights := jointKinds, jointWeights
	if planar {
		kinds, weights = kinds[:planarKinds], weights[:planarKinds]
	}
	c.become(weighted(draw, kinds, weights))
	if driven(c.kind()) {
		reach := float64(reaches[c.kind()] * draw.Uniform(0.4, 1.3))
		c.joint["limits"] = array{rounded(-reach, 6), rounded(reach, 6)}
		c.motorise()
	}
	if driven(c.kind()) || c.kind() == "conetwist" {
		c.changeAxis()
	}
	return c.joint
}

func (c *jointChange) kind() string { return text(c.joint, "type", "") }

func (c *jointChange) change(kind string) bool {
	switch kind {
	case "joint":
		return c.changeKind()
	case "limits":
		return c.changeLimits()
	case "axis":
		return c.changeAxis()
	}
	return c.changeMotor()
}

// changeKind makes a joint one of another type, which keeps what it can of limits, motor and axis.
func (c *jointChange) changeKind() bool {
	var kinds []string
	var weights []float64
	for i, kind := range jointKinds {
		if kind != c.kind() && (i < planarKinds || !c.planar) {
			kinds, weights = append(kinds, kind), append(weights, jointWeights[i])
		}
	}
	c.become(weighted(c.draw, kinds, weights))
	if driven(c.kind()) && !has(c.joint, "motor") {
		c.motorise()
	}
	if c.planar && driven(c.kind()) {
		c.changeAxis()
	}
	return true
}

// changeLimits widens, narrows, shifts or takes away a joint's limits, or gives it some.
func (c *jointChange) changeLimits() bool {
	d, kind := c.draw, c.kind()
	if !driven(kind) && kind != "conetwist" {
		return false
	}
	if has(c.joint, "limits") && d.Chance(0.1) {
		delete(c.joint, "limits")
		return true
	}
	reach := reaches[kind]
	ends := []float64{-reach, reach}
	if kind == "conetwist" {
		ends = []float64{0.5, 0.5}
	}
	if has(c.joint, "limits") {
		ends = numbers(list(c.joint, "limits"))
	}
	for i, end := range ends {
		scaled := float64(end * d.Factor(0.3))
		if kind == "conetwist" {
			ends[i] = within(scaled+math.Abs(d.Normal(0.01)), 0, 3.14)
		} else {
			ends[i] = scaled + d.Normal(float64(0.05*reach))
		}
	}
	if kind != "conetwist" {
		ends[0], ends[1] = within(min(ends[0], 0), -1000, 0), within(max(ends[1], 0), 0, 1000)
	}
	c.joint["limits"] = anyOf(ends)
	return true
}

// changeAxis turns a joint's axis.
func (c *jointChange) changeAxis() bool {
	kind := c.kind()
	if !driven(kind) && kind != "conetwist" {
		return false
	}
	axis := c.draw.direction()
	switch {
	case !c.planar:
	case kind == "hinge":
		axis = Vector{0, 0, 1}
	case axis[0] != 0 || axis[1] != 0:
		axis[2] = 0
	default:
		axis = Vector{1, 0, 0}
	}
	c.joint["axis"] = anyOf(axis[:])
	return true
}

// changeMotor changes the mode, range or strength of a joint's motor, or gives it one.
func (c *jointChange) changeMotor() bool {
	if !driven(c.kind()) {
		return false
	}
	motor, there := c.joint["motor"].(object)
	if !there {
		c.motorise()
		return true
	}
	d := c.draw
	switch weighted(d, []string{"range", "effort", "mode", "spring"}, []float64{0.45, 0.35, 0.1, 0.1}) {
	case "mode":
		mode := "position"
		if motor["mode"] == "position" {
			mode = "velocity"
		}
		motor["mode"], motor["range"] = mode, c.drawRange(mode)
	case "effort":
		motor["max_effort"] = within(float64(number(motor, "max_effort", 0)*d.Factor(0.4)), 0, 1e6)
	case "range":
		ends := numbers(list(motor, "range"))
		shift := float64(d.Normal(0.1) * math.Abs(ends[1]-ends[0]))
		width := d.Factor(0.3)
		low := within(float64(ends[0]*width)+shift, -1000, 1000)
		high := within(float64(ends[1]*width)+shift, -1000, 1000)
		if low != high {
			motor["range"] = array{low, high}
		}
	case "spring":
		name, arm := oneOf(d, []string{"stiffness", "damping"}), 10.0
		if c.kind() == "hinge" {
			arm = c.arm
		}
		usual := float64(float64(0.1*c.weight) * arm)
		c.joint[name] = within(float64(number(c.joint, name, usual)*d.Factor(0.5)), 0, 1e6)
	}
	return true
}

// become gives a joint a type, and takes away what one of that type may not have.
func (c *jointChange) become(kind string) {
	c.joint["type"] = kind
	gone := []string{"limits"} // rad, m and the two numbers of a cone mean different things
	if !driven(kind) {
		gone = append(gone, "motor", "stiffness", "damping")
	}
	if kind == "fixed" || kind == "pin" {
		gone = append(gone, "axis")
	}
	for _, name := range gone {
		delete(c.joint, name)
	}
}

// motorise gives a hinge or slide a motor that can lift a part of the body.
func (c *jointChange) motorise() {
	mode := weighted(c.draw, []string{"position", "velocity"}, []float64{0.8, 0.2})
	strength, arm := float64(float64(c.draw.Uniform(0.2, 1.5)*gravity)*c.weight), 1.0
	if c.kind() == "hinge" {
		arm = c.arm
	}
	c.joint["motor"] = object{
		"mode": mode, "range": c.drawRange(mode), "max_effort": within(float64(strength*arm), 0.001, 1e6),
	}
}

// drawRange draws a motor's range: of a servo, up to the joint's limits.
func (c *jointChange) drawRange(mode string) array {
	reach := reaches[c.kind()]
	if mode == "velocity" {
		speed := float64(c.draw.Uniform(1, 8) * reach)
		return array{rounded(-speed, 6), rounded(speed, 6)}
	}
	ends := []float64{-reach, reach}
	if has(c.joint, "limits") {
		ends = slices.Clone(numbers(list(c.joint, "limits")))
	}
	part := c.draw.Uniform(0.4, 1)
	low, high := rounded(float64(part*ends[0]), 6), rounded(float64(part*ends[1]), 6)
	if low == high {
		low, high = rounded(-reach, 6), rounded(reach, 6)
	}
	return array{low, high}
}

func within(value, low, high float64) float64 { return rounded(min(max(value, low), high), 6) }
