package genome

import (
	"slices"
)

// offspring returns the genome that the changed document becomes: sensors, rules and brain go along with the body, and
// all of it is judged. It keeps its parent's name and licence, but neither its author nor what was said about it.
func (m *mutation) offspring(parent *Genome) (*Genome, error) {
	delete(m.document, "author")
	delete(m.document, "description")
	m.document["parents"] = array{parent.Hash}
	after, wrong := m.changedBody()
	if wrong != nil {
		return nil, wrong
	}
	carryOverDevelopment(m.document, after)
	brain, there := m.document["brain"].(object)
	same := slices.Equal(m.body.Inputs(), after.Inputs()) && slices.Equal(m.body.Outputs(), after.Outputs())
	if there && !same {
		m.document["brain"] = carryOver(brain, m.body, after, m.draw)
	}
	child, err := read(m.document)
	if err != nil {
		return nil, err
	}
	var problems []Problem
	for _, reason := range m.needs.Check(&child.Body) {
		problems = append(problems, Problem{"body", reason})
	}
	if len(problems) > 0 {
		return nil, &DocumentError{problems}
	}
	return child, nil
}

// changedBody returns the body of the document, whose sensors are taken away where it has nothing that they could be on.
func (m *mutation) changedBody() (*Body, *DocumentError) {
	bare := object{}
	for _, name := range []string{"format", "name", "body", "voices"} {
		if has(m.document, name) {
			bare[name] = m.document[name]
		}
	}
	if !has(m.document, "sensors") {
		return soundBody(bare)
	}
	bare["sensors"] = array{}
	body, wrong := soundBody(bare)
	if wrong != nil {
		return nil, wrong
	}
	m.document["sensors"] = slices.DeleteFunc(list(m.document, "sensors"), func(sensor any) bool {
		return !readable(sensor.(object), body)
	})
	bare["sensors"] = m.document["sensors"]
	return soundBody(bare)
}

func soundBody(document object) (*Body, *DocumentError) {
	found := inspectBody(document)
	if len(found.problems) > 0 {
		return nil, &DocumentError{found.problems}
	}
	return found.body, nil
}

// readable tells whether there is what a sensor of a document is on.
func readable(sensor object, body *Body) bool {
	if has(sensor, "cube") {
		pattern := text(sensor, "cube", "")
		return slices.ContainsFunc(body.Cubes, func(cube Cube) bool { return fits(pattern, cube.ID) })
	}
	pattern, effort := text(sensor, "joint", ""), sensor["type"] == "effort"
	return slices.ContainsFunc(body.Joints, func(joint Joint) bool {
		able := driven(joint.Type)
		if effort {
			able = joint.Motor != nil
		}
		return able && fits(pattern, joint.ID)
	})
}
