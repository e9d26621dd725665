package genome

import (
	"fmt"
	"math"
	"slices"
	"strings"
)

const (
	touching     = 1e-4 // m that cubes may overlap, and reach into the ground, by rounding
	mostHints    = 5    // problems with suggestions
	mostReadings = 4096
	mostRays     = 1024
	mostCubes    = 256
	mostJoints   = 512
	mostSensors  = 1024
	mostVoices   = 128
)

// Body is a creature's body at rest: cubes and joints in the document's order, those of a graph in the order in which
// it grows.
type Body struct {
	Cubes       []Cube
	Joints      []Joint
	Sensors     []Sensor
	Voices      []Voice
	Later       []string // the ids of the cubes that are not there at birth
	Development []Rule
}

// Cube is a box, or what fills it: m, kg. A nil Friction is the ground's, a nil Restitution the world's.
type Cube struct {
	ID          string
	Shape       string
	Size        Vector
	Mass        float64
	Position    Vector
	Quaternion  Quaternion
	Friction    *float64
	Restitution *float64
}

// Joint joins two cubes. A nil Axis is its type's own; Motor is nil where it has none.
type Joint struct {
	ID, Cube1, Cube2   string
	Type               string
	Anchor             Vector
	Axis               *Vector
	Limits             *[2]float64
	Stiffness, Damping float64
	Motor              *Motor
}

// Motor is that of a hinge or slide: controls from -1 to 1 are from Low to High.
type Motor struct {
	Mode      string
	Low, High float64
	MaxEffort float64
}

// Voice is one number that a creature says on a channel.
type Voice struct {
	ID, Channel string
	Number      int
}

// Inputs returns the names of the sensors, in the order of a brain's inputs.
func (b *Body) Inputs() []string { return namesOf(b.Sensors, func(s Sensor) string { return s.ID }) }

// Outputs returns the names of the motors and then of the voices, in the order of controls.
func (b *Body) Outputs() []string {
	var names []string
	for _, joint := range b.Joints {
		if joint.Motor != nil {
			names = append(names, joint.ID)
		}
	}
	return append(names, namesOf(b.Voices, func(v Voice) string { return v.ID })...)
}

// Mass returns that of all cubes, kg.
func (b *Body) Mass() float64 {
	total := 0.0
	for _, cube := range b.Cubes {
		total += cube.Mass
	}
	return total
}

// Bounds returns the lowest and the highest corner of the box around it, m.
func (b *Body) Bounds() (Vector, Vector) {
	low, high := Vector{math.Inf(1), math.Inf(1), math.Inf(1)}, Vector{math.Inf(-1), math.Inf(-1), math.Inf(-1)}
	for i := range b.Cubes {
		for _, corner := range cornersOf(&b.Cubes[i]) {
			for k, part := range corner {
				low[k], high[k] = math.Min(low[k], part), math.Max(high[k], part)
			}
		}
	}
	return low, high
}

// size returns the longest edge of the box around it, m.
func (b *Body) size() float64 {
	low, high := b.Bounds()
	edges := minus(high, low)
	return max(edges[0], edges[1], edges[2])
}

// planar tells whether it lies in the plane z = 0 and moves in it.
func (b *Body) planar() bool {
	for _, cube := range b.Cubes {
		if cube.Position[2] != 0 || cube.Quaternion[0] != 0 || cube.Quaternion[1] != 0 {
			return false
		}
	}
	for _, joint := range b.Joints {
		axis := joint.Axis
		switch joint.Type {
		case "hinge":
			if axis != nil && (axis[0] != 0 || axis[1] != 0) {
				return false
			}
		case "slide":
			if axis != nil && axis[2] != 0 {
				return false
			}
		case "conetwist":
			return false
		}
	}
	return true
}

func (b *Body) cube(id string) *Cube {
	return &b.Cubes[slices.IndexFunc(b.Cubes, func(cube Cube) bool { return cube.ID == id })]
}

