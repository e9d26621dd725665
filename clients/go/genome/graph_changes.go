package genome

import (
	"fmt"
	"slices"
)

const (
	mostParts, mostConnections = 64, 256
	mostTimes                  = 8 // how often a part is grown, at most
)

// palette has colours for parts that are given none, in turn.
var palette = []array{
	{0.36, 0.55, 0.75}, {0.85, 0.62, 0.31}, {0.45, 0.65, 0.45}, {0.72, 0.42, 0.42}, {0.58, 0.49, 0.7},
}

// graphChange is one change of a graph of parts; body is what it grows into. The kinds are those of K. Sims, "Evolving
// Virtual Creatures" (SIGGRAPH 1994).
type graphChange struct {
	graph  object
	body   *Body
	draw   *Draw
	planar bool
}

func (c *graphChange) change(kind string) bool {
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
	case "recursion":
		return c.recursion()
	}
	var jointed []object
	for _, part := range c.parts() {
		if has(part, "joint") {
			jointed = append(jointed, part)
		}
	}
	if len(jointed) == 0 {
		return false
	}
	part := oneOf(c.draw, jointed)
	return (&jointChange{part["joint"].(object), c.draw, c.body.Mass(), longest(part), c.planar}).change(kind)
}

func (c *graphChange) parts() []object       { return objects(c.graph, "parts") }
func (c *graphChange) connections() []object { return objects(c.graph, "connections") }

func (c *graphChange) append(kind string, entry object) {
	c.graph[kind] = append(list(c.graph, kind), entry)
}

func longest(part object) float64 {
	size := edgesOf(part)
	return max(size[0], size[1], size[2])
}

func (c *graphChange) faces() []string {
	if c.planar {
		return faces[:4]
	}
	return faces
}

// fresh returns an id that no part has: part, with the lowest free number.
func (c *graphChange) fresh() string {
	ids := fieldsOf(c.parts(), "id")
	for number := 1; ; number++ {
		if id := fmt.Sprintf("part%d", number); !slices.Contains(ids, id) {
			return id
		}
	}
}

// connection draws where a part grows on another.
func (c *graphChange) connection(parent, child string) object {
	d := c.draw
	at := array{rounded(d.Uniform(-0.8, 0.8), 6), 0.0}
	if !c.planar {
		at[1] = rounded(d.Uniform(-0.8, 0.8), 6)
	}
	connection := object{"from": parent, "to": child, "face": oneOf(d, c.faces()), "at": at}
	if d.Chance(0.3) {
		connection["rotation"] = c.rotation([]float64{0, 0, 0}, 0.5)
	}
	if d.Chance(0.4) {
		planes := []string{"z", "z", "x", "y"}
		if c.planar {
			planes = []string{"x", "y"}
		}
		connection["mirror"] = oneOf(d, planes)
	}
	return connection
}

func (c *graphChange) rotation(angles []float64, spread float64) array {
	turned := array{}
	for _, angle := range angles {
		turned = append(turned, rounded(min(max(angle+c.draw.Normal(spread), -3.2), 3.2), 6))
	}
	if c.planar {
		turned[0], turned[1] = 0.0, 0.0
	}
	return turned
}

// joint gives a part a joint where it has none; whether or not, one is drawn.
func (c *graphChange) joint(part object) {
	setDefault(part, "joint", drawJoint(c.draw, c.body.Mass(), longest(part), c.planar))
}

// addPart lets a new part grow on one that is there, or one that is there on another.
func (c *graphChange) addPart() bool {
	if len(c.connections()) >= mostConnections {
		return false
	}
	parts := c.parts()
	parent := oneOf(c.draw, parts)
	var child object
	if len(parts) < mostParts && c.draw.Chance(0.85) {
		size := edgesOf(parent)
		for k := range size {
			size[k] = edge(float64(size[k] * c.draw.Uniform(0.3, 1.1)))
		}
		child = object{"id": c.fresh(), "size": anyOf(size[:]), "density": number(parent, "density", 500)}
		c.joint(child)
		if has(parent, "color") {
			child["color"] = slices.Clone(palette[len(parts)%len(palette)])
		}
		c.append("parts", child)
	} else {
		child = oneOf(c.draw, parts)
		c.joint(child)
	}
	c.append("connections", c.connection(text(parent, "id", ""), text(child, "id", "")))
	return true
}

// removePart takes a connection away or, rather, a part with all that leads to it; and what no longer grows.
func (c *graphChange) removePart() bool {
	connections := list(c.graph, "connections")
	others := slices.DeleteFunc(fieldsOf(c.parts(), "id"), func(id string) bool { return id == c.graph["root"] })
	if len(connections) == 0 || len(others) == 0 {
		return false
	}
	if c.draw.Chance(0.3) {
		c.graph["connections"] = removed(connections, oneOf(c.draw, connections))
	} else {
		gone := oneOf(c.draw, others)
		c.keep("parts", func(part object) bool { return part["id"] != gone })
		c.keep("connections", func(each object) bool { return each["from"] != gone && each["to"] != gone })
	}
	c.prune()
	return true
}

