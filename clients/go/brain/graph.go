package brain

import (
	"cmp"
	"fmt"
	"slices"

	"nmes/internal/documents"
)

// graph are nodes in the order in which values flow, in groups of one activation whose nodes do not need each other.
type graph struct {
	groups  []group
	weights [][]float64 // of what stands in the row: inputs, 1, the nodes now, the nodes a step before
	row     []float64
	now     []float64 // parts of the row
	before  []float64
	sums    []float64
	owner   []int
}

// group is a part of the order of the nodes.
type group struct {
	begin, end int
	activate   func(float64) float64
}

type graphLink struct {
	From, Sensor *string
	To           string
	Weight       float64

	source, target int // nodes; -1 for sensors
	sensors        []int
}

func newGraph(document []byte, n *names) kernel {
	given := decoded[struct {
		Nodes []struct {
			ID, Activation string
			Motor          *string
			Bias           float64
		}
		Links []graphLink
	}](document)
	ids, all := map[string]int{}, []string{}
	var motored []int
	var motors []string
	for number, node := range given.Nodes {
		if _, twice := ids[node.ID]; twice {
			n.Add(fmt.Sprintf("nodes/%d/id", number), "there is another node %s", documents.Excerpt(node.ID))
			continue
		}
		ids[node.ID] = number
		all = append(all, node.ID)
		if node.Motor != nil {
			motored, motors = append(motored, number), append(motors, *node.Motor)
		}
	}
	if len(motored) == 0 {
		n.Add("nodes", "no node drives a motor: give one a 'motor'")
	}
	owners := n.owners(motors, n.outputs, "motor", func(i int) string { return fmt.Sprintf("nodes/%d/motor", motored[i]) })
	resolveLinks(given.Links, ids, all, n)
	if n.Err() != nil {
		return nil
	}
	names := make([]string, len(given.Nodes))
	for i, node := range given.Nodes {
		names[i] = node.Activation
	}
	order, levels, delayed := flow(names, given.Links)
	count, sensors := len(order), len(n.inputs)
	g := &graph{weights: matrix(count, sensors+1+2*count), row: make([]float64, sensors+1+2*count), sums: make([]float64, count)}
	g.row[sensors] = 1
	g.now, g.before = g.row[sensors+1:sensors+1+count], g.row[sensors+1+count:]
	place := make([]int, count) // of each node in the order
	for at, node := range order {
		place[node] = at
		g.weights[at][sensors] = given.Nodes[node].Bias
		if at == 0 || levels[node] != levels[order[at-1]] || names[node] != names[order[at-1]] {
			g.groups = append(g.groups, group{at, at, activations[names[node]]})
		}
		g.groups[len(g.groups)-1].end++
	}
	for i, link := range given.Links {
		row := g.weights[place[link.target]]
		for _, sensor := range link.sensors {
			row[sensor] += link.Weight // several wildcards may name one sensor
		}
		if link.source >= 0 {
			at := sensors + 1 + place[link.source]
			if delayed[i] {
				at += count
			}
			row[at] = link.Weight
		}
	}
	for _, owner := range owners {
		if owner >= 0 {
			owner = place[motored[owner]]
		}
		g.owner = append(g.owner, owner)
	}
	return g
}

// resolveLinks looks up what links come from and lead to.
func resolveLinks(links []graphLink, ids map[string]int, all []string, n *names) {
	type ends struct {
		from, sensor bool
		source, to   string
	}
	seen := map[ends]int{}
	for number := range links {
		link := &links[number]
		path := fmt.Sprintf("links/%d", number)
		if (link.From == nil) == (link.Sensor == nil) {
			n.Add(path, "must have either 'from' or 'sensor'")
			continue
		}
		node := func(id, end string) int {
			at, there := ids[id]
			if !there {
				n.noSuch(id, all, "node", path+"/"+end)
			}
			return at
		}
		key := ends{from: link.From != nil, sensor: link.Sensor != nil, to: link.To}
		link.source = -1
		if link.From != nil {
			key.source = *link.From
			link.source = node(*link.From, "from")
		} else {
			key.source = *link.Sensor
			link.sensors = n.match(*link.Sensor, n.inputs, "sensor", path+"/sensor")
		}
		link.target = node(link.To, "to")
		if first, twice := seen[key]; twice {
			n.Add(path, "links what link %d does", first)
		} else {
			seen[key] = number
		}
	}
}

// flow returns the order of the nodes, their levels, and which links carry the value of the step before. A link whose
// two nodes can reach each other is part of a loop: it is delayed, and what remains has no loops.
func flow(activation []string, links []graphLink) (order, levels []int, delayed []bool) {
	count := len(activation)
	after := make([][]int, count)
	for _, link := range links {
		if link.source >= 0 {
			after[link.source] = append(after[link.source], link.target)
		}
	}
	loop := components(after)
	levels, delayed = make([]int, count), make([]bool, len(links))
	waiting := make([]int, count)
	for i, link := range links {
		if link.source >= 0 {
			if delayed[i] = loop[link.source] == loop[link.target]; !delayed[i] {
				waiting[link.target]++
			}
		}
	}
	var ready []int
	for node := range count {
		order = append(order, node)
		if waiting[node] == 0 {
			ready = append(ready, node)
		}
	}
	for len(ready) > 0 {
		node := ready[0]
		ready = ready[1:]
		for _, target := range after[node] {
			if loop[target] != loop[node] {
				levels[target] = max(levels[target], levels[node]+1)
				if waiting[target]--; waiting[target] == 0 {
					ready = append(ready, target)
				}
			}
		}
	}
	slices.SortFunc(order, func(a, b int) int {
		return cmp.Or(cmp.Compare(levels[a], levels[b]), cmp.Compare(activation[a], activation[b]), cmp.Compare(a, b))
	})
	return order, levels, delayed
}

// components numbers nodes so that two have the same number if and only if each can be reached from the other (R.
// Tarjan, 1972, without recursion: a document may have a path through all of its nodes).
func components(after [][]int) []int {
	count := len(after)
	number, lowest, component := make([]int, count), make([]int, count), make([]int, count) // number: from 1
	for i := range component {
		component[i] = -1
	}
	type visit struct{ node, next int }
	var open []int
	numbered := 0
	for root := range after {
		if number[root] > 0 {
			continue
		}
		path := []visit{{root, 0}}
		for len(path) > 0 {
			at := &path[len(path)-1]
			node := at.node
			if at.next == 0 && number[node] == 0 {
				numbered++
				number[node], lowest[node] = numbered, numbered
				open = append(open, node)
			}
			if at.next < len(after[node]) {
				target := after[node][at.next]
				at.next++
				if number[target] == 0 {
					path = append(path, visit{target, 0})
				} else if component[target] < 0 {
					lowest[node] = min(lowest[node], number[target])
				}
				continue
			}
			path = path[:len(path)-1]
			if len(path) > 0 {
				parent := path[len(path)-1].node
				lowest[parent] = min(lowest[parent], lowest[node])
			}
			if lowest[node] == number[node] {
				for component[node] < 0 {
					component[open[len(open)-1]] = node
					open = open[:len(open)-1]
				}
			}
		}
	}
	return component
}

func (g *graph) reset(uint64, float64) { clear(g.now) }

func (g *graph) step(sensors, controls []float64) {
	hear(sensors, g.row)
	copy(g.before, g.now)
	for _, each := range g.groups {
		sums := g.sums[each.begin:each.end]
		weigh(g.weights[each.begin:each.end], g.row, sums)
		for i, sum := range sums {
			g.now[each.begin+i] = each.activate(sum)
		}
	}
	pick(g.owner, g.now, controls)
}
