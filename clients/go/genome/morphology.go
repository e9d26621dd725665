package genome

import (
	"fmt"
	"maps"
	"math"
	"slices"
)

const smallestEdge, largestEdge = 0.01, 10.0 // m: the edges of a cube, as the schema of genomes has them

var (
	eighth = math.Sqrt(0.5)
	// away is how a part is turned that grows straight away from a face: its +x is where the face looks to.
	away = map[string]Quaternion{
		"+x": upright,
		"-x": {0, 1, 0, 0},
		"+y": {0, 0, eighth, eighth},
		"-y": {0, 0, -eighth, eighth},
		"+z": {0, -eighth, 0, eighth},
		"-z": {0, eighth, 0, eighth},
	}
	defaultAxes = map[string]Vector{"hinge": {0, 0, 1}, "slide": {1, 0, 0}, "conetwist": {1, 0, 0}}
)

// grown is one cube: the number-th of its part, or that one's reflection, and the cube that its joint hangs on.
type grown struct {
	part     object
	scale    float64
	number   int
	mirrored bool
	parent   *grown

	position, anchor, axis Vector // in the frame of the part that grows now
	turn                   Quaternion
}

func (g *grown) id() string { return text(g.part, "id", "") }

func (g *grown) name() string {
	name := g.id()
	if g.number > 1 {
		name = fmt.Sprintf("%s.%d", name, g.number)
	}
	if g.mirrored {
		name += ".mirror"
	}
	return name
}

// joint is that by which it hangs on its parent, as its part has it.
func (g *grown) joint() object {
	if joint, there := g.part["joint"].(object); there {
		return joint
	}
	return object{"type": "fixed"}
}

// branch is cubes that grow together, the one on which all others grow first; last is the greatest number of each part.
type branch struct {
	cubes []*grown
	last  map[string]int
}

func (b *branch) shift(by Vector) {
	for _, cube := range b.cubes {
		cube.position, cube.anchor = plus(cube.position, by), plus(cube.anchor, by)
	}
}

// carry takes it to a frame in which this one's is shifted and turned.
func (b *branch) carry(by Vector, turn Quaternion) {
	for _, cube := range b.cubes {
		cube.position, cube.anchor, cube.axis = rotate(turn, cube.position), rotate(turn, cube.anchor), rotate(turn, cube.axis)
		cube.turn = multiply(turn, cube.turn)
	}
	b.shift(by)
}

// reflected returns the mirror image across the plane through the origin that an axis is normal to.
func (b *branch) reflected(axis int) *branch {
	images := map[*grown]*grown{}
	other := &branch{last: maps.Clone(b.last)}
	for _, cube := range b.cubes {
		image := *cube
		image.mirrored = !cube.mirrored
		image.position[axis] = -image.position[axis]
		image.anchor[axis] = -image.anchor[axis]
		// A hinge's axis is that of a turn, which a mirror turns round: then reflections move as mirror images.
		hinge := text(cube.joint(), "type", "") == "hinge"
		for k := range 3 {
			if k != axis {
				image.turn[k] = -image.turn[k]
			}
			if (k != axis) == hinge {
				image.axis[k] = -image.axis[k]
			}
		}
		images[cube] = &image
		other.cubes = append(other.cubes, &image)
	}
	for _, image := range other.cubes {
		image.parent = images[image.parent]
	}
	return other
}

// clashes returns the shifts of the numbers of its parts that make every name in both branches unique.
func (b *branch) clashes(beside *branch) map[string]int {
	type key struct {
		id       string
		number   int
		mirrored bool
	}
	taken := map[key]bool{}
	for _, cube := range beside.cubes {
		taken[key{cube.id(), cube.number, cube.mirrored}] = true
	}
	shifts := map[string]int{}
	for _, cube := range b.cubes {
		if taken[key{cube.id(), cube.number, cube.mirrored}] {
			shifts[cube.id()] = beside.last[cube.id()]
		}
	}
	return shifts
}

func (b *branch) renumber(shifts map[string]int) {
	for _, cube := range b.cubes {
		cube.number += shifts[cube.id()]
	}
	for part, shift := range shifts {
		b.last[part] += shift
	}
}

// add lets another branch grow on the first cube.
func (b *branch) add(other *branch) {
	other.cubes[0].parent = b.cubes[0]
	b.cubes = append(b.cubes, other.cubes...)
	for part, number := range other.last {
		b.last[part] = max(number, b.last[part])
	}
}

// grow returns the body of cubes and joints that a graph grows into, after K. Sims, "Evolving Virtual Creatures" (1994).
//
// It stops, with an error, before it has more cubes than a body may have, and at the first of a size that none may have.
func grow(graph object) (object, *DocumentError) {
	p := &plant{parts: map[string]object{}, growing: map[string][]object{}}
	if wrong := p.plan(graph); wrong != nil {
		return nil, wrong
	}
	whole, wrong := p.grow(text(graph, "root", ""), 1, map[string]int{})
	if wrong != nil {
		return nil, wrong
	}
	lowest := math.Inf(1)
	for _, cube := range whole.cubes {
		lowest = math.Min(lowest, cube.lowest())
	}
	whole.shift(Vector{0, -lowest, 0})
	cubes, joints := array{}, array{}
	for _, cube := range whole.cubes {
		cubes = append(cubes, cube.cubeDocument())
		if cube.parent != nil {
			joints = append(joints, cube.jointDocument())
		}
	}
	return object{"cubes": cubes, "joints": joints}, nil
}