func namesOf[T any](items []T, name func(T) string) []string {
	names := make([]string, len(items))
	for i, item := range items {
		names[i] = name(item)
	}
	return names
}

func cubeID(cube Cube) string    { return cube.ID }
func jointID(joint Joint) string { return joint.ID }

func driven(kind string) bool { return kind == "hinge" || kind == "slide" }

// joins tells whether a joint is one of a cube; other returns the cube at its other end.
func (j *Joint) joins(cube string) bool { return j.Cube1 == cube || j.Cube2 == cube }
func (j *Joint) other(cube string) string {
	if j.Cube1 == cube {
		return j.Cube2
	}
	return j.Cube1
}

// -- reading ---------------------------------------------------------------------------------------------------------

// sources are the parts of a document of which a body is read; its schema has accepted them.
type sources struct {
	cubes, joints []object
	sensors       []object // nil for those that a body has by default
	voices        []object
	later         []string
	development   []object
	place         string   // what to blame for cubes and joints; "" where they stand in the document themselves
	absent        []string // the ids of cubes and joints that were left out, * for one whose id is not known
}

// reader reads one body, and notes its problems: one more than are told, and no others.
type reader struct {
	sources
	problems []Problem
}

// readBody returns a body and all that is wrong with it; the body is nil where that is more than is told.
func readBody(from sources) (*Body, []Problem) {
	r := &reader{sources: from}
	body := r.body()
	if len(r.later) > 0 && len(r.absent) == 0 {
		r.readLater(body)
	}
	if len(r.development) > 0 && len(r.absent) == 0 {
		found, rules := readRules(r.development, body)
		r.problems = append(r.problems, found...)
		body.Development = rules
	}
	body.Later = r.later
	if len(r.problems) > mostProblems {
		return nil, r.problems[:mostProblems+1]
	}
	return body, r.problems
}

func (r *reader) note(path, format string, values ...any) {
	if len(r.problems) > mostProblems {
		return
	}
	if r.place != "" && strings.HasPrefix(path, "body/") {
		path = r.place
	}
	r.problems = append(r.problems, Problem{path, fmt.Sprintf(format, values...)})
}

func (r *reader) mayBeAbsent(pattern string) bool {
	return slices.ContainsFunc(r.absent, func(name string) bool { return name == "*" || fits(pattern, name) })
}

// hint returns a suggestion, with the first problems only: each name may be held against hundreds.
func (r *reader) hint(name string, known []string) string {
	if len(r.problems) >= mostHints {
		return ""
	}
	return didYouMean(name, known)
}

func (r *reader) body() *Body {
	body := &Body{}
	for _, entry := range r.cubes {
		body.Cubes = append(body.Cubes, readCube(entry))
	}
	cubes := namesOf(body.Cubes, cubeID)
	r.unique(func(i int) string { return fmt.Sprintf("body/cubes/%d/id", i) }, cubes, "cube")
	for i, cube := range body.Cubes {
		if problem := misfit(cube.Shape, cube.Size); problem != "" {
			r.note(fmt.Sprintf("body/cubes/%d/size", i), "cube %s: %s", quoted(cube.ID), problem)
		}
	}
	for _, entry := range r.joints {
		body.Joints = append(body.Joints, readJoint(entry))
	}
	r.unique(func(i int) string { return fmt.Sprintf("body/joints/%d/id", i) }, namesOf(body.Joints, jointID), "joint")
	for i := range body.Joints {
		r.joint(&body.Joints[i], fmt.Sprintf("body/joints/%d", i))
	}
	r.structure(body, cubes)
	for i, b := range boxesOf(body.Cubes) {
		lowest := b.centre[1]
		sum := 0.0
		for k := range 3 {
			sum += float64(b.halves[k] * math.Abs(b.axes[k][1]))
		}
		if lowest -= sum; lowest < -touching {
			words := "%s reaches %s m below the ground, y = 0"
			r.note(fmt.Sprintf("body/cubes/%d/position", i), words, quoted(cubes[i]), shorter(-lowest))
		}
	}
	r.readSensors(body)
	r.readVoices(body)
	return body
}

