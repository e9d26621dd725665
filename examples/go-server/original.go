package main

// The words of the original server, which the raw dialect speaks, of the commands that this server has.

import (
	"encoding/json"
	"fmt"
	"math"
	"unicode/utf8"
)

// originals are the commands that mean something else in the raw dialect.
var originals = map[string]command{
	"apply_physics": {silent: true, run: (*World).applyOriginalPhysics},
	"create_joint":  {run: (*World).createOriginalJoint},
	"set_joint_param": {run: (*World).setOriginalParam, fields: []field{
		{"joint_name", true, name},
		{"param_name", true, text(128)},
		{"value", true, func(any, string) *failure { return nil }},
	}},
}

// ours are our names of the original's parameters, where they are others.
var ours = map[string]string{
	"limit_enable": "limit_enabled", "motor_enable": "motor_enabled", "motor_max_impulse": "motor_max_force",
	"linear_limit_lower": "limit_lower", "linear_limit_upper": "limit_upper",
	"swing_span": "limit_lower", "twist_span": "limit_upper",
}

// alwaysInForce are the limits that need not be enabled.
var alwaysInForce = map[string]bool{
	"linear_limit_lower": true, "linear_limit_upper": true, "swing_span": true, "twist_span": true,
}

// withoutEffect are parameters that are taken, and no more: this server does not have get_joint_info, which tells them.
var withoutEffect = map[string]bool{
	"bias": true, "softness": true, "relaxation": true, "damping": true, "restitution": true, "impulse_clamp": true,
	"limit_bias": true, "limit_softness": true, "limit_relaxation": true,
	"angular_limit_lower": true, "angular_limit_upper": true,
}

func init() {
	for _, direction := range []string{"linear", "angular"} {
		for _, part := range []string{"limit", "motion", "ortho"} {
			for _, what := range []string{"softness", "restitution", "damping"} {
				withoutEffect[direction+"_"+part+"_"+what] = true
			}
		}
	}
}

// originalDefaults are the parameters of a joint of the original's, in our words, where they are not ours.
var originalDefaults = map[string]map[string]any{
	"hinge":  {"limit_lower": number{value: -math.Pi / 2}, "limit_upper": number{value: math.Pi / 2}},
	"slide":  {"limit_lower": number{value: -1}, "limit_upper": number{value: 1}, "limit_enabled": true},
	"slider": {"limit_lower": number{value: -1}, "limit_upper": number{value: 1}, "limit_enabled": true},
}

// originalParam returns what a parameter of the original's means: some of ours, or none.
func originalParam(key string, value any) map[string]any {
	if withoutEffect[key] {
		return nil
	}
	called, renamed := ours[key]
	if !renamed {
		called = key
	}
	if n, isNumber := value.(number); isNumber {
		switch called {
		case "motor_max_force":
			if key == "motor_max_impulse" {
				value = number{value: n.value * 60} // there an engine step took 1/60 s
			}
		case "limit_enabled", "motor_enabled":
			value = n.value != 0
		}
	}
	params := map[string]any{called: value}
	if alwaysInForce[key] {
		params["limit_enabled"] = true
	}
	return params
}

func (w *World) applyOriginalPhysics(c *client, said map[string]any) (reply, *failure) {
	if _, told := said["impulse"]; !told {
		if impulse, there := said["central_impulse"]; there {
			said["impulse"] = impulse
		}
	}
	return w.inOurWords("apply_physics", c, said)
}

func (w *World) createOriginalJoint(c *client, said map[string]any) (reply, *failure) {
	kind, _ := said["joint_type"].(string)
	params := map[string]any{}
	for key, value := range originalDefaults[kind] {
		params[key] = value
	}
	theirs, isObject := said["joint_params"].(map[string]any)
	for key, value := range theirs {
		for called, meant := range originalParam(key, value) {
			params[called] = meant
		}
	}
	if _, told := said["joint_params"]; isObject || !told {
		said["joint_params"] = params
	}
	called := fmt.Sprintf("joint_%v_%v_%v", said["joint_type"], said["cube1"], said["cube2"])
	if _, named := said["joint_name"]; !named && utf8.RuneCountInString(called) <= 128 {
		said["joint_name"] = called
	}
	said["number_if_taken"] = true
	return w.inOurWords("create_joint", c, said)
}

// inOurWords does a command that was translated.
func (w *World) inOurWords(kind string, c *client, given map[string]any) (reply, *failure) {
	if wrong := validate(given, commands[kind].fields); wrong != nil {
		return nil, wrong
	}
	return commands[kind].run(w, c, given)
}

// setOriginalParam answers as the original does: with the words of the command.
func (w *World) setOriginalParam(_ *client, said map[string]any) (reply, *failure) {
	key, value := said["param_name"].(string), said["value"]
	if wrong := w.setParams(said["joint_name"], originalParam(key, value)); wrong != nil {
		return nil, wrong
	}
	if n, isNumber := value.(number); isNumber {
		value = json.Number(n.text)
	}
	return reply{"type": "joint_param_set", "joint_name": said["joint_name"], "param_name": key, "value": value}, nil
}
