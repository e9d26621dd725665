package genome

import (
	"fmt"
	"maps"
	"math"
	"slices"
)

const (
	smallestDrawn, largestDrawn = 0.02, 5.0 // m: edges that are drawn; a schema allows more
	lightest, heaviest          = 0.001, 10_000.0
)

// cubeChange is one change of a body of cubes and joints, which is a document; before is the same, read.
type cubeChange struct {
	body   object
	before *Body
	draw   *Draw
	planar bool
}

func (c *cubeChange) change(kind string) bool {
	switch kind {
	case "add-part":
		return c.addPart()
	case "remove-part":
		return c.removePart()
	case "resize-part":
		return c.resizePart()
	case "move-part":
		return c.movePart()
	case "symmetry":
		return c.symmetry()
	case "joint", "limits", "axis", "motor":
		if len(c.before.Joints) == 0 {
			return false
		}
		chosen := oneOf(c.draw, c.before.Joints)
		size := c.before.cube(chosen.Cube2).Size
		entry := c.find("joints", chosen.ID)
		return (&jointChange{entry, c.draw, c.before.Mass(), max(size[0], size[1], size[2]), c.planar}).change(kind)
	}
	return false // cubes have no recursion
}

// limb is a cube and all that hangs on it, and the joint and the cube by which it hangs.
type limb struct {
	root, parent *Cube
	joint        *Joint
	cubes        map[string]bool
}

// limbsOf returns each cube but the body's root as a limb: the tree is what a walk from the root meets first.
func limbsOf(body *Body) []limb {
	hangs := hangingOf(body)
	members := map[string]map[string]bool{body.Cubes[0].ID: {}}
	for _, name := range hangs.names {
		members[name] = map[string]bool{name: true}
	}
	limbs := make([]limb, len(hangs.names))
	for i, name := range slices.Backward(hangs.names) {
		joint := hangs.by[name]
		parent := joint.other(name)
		maps.Copy(members[parent], members[name])
		limbs[i] = limb{body.cube(name), body.cube(parent), joint, members[name]}
	}
	return limbs
}

func placed(point Vector) array {
	for k := range point {
		point[k] = noMinus(rounded(min(max(point[k], -1000), 1000), 9))
	}
	return anyOf(point[:])
}

func edge(value float64) float64   { return rounded(min(max(value, smallestDrawn), largestDrawn), 6) }
func massOf(value float64) float64 { return rounded(min(max(value, lightest), heaviest), 9) }

// fresh returns an id that neither a cube nor a joint has: the name, or with the lowest free number behind it.
func (c *cubeChange) fresh(name string) string {
	taken := map[string]bool{}
	for _, kind := range []string{"cubes", "joints"} {
		for _, id := range fieldsOf(objects(c.body, kind), "id") {
			taken[id] = true
		}
	}
	stem, free := name[:min(len(name), 56)], name
	for number := 2; taken[free]; number++ {
		free = fmt.Sprintf("%s.%d", stem, number)
	}
	return free
}

// stand lifts or lowers the whole body to where its lowest point was.
func (c *cubeChange) stand() {
	lowest := math.Inf(1)
	for _, entry := range objects(c.body, "cubes") {
		cube := readCube(entry)
		for _, corner := range cornersOf(&cube) {
			lowest = math.Min(lowest, corner[1])
		}
	}
	before, _ := c.before.Bounds()
	by := Vector{0, before[1] - lowest, 0}
	for _, cube := range objects(c.body, "cubes") {
		cube["position"] = placed(plus(vectorOf(list(cube, "position")), by))
	}
	for _, joint := range objects(c.body, "joints") {
		joint["anchor"] = placed(plus(vectorOf(list(joint, "anchor")), by))
	}
}

// shift moves cubes, and the anchors of the joints between them.
func (c *cubeChange) shift(cubes map[string]bool, by Vector) {
	for _, cube := range objects(c.body, "cubes") {
		if cubes[text(cube, "id", "")] {
			cube["position"] = placed(plus(vectorOf(list(cube, "position")), by))
		}
	}
	for _, joint := range objects(c.body, "joints") {
		if cubes[text(joint, "cube1", "")] && cubes[text(joint, "cube2", "")] {
			joint["anchor"] = placed(plus(vectorOf(list(joint, "anchor")), by))
		}
	}
}

func (c *cubeChange) find(kind, id string) object {
	entries := objects(c.body, kind)
	return entries[slices.IndexFunc(entries, func(entry object) bool { return text(entry, "id", "") == id })]
}

func (c *cubeChange) append(kind string, entry object) {
	c.body[kind] = append(list(c.body, kind), entry)
}

func (c *cubeChange) count(kind string) int { return len(list(c.body, kind)) }

