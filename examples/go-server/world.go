package main

// The world: names, ownership, time, and what each command does.

import (
	"crypto/sha256"
	"encoding/binary"
	"fmt"
	"math"
	"sort"
	"strconv"
)

const (
	tickRate = 60
	substeps = 4
	mostTurn = 1e6 // rad or m, that a joint may be asked for
)

type reply map[string]any

type cube struct {
	*body
	name  string
	color []float64
}

type namedJoint struct {
	*joint
	name         string
	cube1, cube2 string
}

// World is one simulated place. Whoever calls it sees to it that nobody else does at the same time.
type World struct {
	name                  string
	seed                  int64
	mode                  string
	paused                bool
	frame                 int64
	cubes                 []*cube // in order of creation
	joints                []*namedJoint
	used                  map[string]bool // every name that a cube has or had
	cubeCount, jointCount int
	fault                 reply // nil while all is well
	clients               int
	mostCubes, mostJoints int
}

func (w *World) reset(seed int64) {
	w.seed, w.frame = seed, 0
	w.cubes, w.joints, w.used = nil, nil, map[string]bool{}
	w.cubeCount, w.jointCount, w.fault = 0, 0, nil
}

func (w *World) running() bool {
	return w.mode != "lockstep" && !w.paused && w.fault == nil
}

func (w *World) tick() {
	if w.fault != nil {
		return
	}
	bodies := make([]*body, len(w.cubes))
	for i, c := range w.cubes {
		bodies[i] = c.body
		c.velocity = c.velocity.add(c.speedOf(c.impulse))
		c.spin = c.spin.add(c.spinOf(c.angularImpulse))
	}
	joints := make([]*joint, len(w.joints))
	for i, j := range w.joints {
		joints[i] = j.joint
	}
	for i := 0; i < substeps; i++ {
		advance(bodies, joints, 1.0/(tickRate*substeps))
	}
	w.frame++
	for _, c := range w.cubes {
		c.force, c.torque, c.impulse, c.angularImpulse = Vec{}, Vec{}, Vec{}, Vec{}
		if !c.finite() && w.fault == nil {
			w.fault = reply{"code": "diverged", "frame": w.frame, "message": "cube " + c.name + " is nowhere any more"}
		}
	}
}

func (w *World) cube(name string) *cube {
	for _, c := range w.cubes {
		if c.name == name {
			return c
		}
	}
	return nil
}

func (w *World) names() []string {
	names := make([]string, len(w.cubes))
	for i, c := range w.cubes {
		names[i] = c.name
	}
	return names
}

// -- commands -----------------------------------------------------------------------------------------------------

type command struct {
	fields []field
	run    func(*World, *client, map[string]any) (reply, *failure)
	// silent says that the raw dialect leaves it unanswered, faulty that a faulted world still does it.
	silent, faulty bool
}

var motorFields = map[string]check{
	"motor_target_velocity": between(-1e5, 1e5),
	"motor_max_impulse":     between(0, 1e15),
	"motor_max_force":       between(0, 1e15),
	"motor_enabled":         boolean,
	"limit_lower":           between(-mostTurn, mostTurn),
	"limit_upper":           between(-mostTurn, mostTurn),
	"limit_enabled":         boolean,
}

// Of the parameters of joints, those that this server does not have.
var springFields = map[string]check{
	"target_position": between(-mostTurn, mostTurn),
	"stiffness":       between(0, 1e15),
	"damping":         between(0, 1e15),
}

// Commands of the protocol that this server does not have; silent ones are so here too.
var unsupported = map[string]bool{
	"apply_force": true, "freeze_cube": true, "batch": false, "create_bone": false, "drive": false,
	"get_camera": false, "get_cube_state": false, "get_joint_info": false, "get_joint_list": false,
	"get_planets": false, "get_world_state": false, "remove_joint": false, "sense": false, "set_cube_state": false,
	"set_mode": false, "set_objective": false, "compute_reward": false, "spawn_creature": false, "subscribe": false,
	"unsubscribe": false, "get_joints_for_cube": false, "link_body_cubes": false, "link_cube_chains": false,
	"set_color": true, "set_joint_params": false,
}

var capabilities = []string{
	"friction", "get_world_info", "joint.fixed", "joint.hinge", "joint.slide", "limits", "motor", "pause", "reset",
	"restitution", "resume", "step",
}

var commands map[string]command

