package brain

import (
	"fmt"
	"math"
	"slices"

	"nmes/internal/elementary"
)

const mostEdges = 4096 // links between two oscillators, once wildcards are resolved

type oscillator struct {
	Motor                                     string
	Frequency, Amplitude, Phase, Step, Offset float64
}

// wave is what an oscillator says of one motor: speed (rad/s), amplitude, phase (rad) and offset.
type wave struct{ speed, amplitude, phase, offset float64 }

// dealt returns the wave of each motor, and whether one is driven at all.
func dealt(oscillators []oscillator, n *names) (waves []wave, driven []bool) {
	motors := make([]string, len(oscillators))
	for i, each := range oscillators {
		motors[i] = each.Motor
	}
	owners := n.owners(motors, n.outputs, "motor", func(i int) string { return fmt.Sprintf("oscillators/%d/motor", i) })
	waves, driven = make([]wave, len(owners)), make([]bool, len(owners))
	rank := make([]int, len(oscillators)) // how many motors of an oscillator came before
	for motor, owner := range owners {
		if owner < 0 {
			continue
		}
		each := oscillators[owner]
		later := float64(each.Step * float64(rank[owner]))
		waves[motor] = wave{float64(2 * math.Pi * each.Frequency), each.Amplitude, each.Phase - later, each.Offset}
		driven[motor] = true
		rank[owner]++
	}
	return waves, driven
}

// -- sine -------------------------------------------------------------------------------------------------------------

// sine is control = offset + amplitude sin(speed t + phase).
type sine struct {
	waves []wave
	dt    float64
	steps int
}

func newSine(document []byte, n *names) kernel {
	waves, _ := dealt(decoded[struct{ Oscillators []oscillator }](document).Oscillators, n)
	return &sine{waves: waves}
}

func (s *sine) reset(_ uint64, dt float64) { s.dt, s.steps = dt, 0 }

func (s *sine) step(_, controls []float64) {
	time := float64(float64(s.steps) * s.dt)
	s.steps++
	for i, w := range s.waves {
		swing := elementary.Sin(float64(w.speed*time) + w.phase)
		controls[i] = within(-1, 1, w.offset+float64(w.amplitude*swing))
	}
}

// -- central pattern generators ---------------------------------------------------------------------------------------

// edge is a link between two oscillators, of which one pulls at the other.
type edge struct {
	from, to    int
	weight, lag float64
}

type tie struct {
	From, To, Motors string
	Weight, Lag      float64
}

type cpgDocument struct {
	Oscillators   []oscillator
	Links, Chains []tie
	Feedback      []struct {
		Sensor, Motor string
		Rate, Offset  float64
	}
	Convergence float64
	StartJitter float64 `json:"start_jitter"`
}

// cpg are coupled phase oscillators, by Euler's method: one step of it is one control step. With
// s = sin(phase_from - phase_to - lag) of each edge, the next phases are phase + dt (speed + sum weight s + sum rate x).
// Both are products of a matrix with what stands in one row: phases, 1, inputs, s.
type cpg struct {
	waves               []wave
	edges               []edge
	convergence, jitter float64
	listens             bool
	rates, shifts       [][]float64 // of each motor, for each sensor
	apart, onward       [][]float64 // of each edge, what its sine is of; of each motor, its next phase
	row, next, pulls    []float64
	heard, sines        []float64 // parts of the row
	dt                  float64
	steps               int
}

func newCPG(document []byte, n *names) kernel {
	given := decoded[cpgDocument](document)
	waves, driven := dealt(given.Oscillators, n)
	motors, sensors := len(n.outputs), len(n.inputs)
	c := &cpg{waves: waves, convergence: given.Convergence, jitter: given.StartJitter, listens: len(given.Feedback) > 0}
	c.tie(given, n, driven)
	c.rates, c.shifts = matrix(motors, sensors), matrix(motors, sensors)
	for number, term := range given.Feedback {
		heard := n.match(term.Sensor, n.inputs, "sensor", fmt.Sprintf("feedback/%d/sensor", number))
		for _, motor := range swung(term.Motor, fmt.Sprintf("feedback/%d/motor", number), n, driven) {
			for _, sensor := range heard {
				c.rates[motor][sensor] += term.Rate
				c.shifts[motor][sensor] += term.Offset
			}
		}
	}
	columns := motors + 1 + sensors + len(c.edges)
	c.row, c.next, c.pulls = make([]float64, columns), make([]float64, motors), make([]float64, len(c.edges))
	c.heard, c.sines = c.row[motors+1:motors+1+sensors], c.row[motors+1+sensors:]
	c.row[motors] = 1
	c.apart = matrix(len(c.edges), motors+1)
	for i, each := range c.edges {
		c.apart[i][each.from], c.apart[i][each.to], c.apart[i][motors] = 1, -1, -each.lag
	}
	return c
}

