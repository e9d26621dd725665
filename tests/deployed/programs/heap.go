package main

import "math"

// heap spawns cubes on one spot, ten a second, and never takes one away; in the end it looks at the newest twenty.
func heap() Message {
	c := dial(*port)
	defer c.close()
	for n := 0; n < *count; n++ {
		c.tell(Message{"type": "spawn_cube", "position": Vector{0, 103, 0}})
		c.wait(0.1)
	}
	c.wait(1)
	names := c.names()
	expect(len(names) == *count, "of %d cubes the list has %d", *count, len(names))
	lowest, highest := math.Inf(1), 0.0
	for _, name := range names[len(names)-20:] {
		height := c.state(name).Position.length() - 100
		lowest, highest = math.Min(lowest, height), math.Max(highest, height)
	}
	expect(lowest > 0, "a cube of the heap is %.2f m high: in the ground", lowest)
	expect(highest < 100, "a cube of the heap was flung %.2f m high", highest)
	return Message{"cubes": len(names), "lowest": lowest, "highest": highest}
}