func init() {
	joint := []field{
		{"cube1", true, name},
		{"cube2", true, name},
		{"joint_type", true, oneOf("fixed", "hinge", "slide", "slider", "pin", "conetwist")},
		{"position", false, vector(1e6)},
		{"axis", false, notZero(vector(1000))},
		{"limits", false, numbers(2, 2, between(-mostTurn, mostTurn))},
		{"joint_name", false, name},
		{"number_if_taken", false, boolean},
		{"notes", false, notes}, // without effect, and told by get_joint_info alone, which this server does not have
	}
	params := map[string]check{}
	for _, group := range []map[string]check{motorFields, springFields} {
		for _, key := range sorted(group) {
			joint = append(joint, field{key, false, group[key]})
			params[key] = group[key]
		}
	}
	joint = append(joint, field{"joint_params", false, object(params)})
	commands = map[string]command{
		"spawn_cube": {silent: true, run: (*World).spawnCube, fields: []field{
			{"cube_name", false, name},
			{"position", false, vector(1e6)},
			{"rotation", false, rotation},
			{"size", false, size},
			{"shape", false, oneOf("box", "sphere", "capsule", "cylinder")},
			{"mass", false, between(1e-6, 1e9)},
			{"friction", false, between(0, 10)},
			{"restitution", false, between(0, 1)},
			{"color", false, numbers(3, 4, between(0, 1))},
			{"is_base", false, boolean},
			{"linear_velocity", false, vector(1e5)},
			{"angular_velocity", false, vector(1e5)},
			{"list", false, boolean},
		}},
		"despawn_cube": {silent: true, run: (*World).despawnCube, fields: []field{{"cube_name", true, name}}},
		"create_joint": {run: (*World).createJoint, fields: joint},
		"set_joint_param": {run: (*World).setJointParam, fields: []field{
			{"joint_name", true, name},
			{"param_name", true, oneOf(append(sorted(motorFields), sorted(springFields)...)...)},
			{"value", true, func(any, string) *failure { return nil }},
		}},
		"apply_physics": {silent: true, run: (*World).applyPhysics, fields: []field{
			{"cube_name", false, name},
			{"force", false, vector(1e15)},
			{"torque", false, vector(1e15)},
			{"impulse", false, vector(1e15)},
			{"angular_impulse", false, vector(1e15)},
			{"at", false, vector(1e6)},
		}},
		"get_cube_list": {run: (*World).getCubeList},
		"get_cube_info": {run: (*World).getCubeInfo, fields: []field{
			{"cube_name", true, name},
			{"sensors", false, boolean},
			{"rays", false, func(value any, path string) *failure {
				items, isArray := value.([]any)
				if !isArray || len(items) > 64 {
					return invalid(path, "expected an array of at most 64 directions")
				}
				for i, item := range items {
					if wrong := notZero(vector(1000))(item, path+"/"+strconv.Itoa(i)); wrong != nil {
						return wrong
					}
				}
				return nil
			}},
			{"max_range", false, between(0.001, 1e6)},
		}},
		"get_world_info": {faulty: true, run: (*World).getWorldInfo},
		"ping": {faulty: true, run: func(*World, *client, map[string]any) (reply, *failure) {
			return reply{"type": "pong"}, nil
		}},
		"step": {run: (*World).step, fields: []field{{"ticks", false, wholeBetween(1, 10000)}}},
		"pause": {run: func(w *World, _ *client, _ map[string]any) (reply, *failure) {
			w.paused = true
			return reply{"type": "paused", "frame": w.frame}, nil
		}},
		"resume": {run: func(w *World, _ *client, _ map[string]any) (reply, *failure) {
			w.paused = false
			return reply{"type": "resumed", "frame": w.frame}, nil
		}},
		"reset": {faulty: true, run: (*World).resetCommand, fields: []field{{"seed", false, wholeBetween(0, math.MaxInt64)}}},
	}
}

func sorted(group map[string]check) []string {
	var keys []string
	for key := range group {
		keys = append(keys, key)
	}
	sort.Strings(keys)
	return keys
}

// execute does what a command asks for, or nothing; `silent` says that the raw dialect is not to be answered.
func (w *World) execute(c *client, given map[string]any) (answer reply, wrong *failure, silent bool) {
	kind, isString := given["type"].(string)
	if !isString {
		return nil, invalid("type", "expected a string"), false
	}
	todo, known := commands[kind]
	if theirs, there := originals[kind]; there && c.raw {
		todo = theirs
	}
	if silent, there := unsupported[kind]; !known && there {
		return nil, &failure{code: "unsupported", message: "this server does not have " + kind}, silent
	}
	if !known {
		return nil, &failure{"unknown_type", fmt.Sprintf("there is no command %.80q", kind), "type"}, false
	}
	if wrong := validate(given, todo.fields); wrong != nil {
		return nil, wrong, todo.silent
	}
	if w.fault != nil && !todo.faulty {
		wrong := &failure{code: "world_faulted", message: "the physics engine has failed; reset brings the world back"}
		return nil, wrong, todo.silent
	}
	answer, wrong = todo.run(w, c, given)
	return answer, wrong, todo.silent
}