// swung returns the motors that an entry names and that have an oscillator.
func swung(entry, path string, n *names, driven []bool) []int {
	motors := n.match(entry, n.outputs, "motor", path)
	with := slices.DeleteFunc(slices.Clone(motors), func(motor int) bool { return !driven[motor] })
	if len(motors) > 0 && len(with) == 0 {
		n.Add(path, "no motor that %q names has an oscillator", entry)
	}
	return with
}

// tie makes the edges of links and chains.
func (c *cpg) tie(given cpgDocument, n *names, driven []bool) {
	for number, link := range given.Links {
		path := fmt.Sprintf("links/%d", number)
		sources, targets := swung(link.From, path+"/from", n, driven), swung(link.To, path+"/to", n, driven)
		if len(c.edges)+len(sources)*len(targets) > 2*mostEdges { // however many of them are of one with itself
			n.Add(path, "with it there are over %d links between two oscillators", mostEdges)
			return
		}
		before := len(c.edges)
		for _, target := range targets {
			for _, source := range sources {
				if source != target {
					c.edges = append(c.edges, edge{source, target, link.Weight, link.Lag})
				}
			}
		}
		if len(sources) > 0 && len(targets) > 0 && len(c.edges) == before {
			n.Add(path, "links an oscillator with itself")
		}
	}
	for number, chain := range given.Chains {
		row := swung(chain.Motors, fmt.Sprintf("chains/%d/motors", number), n, driven)
		for i := range max(len(row)-1, 0) {
			c.edges = append(c.edges,
				edge{row[i], row[i+1], chain.Weight, chain.Lag}, edge{row[i+1], row[i], chain.Weight, -chain.Lag})
		}
	}
	if len(c.edges) > mostEdges {
		n.Add("links", "makes %d links between two oscillators, at most %d", len(c.edges), mostEdges)
		c.edges = nil
	}
}

func (c *cpg) reset(seed uint64, dt float64) {
	c.dt, c.steps = dt, 0
	motors := len(c.waves)
	c.onward = matrix(motors, len(c.row))
	for i, w := range c.waves {
		c.onward[i][i] = 1
		c.onward[i][motors] = float64(dt * w.speed)
		for sensor, rate := range c.rates[i] {
			c.onward[i][motors+1+sensor] = float64(dt * rate)
		}
		c.row[i] = w.phase
	}
	for i, each := range c.edges {
		c.onward[each.to][len(c.row)-len(c.edges)+i] = float64(dt * each.weight)
	}
	if c.jitter > 0 {
		draw := newTwister(seed)
		for i := range c.waves {
			c.row[i] += float64(c.jitter * (float64(2*draw.uniform()) - 1))
		}
	}
}

func (c *cpg) step(sensors, controls []float64) {
	time := float64(float64(c.steps) * c.dt)
	grown := c.grown(time)
	c.steps++
	if !c.listens {
		for i, w := range c.waves {
			phase := c.row[i]
			if len(c.edges) == 0 { // then it need not be gone from step to step
				phase += float64(w.speed * time)
			}
			swing := elementary.Sin(phase)
			controls[i] = within(-1, 1, w.offset+float64(float64(grown*w.amplitude)*swing))
		}
		if len(c.edges) > 0 {
			c.advance()
		}
		return
	}
	hear(sensors, c.heard)
	for i, w := range c.waves {
		swing := elementary.Sin(c.row[i])
		control := float64(swing*float64(grown*w.amplitude)) + w.offset
		controls[i] = within(-1, 1, control+product(c.shifts[i], c.heard))
	}
	c.advance()
}

// advance goes from the row's phases and inputs to the next phases.
func (c *cpg) advance() {
	motors := len(c.waves)
	weigh(c.apart, c.row[:motors+1], c.pulls)
	for i, pull := range c.pulls {
		c.sines[i] = elementary.Sin(pull)
	}
	weigh(c.onward, c.row, c.next)
	copy(c.row, c.next)
}

// grown returns how far amplitudes have grown: 1 - (1 + z) exp(-z), z = convergence t / 2, which solves
// r” = a (a/4 (R - r) - r') from rest at r = 0, for R = 1.
func (c *cpg) grown(time float64) float64 {
	z := float64(float64(0.5*c.convergence) * time)
	return 1 - float64((1+z)*elementary.Exp(-z))
}

func matrix(rows, columns int) [][]float64 {
	all := make([]float64, rows*columns)
	result := make([][]float64, rows)
	for i := range result {
		result[i] = all[i*columns : (i+1)*columns : (i+1)*columns]
	}
	return result
}
