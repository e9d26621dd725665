import assert from "node:assert/strict";
import { test } from "node:test";

import { described, network } from "../src/network.js";

test("links without a weight have that of their kind of brain", () => {
  const graph = { kind: "graph", nodes: [{ id: "out", motor: "hip" }], links: [{ sensor: "up", to: "out" }, { from: "out", to: "out", weight: 3 }] };
  assert.deepEqual(network(graph, ["up"], ["hip"])?.wires.map(({ weight }) => weight), [1, 3]);
  const cpg = { kind: "cpg", oscillators: [{ motor: "a" }, { motor: "b" }], links: [{ from: "a", to: "b" }] };
  assert.deepEqual(network(cpg, [], ["a", "b"])?.wires.map(({ weight }) => weight), [4]);
});

test("a step is up from 0 on", () => {
  const steps = { kind: "mlp", layers: [{ weights: [[1]], activation: "step" }] };
  const drawn = network(steps, ["up"], ["hip"]);
  assert.deepEqual([-1, 0, 1].map((sensed) => drawn?.activate([sensed], { units: [], controls: [] })[1]), [0, 1, 1]);
});

test("a wave is told with all that it has, and with what it leaves out", () => {
  assert.equal(described({ kind: "sine", oscillators: [{ motor: "*" }] }), "*: 0 + 0.5 sin(2π 1 t + 0)");
  const wave = { motor: "hip*", frequency: 2, amplitude: 0.3, phase: 0.1, step: 0.7, offset: -0.2 };
  assert.equal(described({ kind: "sine", oscillators: [wave] }), "hip*: -0.2 + 0.3 sin(2π 2 t + 0.1 - 0.7 n); n is 0 for the first motor of a wave, 1 for the next");
  assert.equal(described({ kind: "onnx" }), "It is no network that can be drawn.");
});

test("wildcards stand for any characters, whatever they are, and take no longer the more there are", () => {
  const reads = (entry: string, ...sensors: string[]): number[] =>
    network({ kind: "mlp", inputs: [entry], layers: [] }, sensors, [])?.activate(sensors.map((_, place) => 2 ** place), { units: [], controls: [] }) ?? [];
  assert.deepEqual(reads("?.b*", "a.b", "🦎.bc", "ab", "aa.b", ".b"), [1 + 2]);
  assert.deepEqual(reads("a*c", "ac", "a\n🦎c", "abcd", "a.c.c", "ca"), [1 + 2 + 8]);
  assert.deepEqual(reads("*a*b?", "abc", "bab", "aabbb", "xaxbx", "ab"), [1 + 4 + 8]);
  assert.deepEqual(reads("[a-z]*", "b", "[a-z]", "[a-z].x"), [2 + 4]);
  assert.deepEqual(reads(`${"*a".repeat(30)}b`, "a".repeat(120), `${"a".repeat(120)}b`), [2]);
});
