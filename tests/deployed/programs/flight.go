package main

import (
	"encoding/csv"
	"math"
	"os"
	"strconv"
)

// controller steers a cube to a point by a force in proportion to how far off it is, ten times a second.
func controller() Message {
	const gain, most, period = 0.05, 2.0, 0.1
	target := Vector{69.58, 72.56, 30.29}
	c := dial(*port)
	defer c.close()
	c.tell(Message{"type": "spawn_cube", "position": Vector{0, 100, 40}})
	nearest, when := math.Inf(1), 0.0
	for n := 0; n <= 120; n++ {
		off := target.minus(c.own().Position)
		if off.length() < nearest {
			nearest, when = off.length(), period*float64(n)
		}
		force := off.times(gain)
		if size := force.length(); size > most {
			force = force.times(most / size)
		}
		c.tell(Message{"type": "apply_force", "force": force})
		c.wait(period)
	}
	expect(nearest < 10, "the cube came no nearer to the target than %.2f m", nearest)
	return Message{"nearest": nearest, "after": when}
}

// A row of the saved run: where the cube was, how it moved, and the force that the program then sent.
type Row struct {
	position, velocity, force Vector
}

// trajectory replays the saved run of another program, and looks whether the world goes on as the original did: step
// by step from what was saved, wherever the cube touched nothing, and in one go down to where it first touched ground.
func trajectory() Message {
	rows := savedRun()
	c := dial(*port)
	defer c.close()
	steps, off, faster := 0, 0.0, 0.0
	for n := 0; n+1 < len(rows); n++ {
		if !flight(rows[n], rows[n+1]) {
			continue
		}
		c.tell(Message{"type": "spawn_cube", "position": rows[n].position})
		c.tell(Message{"type": "apply_force", "force": rows[n].velocity}) // a push of 1 kg m/s for each m/s
		state := follow(c, rows[n].force, rows[n+1].position)
		c.tell(Message{"type": "despawn_cube", "cube_name": state.Name})
		miss, slip := state.Position.distance(rows[n+1].position), state.Velocity.distance(rows[n+1].velocity)
		expect(miss < 0.02 && slip < 0.02, "after row %d the cube is %.4f m and %.4f m/s off", n, miss, slip)
		steps, off, faster = steps+1, math.Max(off, miss), math.Max(faster, slip)
	}
	c.tell(Message{"type": "spawn_cube", "position": Vector{0, 100, 40}})
	c.wait(tick)
	fell, drift := 0, 0.0
	for ; flight(rows[fell], rows[fell+1]); fell++ {
		drift = follow(c, rows[fell].force, rows[fell+1].position).Position.distance(rows[fell+1].position)
		expect(drift < 0.02*float64(fell+1), "after %d steps in one go the cube is %.4f m off", fell+1, drift)
	}
	return Message{"steps": steps, "off": off, "faster": faster, "fell": fell, "drift": drift}
}

// follow pushes the cube a tick after it was looked at, as long as it took the program to answer, and returns how it
// moves at the tick, of the 6 to 8 after which the program looked again, at which it is nearest to a place.
func follow(c *Client, force, place Vector) State {
	c.wait(tick)
	c.tell(Message{"type": "apply_force", "force": force})
	c.wait(5 * tick)
	state := c.own()
	for ticks := 7; ticks <= 8; ticks++ {
		// Another tick brings it nearer as long as the place is more than half of the tick's way ahead.
		ahead := dot(place.minus(state.Position), state.Velocity)
		if 2*ahead < dot(state.Velocity, state.Velocity)*tick {
			break
		}
		c.wait(tick)
		state = c.own()
	}
	return state
}

func dot(a, b Vector) float64 {
	return a[0]*b[0] + a[1]*b[1] + a[2]*b[2]
}

// flight tells whether the cube touched nothing between two rows: at both it was so high above the first planet that
// it could not, however it was turned, and it rose no faster at the second, as it does when it is thrown back.
func flight(from, to Row) bool {
	const clear = 100 + 0.87 // m; half the diagonal of a cube of 1 m
	high := from.position.length() > clear && to.position.length() > clear
	return high && rise(to) < rise(from)
}

// rise is how fast the cube goes away from the planet's centre.
func rise(row Row) float64 {
	return dot(row.velocity, row.position) / row.position.length()
}

func savedRun() []Row {
	file, err := os.Open(*run)
	must(err)
	defer file.Close()
	lines, err := csv.NewReader(file).ReadAll()
	must(err)
	rows := []Row{}
	for _, line := range lines[1:] {
		var numbers [9]float64
		for n := range numbers {
			numbers[n], err = strconv.ParseFloat(line[n+1], 64)
			must(err)
		}
		rows = append(rows, Row{Vector(numbers[0:3]), Vector(numbers[3:6]), Vector(numbers[6:9])})
	}
	return rows
}
