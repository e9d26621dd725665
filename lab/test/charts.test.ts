import assert from "node:assert/strict";
import { test } from "node:test";

import { ancestry, cellOf, type Relative } from "../src/runs/places.js";

test("a value is in the cell that the archive puts it into", () => {
  const measure = { expression: "mass", low: 0, high: 50, cells: 10 };
  assert.deepEqual([-1, 0, 4.9, 5, 49.9, 50, 80].map((value) => cellOf(measure, value)), [0, 0, 0, 1, 9, 9, 9]);
});

test("ancestors are as far as the shortest way to them is, and a loop ends", () => {
  const told = (index: number, ...parents: number[]): [number, Relative] => [index, { index, score: 1, operator: "x", parents }];
  const known = new Map([told(4, 3, 1), told(3, 2), told(2, 1), told(1, 0), told(0, 4)]);
  assert.deepEqual([...ancestry(known, 4)], [[4, 0], [3, 1], [1, 1], [2, 2], [0, 2]]);
  assert.deepEqual([...ancestry(known, 9)], []);
});

test("of a long ancestry the nearest are drawn", () => {
  const known = new Map(Array.from({ length: 500 }, (_, index): [number, Relative] => [index, { index, score: 1, operator: "x", parents: index === 0 ? [] : [index - 1] }]));
  const steps = ancestry(known, 499);
  assert.equal(steps.size, 60);
  assert.equal(Math.max(...steps.values()), 59);
});
