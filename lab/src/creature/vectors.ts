/** Vectors and turns, as the documents of genomes have them. */

import type { Vector } from "./genome.js";

type Quaternion = readonly [number, number, number, number];

export const plus = (a: Vector, b: Vector): Vector => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];
export const minus = (a: Vector, b: Vector): Vector => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
export const times = (a: Vector, factor: number): Vector => [a[0] * factor, a[1] * factor, a[2] * factor];

/** Rounds to a micrometre, so that files have no 0.30000000000000004 in them. */
export function round(value: number): number {
  return Math.round(value * 1e6) / 1e6 + 0; // + 0: there is no -0 in a file
}

export const rounded = (a: Vector): Vector => [round(a[0]), round(a[1]), round(a[2])];

/** The turn that a document means by 3 Euler angles, applied in the order Y, X, Z, or by a quaternion. */
export function quaternion(rotation: readonly number[] | undefined): Quaternion {
  const [x = 0, y = 0, z = 0, w] = rotation ?? [];
  if (w !== undefined) {
    const length = Math.hypot(x, y, z, w);
    return [x / length, y / length, z / length, w / length];
  }
  const [sx, sy, sz] = [Math.sin(x / 2), Math.sin(y / 2), Math.sin(z / 2)];
  const [cx, cy, cz] = [Math.cos(x / 2), Math.cos(y / 2), Math.cos(z / 2)];
  return [
    sx * cy * cz + cx * sy * sz,
    cx * sy * cz - sx * cy * sz,
    cx * cy * sz - sx * sy * cz,
    cx * cy * cz + sx * sy * sz,
  ];
}

/** Turns a vector. */
export function turn([qx, qy, qz, qw]: Quaternion, [x, y, z]: Vector): Vector {
  const [tx, ty, tz] = [2 * (qy * z - qz * y), 2 * (qz * x - qx * z), 2 * (qx * y - qy * x)];
  return [x + qw * tx + qy * tz - qz * ty, y + qw * ty + qz * tx - qx * tz, z + qw * tz + qx * ty - qy * tx];
}

export const opposite = ([x, y, z, w]: Quaternion): Quaternion => [-x, -y, -z, w];