func (r *reader) readSensors(body *Body) {
	entries, rays := r.sensors, 0
	if entries == nil {
		entries = defaultSensors(body)
	}
	var paths []string
	for i, entry := range entries {
		path := fmt.Sprintf("sensors/%d", i)
		single := readSensor(entry, path, body, r)
		body.Sensors = append(body.Sensors, single...)
		paths = append(paths, slices.Repeat([]string{path}, len(single))...)
		if len(body.Sensors) > mostReadings {
			r.note(path, "with it there are over %s single readings", thousands(mostReadings))
			break
		}
		for _, sensor := range single {
			if sensor.ray {
				rays++
			}
		}
		if rays > mostRays {
			r.note(path, "with it there are over %s rays of cameras and range finders", thousands(mostRays))
			break
		}
	}
	r.unique(func(i int) string { return paths[i] }, body.Inputs(), "sensor")
}

func (r *reader) readVoices(body *Body) {
	for _, entry := range r.voices {
		channel, number := text(entry, "channel", ""), whole(entry, "number", 1)
		body.Voices = append(body.Voices, Voice{text(entry, "id", heard("say", channel, number)), channel, number})
	}
	path := func(i int) string { return fmt.Sprintf("voices/%d", i) }
	said := namesOf(body.Voices, func(v Voice) string { return fmt.Sprintf("%s %d", v.Channel, v.Number) })
	r.unique(path, said, "voice on channel and number")
	for i, voice := range body.Voices {
		if slices.ContainsFunc(body.Joints, func(joint Joint) bool { return joint.ID == voice.ID }) {
			r.note(path(i), "there is a joint %s, and both would be outputs of the brain", quoted(voice.ID))
		}
	}
	r.unique(path, namesOf(body.Voices, func(v Voice) string { return v.ID }), "voice")
}

// heard returns the name of a number of a channel: the first is called like the channel itself.
func heard(name, channel string, number int) string {
	if number == 1 {
		return name + "." + channel
	}
	return fmt.Sprintf("%s.%s.%d", name, channel, number)
}

func (r *reader) unique(path func(int) string, ids []string, what string) {
	seen := map[string]bool{}
	for i, id := range ids {
		if seen[id] {
			r.note(path(i), "there is a %s %s already", what, quoted(id))
		}
		seen[id] = true
	}
}

// joint notes problems of one joint by itself.
func (r *reader) joint(joint *Joint, path string) {
	who, kind := "joint "+quoted(joint.ID), joint.Type
	if !driven(kind) {
		only := func(there bool, name, what string) {
			if there {
				r.note(path+"/"+name, "%s is a %s; only a hinge or a slide can have %s", who, kind, what)
			}
		}
		only(joint.Motor != nil, "motor", "a motor")
		only(joint.Stiffness != 0, "stiffness", "stiffness")
		only(joint.Damping != 0, "damping", "damping")
	}
	if joint.Limits != nil {
		low, high := joint.Limits[0], joint.Limits[1]
		switch path := path + "/limits"; {
		case kind == "fixed" || kind == "pin":
			r.note(path, "%s is a %s, which has no limits", who, kind)
		case kind == "conetwist":
			if min(low, high) < 0 {
				r.note(path, "the swing and twist of %s must not be negative", who)
			}
		case low > high:
			r.note(path, "the lower limit of %s, %s, is above the upper, %s", who, short(low), short(high))
		case !(low <= 0 && 0 <= high):
			words := "the limits of %s, %s to %s, exclude 0, the position in which it is built"
			r.note(path, words, who, short(low), short(high))
		}
	}
	if motor := joint.Motor; motor != nil && motor.Low == motor.High {
		words := "both ends of the motor of %s are %s: it could do nothing"
		r.note(path+"/motor/range", words, who, short(motor.Low))
	}
}

// pair is two names in order: what a joint joins.
type pair [2]string

func pairOf(one, other string) pair { return pair{min(one, other), max(one, other)} }

