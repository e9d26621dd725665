package main

// Rigid boxes that fly freely, rest on the ground and are held by joints. Boxes do not touch each other.
//
// Everything that holds a body is a row: one number that two bodies' velocities must come to, by an impulse within
// bounds. A step finds the impulses by going over all rows many times (projected Gauss-Seidel), as E. Catto,
// "Iterative Dynamics with Temporal Coherence" (2005), describes it. How far a joint has come apart is taken back
// little by little, as part of what its rows ask for.

import "math"

const (
	iterations = 40
	takenBack  = 0.2   // of an error, in each step
	sunk       = 0.001 // m, that a box may be in the ground
	rising     = 1.0   // m/s, at most, out of the ground
	bouncing   = 0.5   // m/s, from which on a box bounces
)

var gravity = Vec{0, -9.81, 0}

// Vec is a vector of the world.
type Vec [3]float64

func (a Vec) add(b Vec) Vec             { return Vec{a[0] + b[0], a[1] + b[1], a[2] + b[2]} }
func (a Vec) sub(b Vec) Vec             { return Vec{a[0] - b[0], a[1] - b[1], a[2] - b[2]} }
func (a Vec) mul(s float64) Vec         { return Vec{a[0] * s, a[1] * s, a[2] * s} }
func (a Vec) dot(b Vec) float64         { return a[0]*b[0] + a[1]*b[1] + a[2]*b[2] }
func (a Vec) each(b Vec) Vec            { return Vec{a[0] * b[0], a[1] * b[1], a[2] * b[2]} }
func (a Vec) plus(b Vec, s float64) Vec { return a.add(b.mul(s)) }
func (a Vec) unit() Vec                 { return a.mul(1 / math.Sqrt(a.dot(a))) }
func (a Vec) cross(b Vec) Vec {
	return Vec{a[1]*b[2] - a[2]*b[1], a[2]*b[0] - a[0]*b[2], a[0]*b[1] - a[1]*b[0]}
}

// perpendicular returns two unit vectors at right angles to a unit vector and to each other.
func (a Vec) perpendicular() (Vec, Vec) {
	other := Vec{1, 0, 0}
	if math.Abs(a[0]) > 0.7 {
		other = Vec{0, 1, 0}
	}
	first := a.cross(other).unit()
	return first, a.cross(first)
}

// Quat is a rotation: x, y, z, w.
type Quat [4]float64

func (q Quat) vec() Vec   { return Vec{q[0], q[1], q[2]} }
func (q Quat) back() Quat { return Quat{-q[0], -q[1], -q[2], q[3]} }

func (q Quat) mul(p Quat) Quat {
	v := p.vec().mul(q[3]).add(q.vec().mul(p[3])).add(q.vec().cross(p.vec()))
	return Quat{v[0], v[1], v[2], q[3]*p[3] - q.vec().dot(p.vec())}
}

func (q Quat) unit() Quat {
	// In two goes: the squares of very small or large numbers would leave the range of a float64.
	most := math.Max(math.Max(math.Abs(q[0]), math.Abs(q[1])), math.Max(math.Abs(q[2]), math.Abs(q[3])))
	for i := range q {
		q[i] /= most
	}
	length := math.Sqrt(q[0]*q[0] + q[1]*q[1] + q[2]*q[2] + q[3]*q[3])
	for i := range q {
		q[i] /= length
	}
	return q
}

func (q Quat) turn(v Vec) Vec {
	t := q.vec().cross(v).mul(2)
	return v.plus(t, q[3]).add(q.vec().cross(t))
}

func about(axis Vec, angle float64) Quat {
	s := math.Sin(angle / 2)
	return Quat{axis[0] * s, axis[1] * s, axis[2] * s, math.Cos(angle / 2)}
}

// fromEuler turns about z, then x, then y.
func fromEuler(x, y, z float64) Quat {
	return about(Vec{0, 1, 0}, y).mul(about(Vec{1, 0, 0}, x)).mul(about(Vec{0, 0, 1}, z))
}

func (q Quat) euler() Vec {
	x, y, z := q.turn(Vec{1, 0, 0}), q.turn(Vec{0, 1, 0}), q.turn(Vec{0, 0, 1})
	if sine := -z[1]; math.Abs(sine) > 1-1e-12 { // straight up or down: only one of y and z can be told
		return Vec{math.Copysign(math.Pi/2, sine), math.Atan2(-x[2], x[0]), 0}
	}
	return Vec{math.Asin(-z[1]), math.Atan2(z[0], z[2]), math.Atan2(x[1], y[1])}
}

type body struct {
	position, velocity, spin Vec
	rotation                 Quat
	half                     Vec
	mass                     float64
	inertia                  Vec // about the body's own axes
	friction, restitution    float64
	frozen                   bool
	force, torque            Vec // during the next tick
	impulse, angularImpulse  Vec // at its start
}