// addPart hangs a new cube on a face of one that is there.
func (c *cubeChange) addPart() bool {
	if c.count("cubes") >= mostCubes || c.count("joints") >= mostJoints {
		return false
	}
	d, parent, axes := c.draw, oneOf(c.draw, c.before.Cubes), 2
	if c.planar {
		axes = 1
	}
	axis, sign := d.Count(0, axes), oneOf(d, []float64{-1, 1})
	var size, local, outward Vector
	for k := range size {
		size[k] = edge(float64(parent.Size[k] * d.Uniform(0.3, 1.1)))
	}
	for k := range local {
		local[k] = d.Uniform(-0.4, 0.4)
	}
	local = times(local, parent.Size)
	local[axis] = float64(sign*parent.Size[axis]) / 2
	if c.planar {
		local[2] = 0
	}
	outward[axis] = float64(sign*size[axis]) / 2
	anchor := plus(parent.Position, rotate(parent.Quaternion, local))
	name := c.fresh("part")
	cube := object{
		"id":       name,
		"size":     anyOf(size[:]),
		"mass":     massOf(float64(parent.Mass / volume("box", parent.Size) * volume("box", size))),
		"position": placed(plus(anchor, rotate(parent.Quaternion, outward))),
	}
	if parent.Quaternion != upright {
		cube["rotation"] = anyOf(parent.Quaternion[:])
	}
	joint := object{"id": name, "cube1": parent.ID, "cube2": name, "anchor": placed(anchor)}
	maps.Copy(joint, drawJoint(d, c.before.Mass(), max(size[0], size[1], size[2]), c.planar))
	c.append("cubes", cube)
	c.append("joints", joint)
	c.stand()
	return true
}

// removePart takes a limb away, rather a small one.
func (c *cubeChange) removePart() bool {
	limbs := limbsOf(c.before)
	if len(limbs) == 0 {
		return false
	}
	weights := make([]float64, len(limbs))
	for i, limb := range limbs {
		weights[i] = 1 / float64(len(limb.cubes))
	}
	gone := weighted(c.draw, limbs, weights).cubes
	c.body["cubes"] = slices.DeleteFunc(list(c.body, "cubes"), func(cube any) bool {
		return gone[text(cube.(object), "id", "")]
	})
	c.body["joints"] = slices.DeleteFunc(list(c.body, "joints"), func(joint any) bool {
		return gone[text(joint.(object), "cube1", "")] || gone[text(joint.(object), "cube2", "")]
	})
	c.stand()
	return true
}

// resizePart changes the edges of a cube about the joint that it hangs on; what hangs on it goes along.
func (c *cubeChange) resizePart() bool {
	d, chosen, limbs := c.draw, oneOf(c.draw, c.before.Cubes), limbsOf(c.before)
	pivot := chosen.Position
	if at := slices.IndexFunc(limbs, func(limb limb) bool { return limb.root.ID == chosen.ID }); at >= 0 {
		pivot = limbs[at].joint.Anchor
	}
	factor := d.Factor(0.25)
	alike := d.Chance(0.4)
	var wanted Vector
	for k := range wanted {
		if !alike {
			factor = d.Factor(0.25)
		}
		wanted[k] = edge(float64(chosen.Size[k] * factor))
	}
	if chosen.Shape != "box" {
		wanted = fit(chosen.Shape, wanted)
	}
	factors := over(wanted, chosen.Size)
	scaled := func(point Vector) Vector {
		local := rotate(conjugate(chosen.Quaternion), minus(point, pivot))
		return plus(pivot, rotate(chosen.Quaternion, times(local, factors)))
	}
	larger := volume("box", factors)
	if chosen.Shape != "box" {
		larger = volume(chosen.Shape, wanted) / volume(chosen.Shape, chosen.Size)
	}
	cube := c.find("cubes", chosen.ID)
	cube["size"], cube["mass"] = anyOf(wanted[:]), massOf(float64(chosen.Mass*larger))
	cube["position"] = placed(scaled(chosen.Position))
	for _, limb := range limbs {
		if limb.parent.ID == chosen.ID {
			anchor := scaled(limb.joint.Anchor)
			c.shift(limb.cubes, minus(anchor, limb.joint.Anchor))
			c.find("joints", limb.joint.ID)["anchor"] = placed(anchor)
		}
	}
	c.stand()
	return true
}