// plant is one graph while it grows.
type plant struct {
	parts   map[string]object
	growing map[string][]object // connections by the part that they begin at
	count   int
}

// plan looks up what the graph names.
func (p *plant) plan(graph object) *DocumentError {
	var problems, again []Problem
	note := func(problems *[]Problem, path, format string, values ...any) {
		*problems = append(*problems, Problem{path, fmt.Sprintf(format, values...)})
	}
	var names []string
	for i, part := range objects(graph, "parts") {
		id := text(part, "id", "")
		if problem := misfit(text(part, "shape", "box"), edgesOf(part)); problem != "" {
			note(&problems, fmt.Sprintf("body/graph/parts/%d/size", i), "part %s: %s", quoted(id), problem)
		}
		if p.parts[id] == nil {
			names = append(names, id)
		} else {
			note(&again, fmt.Sprintf("body/graph/parts/%d/id", i), "there is a part %s already", quoted(id))
		}
		p.parts[id] = part
	}
	problems = append(problems, again...)
	nowhere := map[string][]string{}
	var unknown []string
	look := func(path, name string) {
		if p.parts[name] == nil {
			if nowhere[name] == nil {
				unknown = append(unknown, name)
			}
			nowhere[name] = append(nowhere[name], path)
		}
	}
	look("body/graph/root", text(graph, "root", ""))
	for i, connection := range objects(graph, "connections") {
		from := text(connection, "from", "")
		look(fmt.Sprintf("body/graph/connections/%d/from", i), from)
		look(fmt.Sprintf("body/graph/connections/%d/to", i), text(connection, "to", ""))
		p.growing[from] = append(p.growing[from], connection)
	}
	for _, name := range unknown {
		places := nowhere[name]
		note(&problems, places[0], "there is no part %s%s%s", quoted(name), norAt(places[1:]), didYouMean(name, names))
	}
	if len(problems) == 0 {
		return nil
	}
	return &DocumentError{problems[:min(len(problems), mostProblems+1)]}
}

// grow grows a part and all that grows on it, in the frame of the middle of its -x face; before says how often each part
// has been grown on the way here.
func (p *plant) grow(name string, scale float64, before map[string]int) (*branch, *DocumentError) {
	part := p.parts[name]
	if wrong := p.add(1, name); wrong != nil {
		return nil, wrong
	}
	way := maps.Clone(before)
	way[name]++
	if wrong := bound(part, scale, way[name]); wrong != nil {
		return nil, wrong
	}
	var half Vector
	for k, edge := range edgesOf(part) {
		half[k] = float64(edge*scale) / 2
	}
	middle := Vector{half[0], 0, 0}
	cube := &grown{part: part, scale: scale, number: 1, position: middle, turn: upright, axis: Vector{1, 0, 0}}
	joint := cube.joint()
	if axis, there := joint["axis"].(array); there {
		cube.axis = vectorOf(axis)
	} else if axis, there := defaultAxes[text(joint, "type", "")]; there {
		cube.axis = axis
	}
	whole := &branch{[]*grown{cube}, map[string]int{name: 1}}
	ended := way[name] >= limitOf(part)
	for _, connection := range p.growing[name] {
		child := text(connection, "to", "")
		terminal, _ := connection["terminal"].(bool)
		if way[child] >= limitOf(p.parts[child]) || terminal && !ended {
			continue
		}
		branched, wrong := p.grow(child, float64(scale*number(connection, "scale", 1)), way)
		if wrong != nil {
			return nil, wrong
		}
		at, turn := attached(connection, half)
		branched.carry(at, turn) // now as seen from the middle of this part
		sides := []*branch{branched}
		if mirror := text(connection, "mirror", ""); mirror != "" {
			if wrong := p.add(len(branched.cubes), name); wrong != nil {
				return nil, wrong
			}
			sides = append(sides, branched.reflected(int(mirror[0]-'x')))
		}
		shifts := branched.clashes(whole) // for both sides, so that a reflection has the number of what it reflects
		for _, side := range sides {
			side.renumber(shifts)
			if side != branched {
				side.renumber(side.clashes(whole))
			}
			side.shift(middle)
			whole.add(side)
		}
	}
	return whole, nil
}

func limitOf(part object) int { return whole(part, "recursive_limit", 1) }

func (p *plant) add(count int, name string) *DocumentError {
	p.count += count
	if p.count <= mostCubes {
		return nil
	}
	words := "grows into more than %d cubes, by way of part %s: lower a recursive_limit"
	return refused("body/graph", fmt.Sprintf(words, mostCubes, quoted(name)))
}