var ground = &body{rotation: Quat{0, 0, 0, 1}, frozen: true}

// push adds to what acts during the next tick; `arm` is from the centre to where it acts.
func (b *body) push(force, torque, impulse, angularImpulse, arm Vec) {
	b.force = b.force.add(force)
	b.torque = b.torque.add(torque).add(arm.cross(force))
	b.impulse = b.impulse.add(impulse)
	b.angularImpulse = b.angularImpulse.add(angularImpulse).add(arm.cross(impulse))
}

// spinOf returns what an angular impulse adds to the spin.
func (b *body) spinOf(impulse Vec) Vec {
	if b.frozen {
		return Vec{}
	}
	own := b.rotation.back().turn(impulse)
	return b.rotation.turn(Vec{own[0] / b.inertia[0], own[1] / b.inertia[1], own[2] / b.inertia[2]})
}

func (b *body) speedOf(impulse Vec) Vec {
	if b.frozen {
		return Vec{}
	}
	return impulse.mul(1 / b.mass)
}

// row asks that along . (velocity of b - that of a) + turnB . spin of b - turnA . spin of a come to `wanted`.
type row struct {
	a, b                         *body
	along, turnA, turnB          Vec
	wanted, least, most          float64
	given                        float64 // the impulse so far
	presses                      *row    // of friction: the row whose impulse bounds it
	grip                         float64
	speedA, speedB, spinA, spinB Vec // what an impulse of 1 does
	share                        float64
}

func (r *row) prepare() {
	r.speedA, r.speedB = r.a.speedOf(r.along), r.b.speedOf(r.along)
	r.spinA, r.spinB = r.a.spinOf(r.turnA), r.b.spinOf(r.turnB)
	sum := r.along.dot(r.speedA) + r.along.dot(r.speedB) + r.turnA.dot(r.spinA) + r.turnB.dot(r.spinB)
	if sum > 0 {
		r.share = 1 / sum
	}
	r.give(r.given)
}

func (r *row) give(impulse float64) {
	r.a.velocity, r.a.spin = r.a.velocity.plus(r.speedA, -impulse), r.a.spin.plus(r.spinA, -impulse)
	r.b.velocity, r.b.spin = r.b.velocity.plus(r.speedB, impulse), r.b.spin.plus(r.spinB, impulse)
}

func (r *row) solve() {
	least, most := r.least, r.most
	if r.presses != nil {
		most = r.grip * r.presses.given
		least = -most
	}
	is := r.along.dot(r.b.velocity.sub(r.a.velocity)) + r.turnB.dot(r.b.spin) - r.turnA.dot(r.a.spin)
	before := r.given
	r.given = math.Max(least, math.Min(most, before+r.share*(r.wanted-is)))
	r.give(r.given - before)
}

type joint struct {
	kind             string // fixed, hinge or slide
	a, b             *body
	anchorA, anchorB Vec  // in the bodies' own axes
	axisA, axisB     Vec  // the same
	rest             Quat // of b as seen from a
	angle            float64
	motor, limited   bool
	target, strength float64 // of the motor; N m s or N s in a step
	lower, upper     float64
	given            []float64 // what its rows gave in the last step, from which they begin
}

func newJoint(kind string, a, b *body, anchor, axis Vec) *joint {
	return &joint{
		kind: kind, a: a, b: b, strength: 1,
		anchorA: a.rotation.back().turn(anchor.sub(a.position)),
		anchorB: b.rotation.back().turn(anchor.sub(b.position)),
		axisA:   a.rotation.back().turn(axis), axisB: b.rotation.back().turn(axis),
		rest: a.rotation.back().mul(b.rotation),
	}
}

// rows returns what the joint asks for in a step of length h.
func (j *joint) rows(h float64) []*row {
	a, b := j.a, j.b
	armA, armB := a.rotation.turn(j.anchorA), b.rotation.turn(j.anchorB)
	apart := b.position.add(armB).sub(a.position).sub(armA)
	axis := a.rotation.turn(j.axisA)
	var found []*row
	ask := func(along, turnA, turnB Vec, wanted, least, most float64) {
		found = append(found, &row{
			a: a, b: b, along: along, turnA: turnA, turnB: turnB, wanted: wanted, least: least, most: most,
		})
	}
	everything := math.Inf(1)
	shift := func(along Vec, wanted, least, most float64) {
		ask(along, armA.add(apart).cross(along), armB.cross(along), wanted, least, most)
	}
	turn := func(about Vec, wanted, least, most float64) {
		ask(Vec{}, about, about, wanted, least, most)
	}

	// How far b is from where it is to be, as a rotation that is small.
	off := b.rotation.mul(a.rotation.mul(j.rest).back())
	tilt := off.vec().mul(math.Copysign(2, off[3]))
	free, position := turn, 0.0
	switch j.kind {
	case "hinge":
		seen := a.rotation.back().mul(off).mul(a.rotation)
		angle := 2 * math.Atan2(seen.vec().dot(j.axisA), seen[3])
		j.angle += math.Remainder(angle-j.angle, 2*math.Pi)
		position = j.angle
	case "slide":
		free, position = shift, apart.dot(axis)
	}
	if j.kind != "fixed" {
		if j.motor {
			free(axis, j.target, -j.strength, j.strength)
		}
		if j.limited {
			free(axis, approach(j.lower-position, h), 0, everything)
			free(axis, -approach(position-j.upper, h), -everything, 0)
		}
	}
	first, second := axis.perpendicular()
	kept, held := []Vec{axis, first, second}, []Vec{axis, first, second}
	switch j.kind {
	case "hinge":
		kept, tilt = kept[1:], axis.cross(b.rotation.turn(j.axisB))
	case "slide":
		held = held[1:]
	}
	for _, about := range kept {
		turn(about, -takenBack/h*tilt.dot(about), -everything, everything)
	}
	for _, along := range held {
		shift(along, -takenBack/h*apart.dot(along), -everything, everything)
	}
	if len(j.given) == len(found) {
		for i, r := range found {
			r.given = j.given[i]
		}
	}
	return found
}

