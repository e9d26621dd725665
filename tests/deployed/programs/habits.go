package main

import (
	"encoding/json"
	"fmt"
	"math"
	"strings"
)

const high = 300.0 // m; so that nothing lands while a program looks at it, however slow the machine is

// blindBuilder spawns ten cubes without names and takes the last ten of the list for them, in that order. A force
// without a name is for the last of them. A cube that is a base hangs in the air until it is let go by its longer name.
func blindBuilder() Message {
	c := dial(*port)
	defer c.close()
	for n := 0; n < 10; n++ {
		c.tell(Message{"type": "spawn_cube", "position": Vector{float64(3 * n), high, 0}})
	}
	names := c.names()
	expect(len(names) >= 10, "of ten cubes the list has %v", names)
	names = names[len(names)-10:]
	for n, name := range names {
		x := c.state(name).Position[0]
		expect(math.Abs(x-float64(3*n)) < 1, "cube %d of the list, %s, is at x = %g", n, name, x)
	}

	c.tell(Message{"type": "apply_force", "force": Vector{0, 0, 5}})
	c.wait(0.1)
	pushed, other := c.own(), c.state(names[8])
	expect(pushed.Name == names[9], "the cube of this connection is %s, not %s", pushed.Name, names[9])
	expect(pushed.Velocity[2] > 2, "a force of 5 on 1 kg made a speed of %g m/s", pushed.Velocity[2])
	expect(math.Abs(other.Velocity[2]) < 0.1, "%s was pushed as well", other.Name)

	for _, name := range names {
		c.tell(Message{"type": "despawn_cube", "cube_name": name})
	}
	c.tell(Message{"type": "spawn_cube", "cube_name": "tower", "position": Vector{0, 120, 0}, "is_base": true})
	left := c.names()
	expect(left[len(left)-1] == "tower_BASE", "the base is called %s", left[len(left)-1])
	c.wait(0.3)
	expect(c.own().Position == Vector{0, 120, 0}, "the base went to %v", c.own().Position)
	c.tell(Message{"type": "freeze_cube", "cube_name": "tower_BASE", "freeze": false})
	c.until("the base falls", func() bool { return c.state("tower_BASE").Position[1] < 119.5 })
	return Message{"speed": pushed.Velocity[2]}
}

// waitingBuilder never looks for the delimiter: it reads until nothing comes for a while, which for the commands that
// are not answered is all that it ever does.
func waitingBuilder() Message {
	c := dial(*port)
	defer c.close()
	silences := 0
	for _, command := range []Message{
		{"type": "spawn_cube", "cube_name": "walker", "position": Vector{0, high, 0}},
		{"type": "freeze_cube", "cube_name": "walker", "freeze": true},
		{"type": "freeze_cube", "cube_name": "walker", "freeze": false},
		{"type": "apply_force", "cube_name": "walker", "force": Vector{3, 0, 0}},
		{"type": "apply_physics", "cube_name": "walker", "impulse": Vector{0, 0, 2}},
		{"type": "apply_physics", "cube_name": "walker", "central_impulse": Vector{0, 0, 2}},
	} {
		c.tell(command)
		came := c.readOut()
		expect(len(came) == 0, "%v was answered by %s", command, came)
		silences++
	}
	var list struct{ Cubes []string }
	c.askOut(Message{"type": "get_cube_list"}, &list)
	expect(len(list.Cubes) == 1 && list.Cubes[0] == "walker", "the cubes are %v", list.Cubes)
	c.wait(tick)
	var state State
	c.askOut(Message{"type": "get_cube_state"}, &state)
	along, across := state.Velocity[0], state.Velocity[2]
	expect(along > 1 && across > 1, "after pushes of 3 along x and twice 2 along z it moves by %v", state.Velocity)
	c.tell(Message{"type": "despawn_cube", "cube_name": "walker"})
	came := c.readOut()
	expect(len(came) == 0, "despawn_cube was answered by %s", came)
	return Message{"silences": silences + 1, "along": along, "across": across}
}

// askOut reads, in its way, until what it has is an answer.
func (c *Client) askOut(command Message, answer any) {
	c.tell(command)
	came := ""
	for n := 0; n < 100; n++ {
		came = strings.TrimSuffix(came+string(c.readOut()), delimiter)
		if json.Unmarshal([]byte(came), answer) == nil {
			return
		}
	}
	expect(false, "%v was answered by %q", command, came)
}

// caller opens a connection for each thing that it says, and closes it after the answer, if one is due.
func caller() Message {
	call := func(use func(c *Client)) {
		c := dial(*port)
		defer c.close()
		use(c)
	}
	names := []string{"leg_0", "leg_1", "leg_2"}
	for n, name := range names {
		at := Vector{1.1 * float64(n), high, 0}
		call(func(c *Client) { c.tell(Message{"type": "spawn_cube", "cube_name": name, "position": at}) })
		call(func(c *Client) { c.until(name+" is there", func() bool { return c.has(name) }) })
	}
	for n := 1; n < len(names); n++ {
		at := Vector{1.1*float64(n) - 0.55, high, 0}
		call(func(c *Client) { c.join("hinge", names[n-1], names[n], at, nil) })
	}
	for _, name := range names {
		call(func(c *Client) {
			c.tell(Message{"type": "apply_force", "cube_name": name, "force": Vector{0, 0, 4}})
		})
	}
	slowest := math.Inf(1)
	for _, name := range names {
		call(func(c *Client) {
			c.wait(0.1)
			slowest = math.Min(slowest, c.state(name).Velocity[2])
		})
	}
	expect(slowest > 1, "of three cubes that were pushed by 4 the slowest moves at %g m/s", slowest)
	for _, name := range names {
		call(func(c *Client) { c.tell(Message{"type": "despawn_cube", "cube_name": name}) })
		call(func(c *Client) { c.until(name+" is gone", func() bool { return !c.has(name) }) })
	}
	return Message{"slowest": slowest}
}

// muteMotors builds an arm of five hinges, sets three parameters of each, and never reads the fifteen answers; what
// came of it another connection sees.
func muteMotors() Message {
	c, watch := dial(*port), dial(*port)
	defer c.close()
	defer watch.close()
	c.tell(Message{"type": "spawn_cube", "cube_name": "arm", "position": Vector{0, 120, 0}, "is_base": true})
	below, joints := "arm_BASE", []string{}
	for n := 1; n <= 5; n++ {
		name, height := fmt.Sprintf("arm_%d", n), 120+1.1*float64(n)
		c.tell(Message{"type": "spawn_cube", "cube_name": name, "position": Vector{0, height, 0}})
		joints = append(joints, c.join("hinge", below, name, Vector{0, height - 0.55, 0}, nil))
		below = name
	}
	for _, joint := range joints {
		for _, set := range []struct {
			name  string
			value float64
		}{{"motor_enable", 1.0}, {"motor_target_velocity", 0.2}, {"motor_max_impulse", 100.0}} {
			c.tell(Message{"type": "set_joint_param", "joint_name": joint, "param_name": set.name, "value": set.value})
		}
	}
	turned := 0.0
	watch.until("the arm turns by 0.5 rad", func() bool {
		turned = math.Abs(watch.state("arm_5").Rotation[2])
		return turned > 0.5
	})
	return Message{"turned": turned}
}

// scanner looks for worlds on ports that are 3 apart, and at the cubes in each.
func scanner() Message {
	worlds := 0
	for n := 0; n < *count; n++ {
		c := dial(*port + 3*n)
		c.names()
		c.close()
		worlds++
	}
	return Message{"worlds": worlds}
}