// structure notes joints that lead nowhere, and cubes that no joint ties to the rest.
func (r *reader) structure(body *Body, names []string) {
	leader := map[string]string{}
	for _, name := range names {
		leader[name] = name
	}
	find := func(name string) string {
		for leader[name] != name {
			leader[name] = leader[leader[name]]
			name = leader[name]
		}
		return name
	}
	known := func(name string) bool { _, there := leader[name]; return there }
	joined, nowhere := map[pair]string{}, map[string][]string{}
	var unknown []string
	for i := range body.Joints {
		joint, path := &body.Joints[i], fmt.Sprintf("body/joints/%d", i)
		for end, name := range []string{joint.Cube1, joint.Cube2} {
			if !known(name) && !r.mayBeAbsent(name) {
				if nowhere[name] == nil {
					unknown = append(unknown, name)
				}
				nowhere[name] = append(nowhere[name], fmt.Sprintf("%s/cube%d", path, end+1))
			}
		}
		ends := pairOf(joint.Cube1, joint.Cube2)
		switch by, already := joined[ends]; {
		case joint.Cube1 == joint.Cube2:
			r.note(path+"/cube2", "joint %s joins %s to itself", quoted(joint.ID), quoted(joint.Cube1))
		case already:
			r.note(path, "%s and %s are joined by %s already", quoted(joint.Cube1), quoted(joint.Cube2), quoted(by))
		case known(joint.Cube1) && known(joint.Cube2):
			joined[ends] = joint.ID
			leader[find(joint.Cube2)] = find(joint.Cube1)
		}
	}
	for _, name := range unknown {
		places := nowhere[name]
		r.note(places[0], "there is no cube %s%s%s", quoted(name), norAt(places[1:]), r.hint(name, names))
	}
	if len(r.absent) > 0 {
		return
	}
	pairs, spared, wrong := map[pair]bool{}, map[string]bool{}, 0
	for _, joint := range body.Joints {
		pairs[pairOf(joint.Cube1, joint.Cube2)] = true
		if !known(joint.Cube1) || !known(joint.Cube2) { // what it should join is not known
			wrong++
			spared[joint.Cube1], spared[joint.Cube2] = true, true
		}
	}
	r.loose(names, find, wrong)
	r.overlaps(body.Cubes, pairs, spared)
}

// loose notes cubes that no joint ties to the first, unless there are joints with wrong names enough to tie all.
func (r *reader) loose(names []string, find func(string) string, wrong int) {
	var loose []string
	groups := map[string]bool{}
	for _, name := range names {
		if find(name) != find(names[0]) {
			loose = append(loose, name)
			groups[find(name)] = true
		}
	}
	if len(groups) <= wrong {
		return
	}
	for i, name := range names {
		if !slices.Contains(loose, name) || find(name) != name {
			continue
		}
		var others []string
		for _, other := range loose {
			if find(other) == name && other != name {
				others = append(others, other)
			}
		}
		withThem := ""
		if len(others) > 0 {
			withThem = fmt.Sprintf(" (nor are %s, joined to it)", quotedAll(others))
		}
		r.note(fmt.Sprintf("body/cubes/%d", i), "%s is not joined to the rest of the body%s", quoted(name), withThem)
	}
}

// overlaps notes cubes that overlap, but for the pairs that are joined, and for those in which one is spared.
func (r *reader) overlaps(cubes []Cube, pairs map[pair]bool, spared map[string]bool) {
	boxes := boxesOf(cubes)
	for i := range cubes {
		for j := i + 1; j < len(cubes); j++ {
			one, other := cubes[i].ID, cubes[j].ID
			if !near(&boxes[i], &boxes[j]) || pairs[pairOf(one, other)] || spared[one] || spared[other] {
				continue
			}
			if deep := depth(&boxes[i], &boxes[j]); deep > touching {
				words := "%s and %s overlap by %s m, and no joint joins them"
				r.note(fmt.Sprintf("body/cubes/%d", j), words, quoted(one), quoted(other), shorter(deep))
			}
		}
	}
}

