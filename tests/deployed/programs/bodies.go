package main

import (
	"fmt"
	"math"
)

const gap = 1.1 // m, from the middle of a cube to that of the next

// pole stands four cubes on a frozen one, joined by hinges whose motors hold still from the first moment on, and pushes
// the topmost: without the motors it would lie over.
func pole() Message {
	c := dial(*port)
	defer c.close()
	c.tell(Message{"type": "spawn_cube", "cube_name": "pole_0", "position": Vector{0, 101, 0}, "is_base": true})
	below := "pole_0_BASE"
	for n := 1; n < 5; n++ {
		name, height := fmt.Sprintf("pole_%d", n), 101+gap*float64(n)
		c.tell(Message{"type": "spawn_cube", "cube_name": name, "position": Vector{0, height, 0}})
		c.join("hinge", below, name, Vector{0, height - gap/2, 0}, Message{
			"joint_params": Message{"motor_enable": 1.0, "motor_target_velocity": 0.0, "motor_max_impulse": 100.0},
		})
		below = name
	}
	c.tell(Message{"type": "apply_force", "cube_name": below, "force": Vector{0.05, 0, 0}})
	c.wait(5)
	top := c.state(below)
	sunk := 101 + 4*gap - top.Position[1]
	expect(sunk < 0.1, "the top of the pole sank by %.2f m", sunk)
	expect(math.Abs(top.Position[0]) < 0.5, "the top of the pole leans by %.2f m", top.Position[0])
	return Message{"sunk": sunk, "leans": top.Position[0]}
}

// sliderSnake joins six cubes by sliders of which it says nothing, and pulls the head away: a slider ends after 1 m.
func sliderSnake() Message {
	c := dial(*port)
	defer c.close()
	names := row(c, "snake", 6)
	for n := 1; n < len(names); n++ {
		c.join("slider", names[n-1], names[n], Vector{gap * (float64(n) - 0.5), 130, 0}, nil)
	}
	longest, moved := pull(c, names)
	expect(longest < 5, "two neighbours in the snake were %.2f m apart", longest)
	expect(longest > gap+0.5, "two neighbours in the snake were never more than %.2f m apart", longest)
	return Message{"longest": longest, "moved": moved}
}

// bones hangs a cube on a frozen one, from its side, by a bone of which it says nothing: it swings down by 45 degrees.
func bones() Message {
	c := dial(*port)
	defer c.close()
	c.tell(Message{"type": "spawn_cube", "cube_name": "hip", "position": Vector{0, 120, 0}, "is_base": true})
	c.tell(Message{"type": "spawn_cube", "cube_name": "leg", "position": Vector{gap, 120, 0}})
	c.ask(Message{"type": "create_bone", "cube1": "hip_BASE", "cube2": "leg", "snake_id": 7}, "bone_created", nil)
	c.wait(3)
	swung := math.Asin((120 - c.state("leg").Position[1]) / (gap / 2))
	expect(math.Abs(swung-math.Pi/4) < 0.1, "the bone swung by %.2f rad", swung)
	return Message{"swung": swung}
}

// chain joins a row of cubes by one command, reads no answer to it, and pulls its head.
func chain() Message {
	c, link := dial(*port), dial(*port)
	defer c.close()
	defer link.close()
	names := row(c, "chain", 6)
	other := []string{"far_0", "far_1"}
	for n, name := range other {
		c.tell(Message{"type": "spawn_cube", "cube_name": name, "position": Vector{0, 130, 20 + gap*float64(n)}})
	}
	c.names()
	link.tell(Message{
		"type": "link_cube_chains", "chains": [][]string{names, other}, "joint_type": "pin",
		"joint_params": Message{"damping": 1.0},
	})
	for n, name := range append(names, other...) {
		neighbours := 2
		if n == 0 || n >= len(names)-1 {
			neighbours = 1
		}
		c.until(fmt.Sprintf("%s has %d joints", name, neighbours), func() bool { return len(c.joints(name)) == neighbours })
	}
	joints := c.joints(names[0])
	expect(joints[0] == "joint_pin_chain_0_chain_1", "the first joint of the chain is called %s", joints[0])
	longest, moved := pull(c, names)
	expect(longest < 5, "two neighbours in the chain were %.2f m apart", longest)
	strayed := math.Abs(c.state("far_0").Position[0])
	expect(strayed < 0.1, "pulling one chain moved the other by %.2f m", strayed)
	return Message{"longest": longest, "moved": moved}
}

// body joins those cubes that touch, of all whose names begin alike, by one command, and pulls one of them.
func body() Message {
	c, link := dial(*port), dial(*port)
	defer c.close()
	defer link.close()
	names := []string{"body_0", "body_1", "body_2", "body_3"}
	places := []Vector{{0, 130, 0}, {1.02, 130, 0}, {2.04, 130, 0}, {2.04, 131.02, 0}, {0, 140, 0}, {0, 131.02, 0}}
	for n, name := range append(names, "body_far", "other") {
		c.tell(Message{"type": "spawn_cube", "cube_name": name, "position": places[n]})
	}
	c.names()
	link.tell(Message{"type": "link_body_cubes", "prefix": "body_", "joint_type": "hinge", "joint_params": Message{
		"motor_enable": 1.0, "motor_target_velocity": 0.0, "motor_max_impulse": 100.0,
	}})
	for _, name := range names {
		c.until(name+" is joined", func() bool { return len(c.joints(name)) > 0 })
	}
	for _, name := range []string{"body_far", "other"} {
		joints := c.joints(name)
		expect(len(joints) == 0, "%s has the joints %v", name, joints)
	}
	longest, moved := pull(c, names)
	expect(longest < 5, "two cubes of the body were %.2f m apart", longest)
	strayed := math.Abs(c.state("body_far").Position[0])
	expect(strayed < 0.1, "pulling the body moved a cube that is none of it by %.2f m", strayed)
	return Message{"longest": longest, "moved": moved}
}

// row spawns cubes beside each other, high above the first planet.
func row(c *Client, prefix string, count int) []string {
	names := []string{}
	for n := 0; n < count; n++ {
		names = append(names, fmt.Sprintf("%s_%d", prefix, n))
		c.tell(Message{"type": "spawn_cube", "cube_name": names[n], "position": Vector{gap * float64(n), 130, 0}})
	}
	return names
}

// pull pushes the first cube away from the others for two seconds of their fall; it returns how far neighbours then
// were from each other at most, and how far the last went. All must have gone along. By the clock a cube is looked at a
// little later than its neighbour, and has moved on.
func pull(c *Client, names []string) (longest, moved float64) {
	start := c.state(names[len(names)-1]).Position[0]
	for n := 0; n < 20; n++ {
		c.tell(Message{"type": "apply_force", "cube_name": names[0], "force": Vector{-3, 0, 0}})
		c.wait(0.1)
		places := []Vector{}
		for _, name := range names {
			places = append(places, c.state(name).Position)
		}
		for m := 1; m < len(places); m++ {
			longest = math.Max(longest, places[m].distance(places[m-1]))
		}
		moved = start - places[len(places)-1][0]
	}
	expect(moved > 3, "the last cube went along by only %.2f m", moved)
	return longest, moved
}