// approach says how fast to go to a bound: what is left of the way, or back from beyond it.
func approach(beyond, h float64) float64 {
	if beyond < 0 {
		return beyond / h
	}
	return takenBack * beyond / h
}

var corners = [8]Vec{
	{-1, -1, -1}, {1, -1, -1}, {-1, 1, -1}, {1, 1, -1}, {-1, -1, 1}, {1, -1, 1}, {-1, 1, 1}, {1, 1, 1},
}

// touching returns the rows of the corners that are, or come within a step, on the ground.
func (b *body) touching(h float64) []*row {
	reach := b.half.dot(b.half)
	low := b.position[1] - math.Sqrt(reach)
	if b.frozen || low+h*math.Min(b.velocity[1], 0) > sunk {
		return nil
	}
	var found []*row
	up := Vec{0, 1, 0}
	for _, corner := range corners {
		arm := b.rotation.turn(b.half.each(corner))
		above := b.position[1] + arm[1]
		speed := b.velocity.add(b.spin.cross(arm))[1]
		if above+h*math.Min(speed, 0) > sunk+0.01 {
			continue
		}
		wanted := -above / h // just touch it
		if above < 0 {
			wanted = math.Min(takenBack/h*math.Max(-above-sunk, 0), rising)
		}
		if speed < -bouncing && above+h*speed < 0 {
			wanted = math.Max(wanted, -b.restitution*speed)
		}
		normal := &row{a: ground, b: b, along: up, turnB: arm.cross(up), wanted: wanted, most: math.Inf(1)}
		found = append(found, normal)
		for _, along := range []Vec{{1, 0, 0}, {0, 0, 1}} {
			found = append(found, &row{
				a: ground, b: b, along: along, turnB: arm.cross(along), presses: normal, grip: b.friction,
			})
		}
	}
	return found
}

// advance makes one engine step of length h.
func advance(bodies []*body, joints []*joint, h float64) {
	var rows []*row
	for _, b := range bodies {
		if b.frozen {
			continue
		}
		b.velocity = b.velocity.plus(gravity, h).plus(b.force, h/b.mass)
		b.spin = b.spin.add(b.spinOf(b.torque.mul(h)))
	}
	var ofJoints [][]*row
	for _, j := range joints {
		ofJoints = append(ofJoints, j.rows(h))
		rows = append(rows, ofJoints[len(ofJoints)-1]...)
	}
	for _, b := range bodies {
		rows = append(rows, b.touching(h)...)
	}
	for _, r := range rows {
		r.prepare()
	}
	for i := 0; i < iterations; i++ {
		for _, r := range rows {
			r.solve()
		}
	}
	for i, j := range joints {
		j.given = j.given[:0]
		for _, r := range ofJoints[i] {
			j.given = append(j.given, r.given)
		}
	}
	for _, b := range bodies {
		if b.frozen {
			continue
		}
		b.position = b.position.plus(b.velocity, h)
		if speed := math.Sqrt(b.spin.dot(b.spin)); speed > 0 {
			// The angular momentum stays as it is, so that the spin of a body that is no cube changes with its pose.
			momentum := b.rotation.turn(b.rotation.back().turn(b.spin).each(b.inertia))
			b.rotation = about(b.spin.mul(1/speed), speed*h).mul(b.rotation).unit()
			b.spin = b.spinOf(momentum)
		}
	}
}

// finite says whether a body is anywhere.
func (b *body) finite() bool {
	sum := 0.0
	for i := range b.position {
		sum += math.Abs(b.position[i]) + math.Abs(b.velocity[i]) + math.Abs(b.spin[i]) + math.Abs(b.rotation[i])
	}
	return sum < 1e30
}
