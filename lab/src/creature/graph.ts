/** Steps of building a body that grows out of a graph: its parts, and on what they grow. */

import { Impossible } from "./anatomy.js";
import type { Connection, Face, Genome, Graph, Part } from "./genome.js";

const LONGEST_NAME = 40; // of a part: what grows of it gets a number behind it

export function graphOf(genome: Genome): Graph {
  if (genome.body.graph === undefined) throw new Impossible("This body is written out; it has no graph.");
  return genome.body.graph;
}

/** The part that a grown cube came from: `leg.2.mirror` grew of `leg`. */
export function partOf(genome: Genome, cube: string): Part | undefined {
  const parts = [...graphOf(genome).parts].sort((a, b) => b.id.length - a.id.length);
  return parts.find((part) => cube === part.id || cube.startsWith(`${part.id}.`));
}

export function changePart(genome: Genome, id: string, fields: Partial<Omit<Part, "id">>): Genome {
  const graph = graphOf(genome);
  return withGraph(genome, { ...graph, parts: graph.parts.map((each) => (each.id === id ? { ...each, ...fields } : each)) });
}

/** Changes a connection; `undefined` takes a field away. */
export function changeConnection(genome: Genome, index: number, fields: { [K in keyof Connection]?: Connection[K] | undefined }): Genome {
  const graph = graphOf(genome);
  const connections = (graph.connections ?? []).map((each, i) => {
    if (i !== index) return each;
    return Object.fromEntries(Object.entries({ ...each, ...fields }).filter(([, value]) => value !== undefined)) as unknown as Connection;
  });
  return withGraph(genome, { ...graph, connections });
}

/** Lets a new part grow on another, and with a mirror on both of its sides. */
export function grow(genome: Genome, from: string, face: Face): Genome {
  const graph = graphOf(genome);
  const names = new Set(graph.parts.map((part) => part.id));
  let number = 1;
  while (names.has(`part${number}`)) number += 1;
  const id = `part${number}`.slice(0, LONGEST_NAME);
  const motor = { mode: "position", range: [-0.6, 0.6], max_effort: 12 } as const;
  const part: Part = { id, size: [0.2, 0.06, 0.06], joint: { type: "hinge", motor } };
  const connection: Connection = { from, to: id, face, ...(face[1] === "z" ? { mirror: "z" } : {}) };
  return withGraph(genome, {
    ...graph,
    parts: [...graph.parts, part],
    connections: [...(graph.connections ?? []), connection],
  });
}

/** Takes a part away, and all that nothing leads to then. */
export function prune(genome: Genome, id: string): Genome {
  const graph = graphOf(genome);
  if (graph.root === id) throw new Impossible("Growth begins with this part: it stays.");
  const connections = (graph.connections ?? []).filter((each) => each.from !== id && each.to !== id);
  const reached = [graph.root];
  for (const here of reached) {
    for (const each of connections) if (each.from === here && !reached.includes(each.to)) reached.push(each.to);
  }
  return withGraph(genome, {
    ...graph,
    parts: graph.parts.filter((part) => reached.includes(part.id)),
    connections: connections.filter((each) => reached.includes(each.from)),
  });
}

function withGraph(genome: Genome, graph: Graph): Genome {
  return { ...genome, body: { ...genome.body, graph } };
}