// movePart shifts a limb over the cube that it hangs on, or turns it about its joint.
func (c *cubeChange) movePart() bool {
	limbs := limbsOf(c.before)
	if len(limbs) == 0 {
		return false
	}
	limb := oneOf(c.draw, limbs)
	var drawn Vector
	if c.draw.Chance(0.5) {
		for k := range drawn {
			drawn[k] = c.draw.Normal(0.15)
		}
		drawn = times(drawn, limb.parent.Size)
		if c.planar {
			drawn[2] = 0
		}
		by := rotate(limb.parent.Quaternion, drawn)
		c.shift(limb.cubes, by)
		c.find("joints", limb.joint.ID)["anchor"] = placed(plus(limb.joint.Anchor, by))
	} else {
		for k := range drawn {
			if k == 2 || !c.planar {
				drawn[k] = c.draw.Normal(0.3)
			}
		}
		c.turn(limb, fromEuler(drawn[0], drawn[1], drawn[2]))
	}
	c.stand()
	return true
}

// turn turns a limb about the anchor by which it hangs.
func (c *cubeChange) turn(limb limb, turn Quaternion) {
	pivot := limb.joint.Anchor
	turned := func(point Vector) array { return placed(plus(pivot, rotate(turn, minus(point, pivot)))) }
	for _, cube := range c.before.Cubes {
		if limb.cubes[cube.ID] {
			entry, rotation := c.find("cubes", cube.ID), multiply(turn, cube.Quaternion)
			entry["position"], entry["rotation"] = turned(cube.Position), anyOf(rotation[:])
		}
	}
	for i := range c.before.Joints {
		joint := &c.before.Joints[i]
		if limb.cubes[joint.Cube1] && limb.cubes[joint.Cube2] {
			entry := c.find("joints", joint.ID)
			entry["anchor"] = turned(joint.Anchor)
			aim(entry, joint, func(axis Vector) Vector { return rotate(turn, axis) })
		}
	}
}

// aim turns a joint's axis, which may be that of its kind; that of a cone leads from cube to cube by itself.
func aim(entry object, joint *Joint, turned func(Vector) Vector) {
	axis, there := defaultAxes[joint.Type]
	if joint.Axis != nil {
		axis = *joint.Axis
	} else if !there || joint.Type == "conetwist" {
		return
	}
	entry["axis"] = placed(turned(axis))
}

// symmetry gives a limb a mirror image, across a middle plane of the cube that it hangs on.
func (c *cubeChange) symmetry() bool {
	limbs := limbsOf(c.before)
	if len(limbs) == 0 {
		return false
	}
	limb := oneOf(c.draw, limbs)
	var unit Vector
	if c.planar {
		unit[c.draw.Count(0, 1)] = 1
	} else {
		unit[oneOf(c.draw, []int{2, 2, 0, 1})] = 1
	}
	normal := rotate(limb.parent.Quaternion, unit)
	if c.count("cubes")+len(limb.cubes) > mostCubes || 2*c.count("joints") > mostJoints {
		return false
	}
	mirrored := func(vector Vector) Vector {
		twice := float64(2.0 * dot(vector, normal))
		return minus(vector, times(Vector{twice, twice, twice}, normal))
	}
	opposite := func(vector Vector) Vector {
		image := mirrored(vector)
		return Vector{-image[0], -image[1], -image[2]}
	}
	centre := limb.parent.Position
	image := func(point Vector) array { return placed(plus(centre, mirrored(minus(point, centre)))) }
	names := map[string]string{limb.parent.ID: limb.parent.ID}
	for _, cube := range c.before.Cubes {
		if limb.cubes[cube.ID] {
			names[cube.ID] = c.fresh(mirrorName(cube.ID))
			q := cube.Quaternion
			turn := opposite(Vector{q[0], q[1], q[2]}) // the axis of a turn is one that a mirror turns round
			entry := maps.Clone(c.find("cubes", cube.ID))
			entry["id"], entry["position"] = names[cube.ID], image(cube.Position)
			entry["rotation"] = array{turn[0], turn[1], turn[2], q[3]}
			c.append("cubes", entry)
		}
	}
	for i := range c.before.Joints {
		joint := &c.before.Joints[i]
		cube1, first := names[joint.Cube1]
		cube2, second := names[joint.Cube2]
		if !first || !second || !limb.cubes[joint.Cube1] && !limb.cubes[joint.Cube2] {
			continue
		}
		entry := maps.Clone(c.find("joints", joint.ID))
		entry["id"] = c.fresh(mirrorName(joint.ID))
		// A hinge's axis is that of a turn, which a mirror turns round: then both sides move as mirror images.
		if joint.Type == "hinge" {
			aim(entry, joint, opposite)
		} else {
			aim(entry, joint, mirrored)
		}
		entry["cube1"], entry["cube2"], entry["anchor"] = cube1, cube2, image(joint.Anchor)
		c.append("joints", entry)
	}
	c.stand()
	return true
}

func mirrorName(id string) string {
	name := id + ".mirror"
	return name[:min(len(name), 64)]
}