func (c *graphChange) keep(kind string, kept func(object) bool) {
	c.graph[kind] = slices.DeleteFunc(list(c.graph, kind), func(entry any) bool { return !kept(entry.(object)) })
}

// prune takes away the parts that nothing leads to from the root, and their connections.
func (c *graphChange) prune() {
	root := text(c.graph, "root", "")
	reached := map[string]bool{root: true}
	for waiting := []string{root}; len(waiting) > 0; waiting = waiting[1:] {
		for _, each := range c.connections() {
			if to := text(each, "to", ""); each["from"] == waiting[0] && !reached[to] {
				reached[to] = true
				waiting = append(waiting, to)
			}
		}
	}
	c.keep("parts", func(part object) bool { return reached[text(part, "id", "")] })
	c.keep("connections", func(each object) bool { return reached[text(each, "from", "")] })
}

// resizePart changes the edges of a part, all alike or one by one, or what it weighs.
func (c *graphChange) resizePart() bool {
	d, part := c.draw, oneOf(c.draw, c.parts())
	if d.Chance(0.15) {
		part["density"] = rounded(min(max(float64(number(part, "density", 500)*d.Factor(0.3)), 50), 5000), 3)
		return true
	}
	whole, size := d.Factor(0.25), edgesOf(part)
	for k := range size {
		factor := whole
		if !d.Chance(0.5) {
			factor = d.Factor(0.25)
		}
		size[k] = edge(float64(size[k] * factor))
	}
	if has(part, "shape") {
		size = fit(text(part, "shape", ""), size)
	}
	part["size"] = anyOf(size[:])
	return true
}

// movePart changes where a part grows on another: the face, the place on it, its direction or its scale.
func (c *graphChange) movePart() bool {
	if len(c.connections()) == 0 {
		return false
	}
	d, connection := c.draw, oneOf(c.draw, c.connections())
	switch weighted(d, []string{"at", "rotation", "face", "scale"}, []float64{0.4, 0.3, 0.15, 0.15}) {
	case "face":
		connection["face"] = oneOf(d, c.faces())
	case "scale":
		connection["scale"] = rounded(min(max(float64(number(connection, "scale", 1)*d.Factor(0.15)), 0.3), 3), 6)
	case "rotation":
		angles := []float64{0, 0, 0}
		if three := list(connection, "rotation"); len(three) == 3 {
			angles = numbers(three)
		}
		connection["rotation"] = c.rotation(angles, 0.3)
	case "at":
		at := []float64{0, 0}
		if has(connection, "at") {
			at = numbers(list(connection, "at"))
		}
		for i := range at {
			at[i] = rounded(min(max(at[i]+d.Normal(0.25), -1), 1), 6)
		}
		if c.planar {
			at[1] = 0
		}
		connection["at"] = anyOf(at)
	}
	return true
}

// symmetry lets what grows at a connection be mirrored, or no longer, or across another plane.
func (c *graphChange) symmetry() bool {
	if len(c.connections()) == 0 {
		return false
	}
	connection := oneOf(c.draw, c.connections())
	if has(connection, "mirror") && c.draw.Chance(0.6) {
		delete(connection, "mirror")
		return true
	}
	planes := []string{"x", "y", "z"}
	if c.planar {
		planes = planes[:2]
	}
	connection["mirror"] = oneOf(c.draw, planes)
	return true
}

// recursion changes how often a part is grown on itself, and what grows at the end of the chain alone.
func (c *graphChange) recursion() bool {
	part := oneOf(c.draw, c.parts())
	id := text(part, "id", "")
	var others []object
	itself := false
	for _, each := range c.connections() {
		switch {
		case each["from"] == id && each["to"] == id:
			itself = true
		case each["from"] == id:
			others = append(others, each)
		}
	}
	if itself && c.draw.Chance(0.2) && len(others) > 0 {
		connection := oneOf(c.draw, others)
		terminal, _ := connection["terminal"].(bool)
		connection["terminal"] = !terminal
		return true
	}
	wanted := limitOf(part) + oneOf(c.draw, []int{-1, 1})
	if wanted < 1 || wanted > mostTimes {
		return false
	}
	part["recursive_limit"] = float64(wanted)
	if wanted > 1 && !itself {
		if len(c.connections()) >= mostConnections {
			return false
		}
		c.joint(part)
		c.append("connections", c.connection(id, id))
	}
	return true
}
