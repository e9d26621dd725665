package main

import (
	"encoding/json"
	"math"
	"sort"
)

// repeater says each of its `create_joint` twice, to be sure, and wants an answer to each.
func repeater() Message {
	c := dial(*port)
	defer c.close()
	for n, name := range []string{"upper", "lower"} {
		c.tell(Message{"type": "spawn_cube", "cube_name": name, "position": Vector{0, 121 - 1.1*float64(n), 0}})
	}
	first := c.join("hinge", "upper", "lower", Vector{0, 120.45, 0}, nil)
	second := c.join("hinge", "upper", "lower", Vector{0, 120.45, 0}, nil)
	expect(first == "joint_hinge_upper_lower", "the first joint is called %s", first)
	expect(second != first, "both joints are called %s", first)
	joints := c.joints("lower")
	expect(len(joints) == 2, "the cube has the joints %v", joints)
	c.tell(Message{"type": "apply_force", "cube_name": "upper", "force": Vector{3, 3, 0}})
	c.wait(0.5)
	apart := c.state("upper").Position.distance(c.state("lower").Position)
	expect(apart < 1.2, "the two cubes are %g m apart", apart)
	return Message{"joints": joints, "apart": apart}
}

// joints asks for the names of a cube's joints, sorted.
func (c *Client) joints(cube string) []string {
	var answer struct {
		Cube   string `json:"cube_name"`
		Joints []string
	}
	c.ask(Message{"type": "get_joints_for_cube", "cube_name": cube}, "joints_for_cube", &answer)
	expect(answer.Cube == cube, "asked for joints of %s it tells those of %s", cube, answer.Cube)
	sort.Strings(answer.Joints)
	return answer.Joints
}

// jointMaker makes one joint of each kind, under names of its own and with all parameters that there were, and speaks
// of them by these names. It colours what it made, and does not read what is said to that.
func jointMaker() Message {
	c := dial(*port)
	defer c.close()
	kinds := []struct {
		kind   string
		params Message
	}{
		{"hinge", Message{
			"limit_enable": 1.0, "limit_upper": 0.5, "limit_lower": -0.5, "limit_bias": 0.3, "limit_softness": 0.9,
			"limit_relaxation": 1.0, "bias": 0.3, "motor_enable": 1.0, "motor_target_velocity": 3.0,
			"motor_max_impulse": 100.0,
		}},
		{"slider", Message{
			"linear_limit_upper": 0.5, "linear_limit_lower": -0.5, "linear_limit_softness": 1.0,
			"linear_limit_restitution": 0.7, "linear_limit_damping": 1.0,
		}},
		{"conetwist", Message{"swing_span": 0.5, "twist_span": 0.5, "bias": 0.3, "softness": 0.8, "relaxation": 1.0}},
		{"pin", Message{"bias": 0.3, "damping": 1.0, "impulse_clamp": 0.0}},
	}
	for n, kind := range kinds {
		base, cube := kind.kind+"_BASE", kind.kind+"_2"
		at := Vector{5 * float64(n), 120, 0}
		c.tell(Message{"type": "spawn_cube", "cube_name": kind.kind, "position": at, "is_base": true})
		c.tell(Message{"type": "spawn_cube", "cube_name": cube, "position": at.plus(Vector{1.1, 0, 0})})
		name := c.join(kind.kind, base, cube, at.plus(Vector{0.55, 0, 0}), Message{
			"joint_name": "my_" + kind.kind, "joint_params": kind.params,
		})
		expect(name == "my_"+kind.kind, "the joint my_%s is called %s", kind.kind, name)
		joints := c.joints(cube)
		expect(len(joints) == 1 && joints[0] == "my_"+kind.kind, "cube %s has the joints %v", cube, joints)
	}
	c.until("the hinge's motor turns it up to its limit", func() bool {
		return c.state("hinge_2").Rotation[2] > 0.45
	})
	c.wait(3)
	turned := c.state("hinge_2").Rotation[2]
	expect(turned < 0.6, "the hinge turned by %g rad over its limit of 0.5", turned)
	// The planet's centre is not straight below these two: the slider slides towards it, and the cone falls.
	slid := 5 + 1.1 - c.state("slider_2").Position[0]
	expect(math.Abs(slid-0.5) < 0.1, "the slider with a limit of 0.5 m slid by %g m", slid)
	swung := math.Asin((120 - c.state("conetwist_2").Position[1]) / 0.55)
	expect(math.Abs(swung-0.5) < 0.1, "the cone with a span of 0.5 rad swung by %g rad", swung)

	c.tell(Message{
		"type": "set_joint_params", "joint_name": "my_hinge",
		"params": Message{"limit_enable": 0.0, "motor_target_velocity": -3.0},
	})
	var answer struct{ Type string }
	must(json.Unmarshal(c.read(), &answer))
	expect(answer.Type != "error", "set_joint_params was answered by an error")
	c.until("the hinge turns past its limits", func() bool { return c.state("hinge_2").Rotation[2] < -1 })
	c.ask(Message{
		"type": "set_joint_param", "joint_name": "my_hinge", "param_name": "motor_target_velocity", "value": 0.0,
	}, "joint_param_set", nil)
	c.tell(Message{"type": "set_color", "cube_name": "hinge_2", "hex": "#FFFF00"})
	return Message{"turned": turned, "slid": slid, "swung": swung}
}