func (w *World) spawnCube(c *client, given map[string]any) (reply, *failure) {
	if len(w.cubes) >= w.mostCubes {
		return nil, &failure{code: "limit_reached", message: fmt.Sprintf("the world holds %d cubes", w.mostCubes)}
	}
	isBase := given["is_base"] == true
	suffix := ""
	if isBase {
		suffix = "_BASE"
	}
	called, isNamed := given["cube_name"].(string)
	if isNamed {
		if isBase {
			if wrong := nameUpTo(128-len(suffix))(called, "cube_name"); wrong != nil {
				return nil, wrong
			}
		}
		called += suffix
		if w.used[called] {
			return nil, &failure{"cube_exists", "a cube has, or had, that name", "cube_name"}
		}
	}
	if shape, said := given["shape"].(string); said && shape != "box" {
		return nil, &failure{"unsupported", "all cubes of this server are boxes", "shape"}
	}
	for !isNamed || w.used[called] {
		w.cubeCount++
		drawn := sha256.Sum256(fmt.Appendf(nil, "%d cube %d", w.seed, w.cubeCount))
		called = fmt.Sprintf("cube_%d_%08x%s", w.cubeCount, binary.BigEndian.Uint32(drawn[:4]), suffix)
		isNamed = true
	}
	edge := float(given["size"], 1)
	edges := vec(given["size"], edge, edge, edge)
	mass := float(given["mass"], 1)
	squares := edges.each(edges)
	b := &body{
		position: vec(given["position"], 0, 1, 0),
		velocity: vec(given["linear_velocity"], 0, 0, 0),
		spin:     vec(given["angular_velocity"], 0, 0, 0),
		half:     edges.mul(0.5),
		mass:     mass,
		inertia:  Vec{squares[1] + squares[2], squares[0] + squares[2], squares[0] + squares[1]}.mul(mass / 12),
		friction: float(given["friction"], 1), restitution: float(given["restitution"], 0),
		frozen: isBase,
	}
	if turn := floats(given["rotation"], 0, 0, 0); len(turn) == 4 {
		b.rotation = Quat{turn[0], turn[1], turn[2], turn[3]}.unit()
	} else {
		b.rotation = fromEuler(turn[0], turn[1], turn[2])
	}
	if isBase {
		b.velocity, b.spin = Vec{}, Vec{}
	}
	color := floats(given["color"], 0.8, 0.8, 0.8)
	if len(color) == 3 {
		color = append(color, 1)
	}
	c.owned = &cube{b, called, color}
	w.cubes = append(w.cubes, c.owned)
	w.used[called] = true
	answer := reply{"type": "cube_list", "spawned": called}
	if given["list"] != false {
		answer["cubes"] = w.names()
	}
	return answer, nil
}

func (w *World) find(given map[string]any, key string) (*cube, *failure) {
	called, _ := given[key].(string)
	if c := w.cube(called); c != nil {
		return c, nil
	}
	return nil, &failure{"cube_not_found", fmt.Sprintf("there is no cube %q", called), key}
}

func (w *World) despawnCube(_ *client, given map[string]any) (reply, *failure) {
	gone, wrong := w.find(given, "cube_name")
	if wrong != nil {
		return nil, wrong
	}
	removed, kept := []string{}, []*namedJoint{}
	for _, j := range w.joints {
		if j.cube1 == gone.name || j.cube2 == gone.name {
			removed = append(removed, j.name)
		} else {
			kept = append(kept, j)
		}
	}
	w.joints = kept
	for i, c := range w.cubes {
		if c == gone {
			w.cubes = append(w.cubes[:i:i], w.cubes[i+1:]...)
			break
		}
	}
	return reply{"type": "cube_despawned", "cube_name": gone.name, "joints": removed}, nil
}

