package genome

import (
	"fmt"
	"math"
	"slices"
)

var (
	faces   = []string{"+x", "-x", "+y", "-y", "+z", "-z"}
	pointed = []string{"range", "camera"} // sensors that look in a direction
	usual   = slices.DeleteFunc(slices.Clone(ofCube), func(kind string) bool {
		return kind == "hear" || slices.Contains(slices.Concat(ofOthers, ofFood, surrounded), kind)
	})
)

const turnOfDirection = 0.3 // of a direction of length 1: how far each of its numbers is moved

// sensors adds a sensor or takes one away; those of a body by default are written out first.
func (m *mutation) sensors() bool {
	setDefault(m.document, "sensors", writtenSensors(m.body))
	sensors := list(m.document, "sensors")
	if len(sensors) > 1 && m.draw.Chance(0.4) {
		m.document["sensors"] = removed(sensors, oneOf(m.draw, sensors))
		return true
	}
	var looking []object
	if slices.ContainsFunc(m.needs.Senses, func(kind string) bool { return slices.Contains(pointed, kind) }) {
		for _, sensor := range objects(m.document, "sensors") {
			if slices.Contains(pointed, text(sensor, "type", "")) {
				looking = append(looking, sensor)
			}
		}
	}
	if len(looking) > 0 && m.draw.Chance(0.5) {
		m.pointAnew(oneOf(m.draw, looking))
		return true
	}
	if len(sensors) >= mostSensors {
		return false
	}
	var moving []string
	for _, joint := range m.body.Joints {
		if driven(joint.Type) {
			moving = append(moving, joint.ID)
		}
	}
	var sensor object
	if len(moving) > 0 && m.draw.Chance(0.4) {
		kind := oneOf(m.draw, ofJoint)
		sensor = object{"type": kind, "joint": oneOf(m.draw, moving)}
	} else {
		sensor = m.cubeSensor()
	}
	m.document["sensors"] = append(sensors, sensor)
	return true
}

func (m *mutation) cubeSensor() object {
	kinds := slices.Concat(usual, m.needs.Senses)
	if len(m.needs.Channels) > 0 {
		kinds = append(kinds, "hear")
	}
	kind := oneOf(m.draw, kinds)
	sensor := object{"type": kind, "cube": oneOf(m.draw, m.body.Cubes).ID}
	if kind == "hear" {
		for name, value := range m.channelNumber() {
			sensor[name] = value
		}
	} else if slices.Contains(m.needs.Senses, kind) {
		m.details(sensor, kind)
	}
	return sensor
}

// details draws what else a document says of a new sensor that is of use only in some places.
func (m *mutation) details(sensor object, kind string) {
	if kind == "touch" {
		sensor["face"] = oneOf(m.draw, m.faces())
		return
	}
	smell := slices.Contains(smells, kind)
	if smell || slices.Contains(pointed, kind) {
		sensor["id"] = m.unusedSensor(text(sensor, "cube", "") + "." + kind)
	}
	if smell {
		sensor["range"] = rounded(m.draw.Factor(0.5), 6)
	} else if kind == "range" {
		sensor["range"] = rounded(float64(5*m.draw.Factor(0.5)), 6)
	}
	if kind == "camera" {
		sensor["width"], sensor["height"] = float64(m.draw.Count(4, 8)), 1.0
		sensor["colors"] = oneOf(m.draw, []string{"grey", "rgb"})
		sensor["fov"] = rounded(m.draw.Uniform(0.1, 0.4), 6)
	}
	if slices.Contains(pointed, kind) {
		sensor["direction"] = m.turned(Vector{1, 0, 0})
	}
}

func (m *mutation) faces() []string {
	if m.needs.Planar {
		return faces[:4]
	}
	return faces
}

func (m *mutation) unusedSensor(name string) string {
	ids := fieldsOf(objects(m.document, "sensors"), "id")
	for number := 1; ; number++ {
		if id := fmt.Sprintf("%s.%d", name, number); !slices.Contains(ids, id) {
			return id
		}
	}
}

// pointAnew turns where a sensor looks a little, and changes how far.
func (m *mutation) pointAnew(sensor object) {
	direction := Vector{1, 0, 0}
	if items, there := sensor["direction"].(array); there {
		direction = vectorOf(items)
	}
	sensor["direction"] = m.turned(direction)
	if text(sensor, "type", "") == "range" {
		reach := float64(number(sensor, "range", 10) * m.draw.Factor(0.3))
		sensor["range"] = rounded(min(1e6, max(1e-3, reach)), 6)
	}
}

func (m *mutation) turned(direction Vector) array {
	length := math.Sqrt(dot(direction, direction))
	for k := range direction {
		direction[k] = direction[k]/length + m.draw.Normal(turnOfDirection)
	}
	if m.needs.Planar {
		direction[2] = 0
	}
	for k := range direction {
		direction[k] = rounded(direction[k], 6)
	}
	return anyOf(direction[:])
}
