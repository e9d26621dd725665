package main

import (
	"bytes"
	"encoding/json"
	"fmt"
	"math"
)

// Point is how the original tells a place of a planet.
type Point struct {
	X float64 `json:"x"`
	Y float64 `json:"y"`
	Z float64 `json:"z"`
}

func (p Point) vector() Vector { return Vector{p.X, p.Y, p.Z} }

// Planet is all that the original tells of a planet.
type Planet struct {
	Position          Point
	Seed              int32
	Name              string
	ResourceLocations []Point
	TreeLocations     []Point
	BiomeType         int
}

// planetReader reads all planets into a type that has no other fields, and sees that cubes fall towards the nearest.
func planetReader() Message {
	c := dial(*port)
	defer c.close()
	c.tell(Message{"type": "get_planets"})
	decoder := json.NewDecoder(bytes.NewReader(c.read()))
	decoder.DisallowUnknownFields()
	planets := map[string][]Planet{}
	must(decoder.Decode(&planets))
	expect(len(planets) == 27, "there are %d planets", len(planets))
	seeds := map[int32]bool{}
	for x := 0; x < 3; x++ {
		for y := 0; y < 3; y++ {
			for z := 0; z < 3; z++ {
				name := fmt.Sprintf("(%d, %d, %d)", x, y, z)
				expect(len(planets[name]) == 1, "there are %d planets called %s", len(planets[name]), name)
				planet := planets[name][0]
				checkPlanet(planet, name, Vector{800 * float64(x), 800 * float64(y), 800 * float64(z)})
				seeds[planet.Seed] = true
			}
		}
	}
	expect(len(seeds) == 27, "27 planets have %d seeds", len(seeds))
	for _, start := range []Vector{{0, 130, 0}, {0, -130, 0}, {930, 0, 0}, {670, 800, 1600}, {390, 0, 0}, {410, 0, 0}} {
		checkFall(c, start, nearest(planets, start))
	}
	return Message{"planets": len(planets), "seeds": len(seeds)}
}

func checkPlanet(planet Planet, name string, place Vector) {
	expect(planet.Name == name, "planet %s is called %s", name, planet.Name)
	expect(planet.Position.vector() == place, "planet %s is at %v", name, planet.Position)
	expect(len(planet.ResourceLocations) == 20, "planet %s has %d resources", name, len(planet.ResourceLocations))
	expect(len(planet.TreeLocations) == 10, "planet %s has %d trees", name, len(planet.TreeLocations))
	for _, location := range append(planet.ResourceLocations, planet.TreeLocations...) {
		length := location.vector().length()
		expect(math.Abs(length-0.5) < 1e-6, "planet %s has something %g from its centre", name, length)
	}
}

func nearest(planets map[string][]Planet, place Vector) Vector {
	var found Vector
	distance := math.Inf(1)
	for _, group := range planets {
		if there := group[0].Position.vector(); there.distance(place) < distance {
			found, distance = there, there.distance(place)
		}
	}
	return found
}

// checkFall drops a cube, and expects it to be as fast as 9.8 m/s^2 makes it, towards the centre of its planet.
func checkFall(c *Client, start, centre Vector) {
	c.tell(Message{"type": "spawn_cube", "position": start})
	c.wait(0.5)
	state := c.own()
	away := start.minus(centre)
	fallen := -dot(state.Velocity, away) / away.length()
	across := state.Velocity.plus(away.times(fallen / away.length())).length()
	expect(across < 0.01*fallen, "a cube at %v falls sideways: %v", start, state.Velocity)
	deep := start.distance(state.Position)
	// From rest v^2 = 2 g s; damping takes a little of it, and so does a clock that does not stand still.
	expect(math.Abs(fallen*fallen/(2*9.8*deep)-1) < 0.1, "at %v a cube is %g m/s fast after %g m", start, fallen, deep)
}