func (w *World) createJoint(_ *client, given map[string]any) (reply, *failure) {
	if given["cube1"] == given["cube2"] {
		return nil, &failure{"self_joint", "a cube cannot be joined to itself", "cube2"}
	}
	a, wrong := w.find(given, "cube1")
	if wrong != nil {
		return nil, wrong
	}
	b, wrong := w.find(given, "cube2")
	if wrong != nil {
		return nil, wrong
	}
	for _, j := range w.joints {
		if (j.cube1 == a.name && j.cube2 == b.name) || (j.cube1 == b.name && j.cube2 == a.name) {
			return nil, &failure{"joint_exists", "these cubes are joined by " + j.name, "cube2"}
		}
	}
	kind := given["joint_type"].(string)
	axis := vec(given["axis"], 0, 0, 1)
	switch kind {
	case "slide", "slider":
		kind, axis = "slide", vec(given["axis"], 1, 0, 0)
	case "pin", "conetwist":
		return nil, &failure{"unsupported", "this server has no joints of that type", "joint_type"}
	}
	if len(w.joints) >= w.mostJoints {
		return nil, &failure{code: "limit_reached", message: fmt.Sprintf("the world holds %d joints", w.mostJoints)}
	}
	called, wrong := w.jointName(given)
	if wrong != nil {
		return nil, wrong
	}
	params, _ := given["joint_params"].(map[string]any)
	middle := a.position.add(b.position).mul(0.5)
	made := newJoint(kind, a.body, b.body, vec(given["position"], middle[:]...), axis.unit())
	blamed := "limit_lower"
	if limits := floats(given["limits"]); limits != nil {
		blamed = "limits"
		made.lower, made.upper, made.limited = limits[0], limits[1], true
	}
	for _, group := range []map[string]check{motorFields, springFields} {
		for _, key := range sorted(group) {
			value, there := given[key]
			path := key
			if overriding, said := params[key]; said {
				value, there, path = overriding, true, "joint_params/"+key
			}
			if there {
				if wrong := made.set(key, value, path); wrong != nil {
					return nil, wrong
				}
			}
		}
	}
	for _, said := range []map[string]any{given, params} { // what is said outright counts
		if value, told := said["motor_enabled"].(bool); told {
			made.motor = value
		}
	}
	if wrong := made.check(blamed); wrong != nil {
		return nil, wrong
	}
	w.joints = append(w.joints, &namedJoint{made, called, a.name, b.name})
	return reply{"type": "joint_created", "joint_name": called}, nil
}

// jointName returns the name that a joint shall have: the one that is given, with a number if need be, or a drawn one.
func (w *World) jointName(given map[string]any) (string, *failure) {
	taken := map[string]bool{}
	for _, j := range w.joints {
		taken[j.name] = true
	}
	wanted, said := given["joint_name"].(string)
	if !said {
		for called := ""; ; {
			w.jointCount++
			if called = fmt.Sprintf("joint_%d", w.jointCount); !taken[called] {
				return called, nil
			}
		}
	}
	called := wanted
	for number := 2; taken[called]; number++ {
		if numbered, _ := given["number_if_taken"].(bool); !numbered {
			return "", &failure{"joint_exists", "there is a joint " + wanted, "joint_name"}
		}
		called = fmt.Sprintf("%s_%d", wanted, number)
	}
	return called, nil
}

// set sets one parameter, whose value is valid.
func (j *joint) set(key string, value any, path string) *failure {
	if _, isSpring := springFields[key]; isSpring {
		return &failure{"unsupported", "this server has neither servos nor springs", path}
	}
	if j.kind == "fixed" {
		return &failure{"unsupported", "a fixed joint has no " + key, path}
	}
	switch key {
	case "motor_target_velocity":
		j.target, j.motor = value.(number).value, true
	case "motor_max_impulse":
		j.strength = value.(number).value
	case "motor_max_force":
		j.strength = value.(number).value / (tickRate * substeps)
	case "motor_enabled":
		j.motor = value.(bool)
	case "limit_lower":
		j.lower = value.(number).value
	case "limit_upper":
		j.upper = value.(number).value
	case "limit_enabled":
		j.limited = value.(bool)
	}
	return nil
}

func (j *joint) check(path string) *failure {
	if j.limited && j.lower > j.upper {
		return invalid(path, "the lower limit is above the upper one")
	}
	return nil
}

func (w *World) setJointParam(_ *client, given map[string]any) (reply, *failure) {
	key, value := given["param_name"].(string), given["value"]
	if wrong := w.setParams(given["joint_name"], map[string]any{key: value}); wrong != nil {
		return nil, wrong
	}
	if n, isNumber := value.(number); isNumber {
		value = n.value
	}
	return reply{"type": "joint_param_set", "joint_name": given["joint_name"], "param_name": key, "value": value}, nil
}

