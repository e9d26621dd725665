package genome

import (
	"fmt"
	"slices"
	"strings"
)

// Sensor is one reading of a body.
type Sensor struct {
	ID     string // unique in the body
	Type   string
	Of     string // joint or cube
	Target string // the id of that
	ray    bool   // whether it sends one, as each pixel of a camera does once
}

var (
	ofJoint = []string{"position", "velocity", "effort"}
	ofCube  = []string{
		"height", "up", "velocity", "spin", "touch", "target_direction", "target_distance", "target_velocity",
		"other_direction", "other_distance", "other_velocity", "hear", "food_direction", "food_distance",
		"acceleration", "range", "camera", "food_smell", "other_smell", "target_smell",
	}
	vectors = []string{
		"up", "velocity", "spin", "target_direction", "target_velocity", "other_direction", "other_velocity",
		"food_direction", "acceleration",
	}
	ofOthers   = []string{"other_direction", "other_distance", "other_velocity"}
	ofFood     = []string{"food_direction", "food_distance"}
	smells     = []string{"food_smell", "other_smell", "target_smell"}
	surrounded = append([]string{"acceleration", "range", "camera"}, smells...)
	rootSenses = []string{"height", "up", "velocity", "spin"}
)

// sensorFields are the fields that only some types of sensors have, and which these are.
var sensorFields = []struct {
	name   string
	owners []string
}{
	{"axis", vectors},
	{"range", slices.Concat(ofOthers, []string{"range", "camera"}, smells)},
	{"channel", []string{"hear"}},
	{"number", []string{"hear"}},
	{"face", []string{"touch"}},
	{"direction", []string{"range", "camera"}},
	{"width", []string{"camera"}},
	{"height", []string{"camera"}},
	{"fov", []string{"camera"}},
	{"colors", []string{"camera"}},
}

// defaultSensors returns those that a body has whose document names none.
func defaultSensors(body *Body) []object {
	entries := []object{}
	for _, joint := range body.Joints {
		if joint.Motor != nil && driven(joint.Type) {
			for _, kind := range []string{"position", "velocity"} {
				entries = append(entries, object{"type": kind, "joint": joint.ID})
			}
		}
	}
	for _, kind := range rootSenses {
		entries = append(entries, object{"type": kind, "cube": body.Cubes[0].ID})
	}
	return entries
}

// writtenSensors returns the sensors that a body has by default as a document names them.
func writtenSensors(body *Body) array {
	entries, seen := array{}, map[[2]string]bool{}
	for _, sensor := range body.Sensors {
		if key := [2]string{sensor.Type, sensor.Target}; !seen[key] {
			seen[key] = true
			entries = append(entries, object{"type": sensor.Type, sensor.Of: sensor.Target})
		}
	}
	return entries
}

// readSensor returns the single readings of one entry of a document; where something is wrong with it, none.
func readSensor(entry object, path string, body *Body, r *reader) []Sensor {
	if has(entry, "joint") == has(entry, "cube") {
		r.note(path, "must have either a joint or a cube that it is on")
		return nil
	}
	of := "cube"
	if has(entry, "joint") {
		of = "joint"
	}
	if field, words := wrongWith(entry, of); words != "" {
		r.note(strings.TrimRight(path+"/"+field, "/"), "%s", words)
		return nil
	}
	targets := sensorTargets(entry, of, path+"/"+of, body, r)
	if has(entry, "id") && len(targets) > 1 {
		words := "%s fits %d %ss, so that one id is not enough: leave it out"
		r.note(path+"/id", words, quoted(text(entry, of, "")), len(targets), of)
		return nil
	}
	var sensors []Sensor
	for _, target := range targets {
		sensors = append(sensors, singles(entry, of, target)...)
	}
	return sensors
}