// bound refuses a cube of a size that none may have, before more grows on it.
func bound(part object, scale float64, times int) *DocumentError {
	size := edgesOf(part)
	var edges []float64
	for _, edge := range size {
		edges = append(edges, noMinus(rounded(float64(edge*scale), 9)))
	}
	worst := slices.Min(edges)
	if slices.Max(edges) > largestEdge {
		worst = slices.Max(edges)
	}
	if smallestEdge <= worst && worst <= largestEdge {
		return nil
	}
	words := "grows part %s, %d times over, to an edge of %s m; it must be from %s to %s m"
	id := quoted(text(part, "id", ""))
	return refused("body/graph", fmt.Sprintf(words, id, times, shorter(worst), short(smallestEdge), short(largestEdge)))
}

// attached returns where a connection attaches, from the middle of the parent, and how the child is turned there.
func attached(connection object, half Vector) (Vector, Quaternion) {
	face := text(connection, "face", "")
	normal := int(face[1] - 'x')
	var at Vector
	at[normal] = half[normal]
	if face[0] == '-' {
		at[normal] = -half[normal]
	}
	parts := []float64{0, 0}
	if items, there := connection["at"].(array); there {
		parts = numbers(items)
	}
	for k := range 3 {
		if k != normal {
			at[k] = float64(parts[0] * half[k])
			parts = parts[1:]
		}
	}
	return at, multiply(away[face], quaternionOf(connection["rotation"]))
}

func (g *grown) size() Vector {
	size := edgesOf(g.part)
	for k := range size {
		size[k] = float64(size[k] * g.scale)
	}
	return size
}

func (g *grown) lowest() float64 {
	reach := 0.0
	for k, edge := range edgesOf(g.part) {
		var axis Vector
		axis[k] = 1
		reach += float64(math.Abs(rotate(g.turn, axis)[1]) * (float64(edge*g.scale) / 2))
	}
	return g.position[1] - reach
}

func (g *grown) cubeDocument() object {
	size := g.size()
	shape, density := text(g.part, "shape", "box"), number(g.part, "density", 500)
	mass := float64(float64(float64(density*size[0])*size[1]) * size[2])
	if shape != "box" {
		mass = float64(density * volume(shape, size))
	}
	cube := object{
		"id":       g.name(),
		"size":     roundedAll(size[:]),
		"mass":     rounded(mass, 9),
		"position": roundedAll(g.position[:]),
		"rotation": roundedAll(g.turn[:]),
	}
	for _, name := range []string{"shape", "friction", "restitution", "color", "group"} {
		if has(g.part, name) {
			cube[name] = g.part[name]
		}
	}
	return cube
}

func (g *grown) jointDocument() object {
	document, scale := g.joint(), g.scale
	kind := text(document, "type", "")
	joint := object{
		"id":     g.name(),
		"cube1":  g.parent.name(),
		"cube2":  g.name(),
		"type":   kind,
		"anchor": roundedAll(g.anchor[:]),
	}
	if _, there := defaultAxes[kind]; there {
		joint["axis"] = roundedAll(g.axis[:])
	}
	// Positions of a slide are lengths. Efforts go with weight (and, about a hinge, with the arm), so that what is grown
	// at another scale can move itself as well.
	length, effort := 1.0, fourth(scale)
	if kind == "slide" {
		length, effort = scale, third(scale)
	}
	scaled := func(ends array) array {
		var values []float64
		for _, end := range numbers(ends) {
			values = append(values, float64(length*end))
		}
		return roundedAll(values)
	}
	if has(document, "limits") {
		joint["limits"] = scaled(list(document, "limits"))
	}
	for _, name := range []string{"stiffness", "damping"} {
		if has(document, name) {
			joint[name] = rounded(float64(effort*number(document, name, 0)), 9)
		}
	}
	if motor, there := document["motor"].(object); there {
		grown := object{
			"mode":       motor["mode"],
			"range":      scaled(list(motor, "range")),
			"max_effort": rounded(float64(effort*number(motor, "max_effort", 0)), 9),
		}
		if has(motor, "flaws") {
			grown["flaws"] = motor["flaws"]
		}
		joint["motor"] = grown
	}
	return joint
}

// noMinus makes 0 of -0: in documents they are one.
func noMinus(value float64) float64 { return value + 0.0 }

func roundedAll(values []float64) array {
	result := make(array, len(values))
	for i, value := range values {
		result[i] = noMinus(rounded(value, 9))
	}
	return result
}

// third and fourth are powers to the last bit, but for one in many thousands: of the square, what a double lacks is kept.

func third(x float64) float64 {
	square := float64(x * x)
	lacks, cube := math.FMA(x, x, -square), float64(square*x)
	return cube + (math.FMA(square, x, -cube) + float64(lacks*x))
}

func fourth(x float64) float64 {
	square := float64(x * x)
	lacks, result := math.FMA(x, x, -square), float64(square*square)
	return result + (math.FMA(square, square, -result) + float64(float64(2*lacks)*square))
}