// setParams sets parameters of a joint, all of them or none.
func (w *World) setParams(called any, params map[string]any) *failure {
	for key, value := range params {
		fits, isMotor := motorFields[key]
		if !isMotor {
			fits = springFields[key]
		}
		if fits == nil {
			return invalid("param_name", "there is no such parameter")
		}
		if wrong := fits(value, "value"); wrong != nil {
			return wrong
		}
	}
	for _, j := range w.joints {
		if j.name != called {
			continue
		}
		changed := *j.joint
		for key, value := range params {
			if wrong := changed.set(key, value, "param_name"); wrong != nil {
				return wrong
			}
		}
		if wrong := changed.check("value"); wrong != nil {
			return wrong
		}
		*j.joint = changed
		return nil
	}
	return &failure{"joint_not_found", "there is no such joint", "joint_name"}
}

func (w *World) applyPhysics(c *client, given map[string]any) (reply, *failure) {
	pushed := c.owned
	if _, told := given["cube_name"]; told {
		named, wrong := w.find(given, "cube_name")
		if wrong != nil {
			return nil, wrong
		}
		pushed = named
	} else if pushed == nil || w.cube(pushed.name) != pushed {
		return nil, &failure{code: "nothing_owned", message: "this connection has spawned no cube that is still there"}
	}
	arm := vec(given["at"], pushed.position[:]...).sub(pushed.position)
	if !pushed.frozen {
		pushed.push(vec(given["force"], 0, 0, 0), vec(given["torque"], 0, 0, 0), vec(given["impulse"], 0, 0, 0),
			vec(given["angular_impulse"], 0, 0, 0), arm)
	}
	return reply{"type": "physics_applied", "cube_name": pushed.name}, nil
}

func (w *World) getCubeList(*client, map[string]any) (reply, *failure) {
	return reply{"type": "cube_list", "cubes": w.names()}, nil
}

func (w *World) getCubeInfo(_ *client, given map[string]any) (reply, *failure) {
	c, wrong := w.find(given, "cube_name")
	if wrong != nil {
		return nil, wrong
	}
	for _, key := range []string{"sensors", "rays"} {
		if value, there := given[key]; there && value != false {
			return nil, &failure{"unsupported", "this server has no sensors", key}
		}
	}
	held := []string{}
	for _, j := range w.joints {
		if j.cube1 == c.name || j.cube2 == c.name {
			held = append(held, j.name)
		}
	}
	return reply{
		"type": "cube_info", "cube_name": c.name,
		"position": c.position, "rotation": c.body.rotation.euler(), "quaternion": c.body.rotation,
		"linear_velocity": c.velocity, "angular_velocity": c.spin,
		"size": c.half.mul(2), "mass": c.mass, "friction": c.friction, "restitution": c.restitution, "color": c.color,
		"frozen": c.frozen, "sleeping": false, "joints": held, "contacts": []any{},
	}, nil
}

func (w *World) getWorldInfo(*client, map[string]any) (reply, *failure) {
	var fault any
	if w.fault != nil {
		fault = w.fault
	}
	return reply{
		"type": "world_info", "world": w.name, "backend": "free-bodies",
		"versions": reply{"nmes": "none", "protocol": 1, "engine": "1"},
		"dims":     3, "seed": w.seed, "mode": w.mode, "rate": 1, "paused": w.paused,
		"config": reply{
			"name": w.name, "backend": "free-bodies", "seed": w.seed, "tick_rate": tickRate, "substeps": substeps,
			"gravity": gravity, "friction": 1, "restitution": 0,
		},
		"frame": w.frame, "t": w.time(),
		"counts":       reply{"cubes": len(w.cubes), "joints": len(w.joints), "clients": w.clients},
		"limits":       reply{"cubes": w.mostCubes, "joints": w.mostJoints},
		"capabilities": capabilities, "fault": fault,
	}, nil
}

func (w *World) time() float64 {
	return float64(w.frame) / tickRate
}

func (w *World) step(_ *client, given map[string]any) (reply, *failure) {
	if w.mode != "lockstep" && !w.paused {
		return nil, &failure{code: "wrong_mode", message: "the world ticks by itself: pause it"}
	}
	for i := 0; i < int(float(given["ticks"], 1)); i++ {
		if w.tick(); w.fault != nil {
			return nil, &failure{code: "world_faulted", message: fmt.Sprint(w.fault["message"])}
		}
	}
	return reply{"type": "stepped", "frame": w.frame, "t": w.time()}, nil
}

func (w *World) resetCommand(_ *client, given map[string]any) (reply, *failure) {
	seed := w.seed
	if n, told := given["seed"].(number); told {
		whole, err := strconv.ParseInt(n.text, 10, 64)
		if err != nil { // 1e3 and 1.0 are whole numbers too
			whole = int64(n.value)
		}
		seed = whole
	}
	w.reset(seed)
	return reply{"type": "world_reset", "frame": 0, "seed": w.seed}, nil
}