// wrongWith returns the field that is wrong with an entry by itself, and why.
func wrongWith(entry object, of string) (string, string) {
	kind, kinds := text(entry, "type", ""), ofCube
	if of == "joint" {
		kinds = ofJoint
	}
	if !slices.Contains(kinds, kind) {
		return "type", fmt.Sprintf("a %s has no sensor %s, only %s", of, quoted(kind), strings.Join(kinds, ", "))
	}
	for _, field := range sensorFields {
		if !has(entry, field.name) || of == "cube" && slices.Contains(field.owners, kind) {
			continue
		}
		if field.name == "axis" {
			return field.name, kind + " is one number and has no axis"
		}
		verb := "has"
		if len(field.owners) > 1 {
			verb = "have"
		}
		owners := strings.Join(field.owners, ", ")
		return field.name, fmt.Sprintf("%s has no %s; only %s %s", kind, field.name, owners, verb)
	}
	if kind == "hear" && !has(entry, "channel") {
		return "", "hear needs a channel"
	}
	return "", ""
}

// sensorTargets returns the ids of the cubes or joints that fit an entry's pattern and have such a reading.
func sensorTargets(entry object, of, path string, body *Body, r *reader) []string {
	pattern, kind, names := text(entry, of, ""), text(entry, "type", ""), namesOf(body.Cubes, cubeID)
	if of == "joint" {
		names = namesOf(body.Joints, jointID)
	}
	found := fitting(pattern, names)
	if len(found) == 0 && !r.mayBeAbsent(pattern) {
		if isPattern(pattern) {
			r.note(path, "no %s fits %s", of, quoted(pattern))
		} else {
			r.note(path, "there is no %s %s%s", of, quoted(pattern), r.hint(pattern, names))
		}
	}
	if of == "cube" {
		return found
	}
	readable := slices.DeleteFunc(slices.Clone(found), func(name string) bool {
		return !slices.ContainsFunc(body.Joints, func(joint Joint) bool {
			return joint.ID == name && (kind == "effort" && joint.Motor != nil || kind != "effort" && driven(joint.Type))
		})
	})
	if len(found) > 0 && len(readable) == 0 {
		what := "are hinges or slides"
		if kind == "effort" {
			what = "have a motor"
		}
		words := "%s is only of joints that %s; of %s none is one"
		r.note(path, words, kind, what, quotedAll(found[:min(len(found), 5)]))
	}
	return readable
}

// singles returns the readings that an entry has of one cube or joint.
func singles(entry object, of, target string) []Sensor {
	kind := text(entry, "type", "")
	name := text(entry, "id", target+"."+kind)
	one := func(id string) Sensor { return Sensor{ID: id, Type: kind, Of: of, Target: target} }
	switch {
	case of == "joint":
		return []Sensor{one(name)}
	case slices.Contains(vectors, kind) && !has(entry, "axis"):
		return []Sensor{one(name + ".x"), one(name + ".y"), one(name + ".z")}
	case slices.Contains(vectors, kind):
		return []Sensor{one(text(entry, "id", name+"."+text(entry, "axis", "")))}
	case kind == "hear":
		return []Sensor{one(text(entry, "id", heard(name, text(entry, "channel", ""), whole(entry, "number", 1))))}
	case kind == "touch" && has(entry, "face"):
		return []Sensor{one(text(entry, "id", name+"."+strings.TrimPrefix(text(entry, "face", ""), "+")))}
	case kind == "range":
		sensor := one(name)
		sensor.ray = true
		return []Sensor{sensor}
	case kind == "camera":
		return pixels(entry, name, one)
	}
	return []Sensor{one(name)}
}

// pixels returns the readings of a camera, row by row from the upper left.
func pixels(entry object, name string, one func(string) Sensor) []Sensor {
	tones := []string{""}
	if text(entry, "colors", "grey") == "rgb" {
		tones = []string{".r", ".g", ".b"}
	}
	var sensors []Sensor
	for row := range whole(entry, "height", 8) {
		for column := range whole(entry, "width", 8) {
			for i, tone := range tones {
				sensor := one(fmt.Sprintf("%s.%d.%d%s", name, row+1, column+1, tone))
				sensor.ray = i == 0
				sensors = append(sensors, sensor)
			}
		}
	}
	return sensors
}