// readLater notes what is wrong with the parts that are not there at birth.
func (r *reader) readLater(body *Body) {
	known, root := namesOf(body.Cubes, cubeID), body.Cubes[0].ID
	sorted := slices.Compact(slices.Sorted(slices.Values(known)))
	for i, name := range r.later {
		if !slices.Contains(known, name) {
			r.note(fmt.Sprintf("later/%d", i), "there is no cube %s%s", quoted(name), r.hint(name, sorted))
		}
	}
	if at := slices.Index(r.later, root); at >= 0 {
		r.note(fmt.Sprintf("later/%d", at), "%s is the root, on which all others hang", quoted(root))
		return
	}
	if len(r.problems) > 0 {
		return
	}
	there := reached(body, r.later)
	for i, name := range known {
		if !there[name] && !slices.Contains(r.later, name) {
			words := "%s is there at birth, and what it hangs on is later"
			r.note(fmt.Sprintf("body/cubes/%d", i), words, quoted(name))
		}
	}
}

// reached returns the cubes that hang together with the root without some others.
func reached(body *Body, without []string) map[string]bool {
	root := body.Cubes[0].ID
	there, fresh := map[string]bool{root: true}, []string{root}
	for len(fresh) > 0 {
		at := fresh[0]
		fresh = fresh[1:]
		for i := range body.Joints {
			joint := &body.Joints[i]
			if !joint.joins(at) {
				continue
			}
			if other := joint.other(at); !there[other] && !slices.Contains(without, other) {
				there[other] = true
				fresh = append(fresh, other)
			}
		}
	}
	return there
}

func readCube(entry object) Cube {
	cube := Cube{
		ID:         text(entry, "id", ""),
		Shape:      text(entry, "shape", "box"),
		Size:       edgesOf(entry),
		Mass:       number(entry, "mass", 0),
		Position:   vectorOf(list(entry, "position")),
		Quaternion: quaternionOf(entry["rotation"]),
	}
	for name, own := range map[string]**float64{"friction": &cube.Friction, "restitution": &cube.Restitution} {
		if has(entry, name) {
			value := number(entry, name, 0)
			*own = &value
		}
	}
	return cube
}

func readJoint(entry object) Joint {
	joint := Joint{
		ID:        text(entry, "id", ""),
		Cube1:     text(entry, "cube1", ""),
		Cube2:     text(entry, "cube2", ""),
		Type:      text(entry, "type", ""),
		Anchor:    vectorOf(list(entry, "anchor")),
		Stiffness: number(entry, "stiffness", 0),
		Damping:   number(entry, "damping", 0),
	}
	if has(entry, "axis") {
		axis := vectorOf(list(entry, "axis"))
		joint.Axis = &axis
	}
	if has(entry, "limits") {
		ends := numbers(list(entry, "limits"))
		joint.Limits = &[2]float64{ends[0], ends[1]}
	}
	if motor, there := entry["motor"].(object); there {
		ends := numbers(list(motor, "range"))
		joint.Motor = &Motor{text(motor, "mode", ""), ends[0], ends[1], number(motor, "max_effort", 0)}
	}
	return joint
}

// edgesOf returns the edges of a cube or a part of a graph, which may be told by one number.
func edgesOf(entry object) Vector {
	if edges, three := entry["size"].(array); three {
		return vectorOf(edges)
	}
	edge := number(entry, "size", 0)
	return Vector{edge, edge, edge}
}

func vectorOf(items array) Vector {
	parts := numbers(items)
	return Vector{parts[0], parts[1], parts[2]}
}

// quaternionOf returns the rotation of a document: three angles, four numbers, or nothing.
func quaternionOf(value any) Quaternion {
	items, there := value.(array)
	if !there {
		return upright
	}
	parts := numbers(items)
	if len(parts) == 3 {
		return fromEuler(parts[0], parts[1], parts[2])
	}
	return normalized(Quaternion{parts[0], parts[1], parts[2], parts[3]})
}
