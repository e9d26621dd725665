/** A genome as its file has it, as far as the builder looks into it. All else is carried along untouched. */

export type Vector = readonly [number, number, number];
export type Face = "+x" | "-x" | "+y" | "-y" | "+z" | "-z";
export type Shape = "box" | "sphere" | "capsule" | "cylinder";
export type JointType = "fixed" | "hinge" | "slide" | "pin" | "conetwist";

export interface Cube {
  readonly id: string;
  readonly size: number | Vector;
  readonly mass: number;
  readonly position: Vector;
  readonly shape?: Shape;
  /** Euler angles in rad, applied in the order Y, X, Z, or a quaternion x, y, z, w. */
  readonly rotation?: readonly number[];
  readonly color?: readonly number[];
  readonly friction?: number;
}

export interface Motor {
  readonly mode: "position" | "velocity";
  readonly range: readonly [number, number];
  readonly max_effort: number;
}

/** What a joint between two cubes and the joint of a part in a graph have in common. */
export interface Hold {
  readonly type: JointType;
  readonly axis?: Vector;
  readonly limits?: readonly [number, number];
  readonly stiffness?: number;
  readonly damping?: number;
  readonly motor?: Motor;
}

export interface Joint extends Hold {
  readonly id: string;
  readonly cube1: string;
  readonly cube2: string;
  readonly anchor: Vector;
}

export interface Part {
  readonly id: string;
  readonly size: number | Vector;
  readonly density?: number;
  readonly shape?: Shape;
  readonly joint?: Hold;
  readonly recursive_limit?: number;
  readonly color?: readonly number[];
}

export interface Connection {
  readonly from: string;
  readonly to: string;
  readonly face: Face;
  readonly at?: readonly [number, number];
  readonly rotation?: readonly number[];
  readonly scale?: number;
  readonly mirror?: "x" | "y" | "z";
  readonly terminal?: boolean;
}

export interface Graph {
  readonly root: string;
  readonly parts: readonly Part[];
  readonly connections?: readonly Connection[];
}

export interface SensorEntry {
  readonly type: string;
  readonly id?: string;
  readonly joint?: string;
  readonly cube?: string;
  readonly [field: string]: unknown;
}

export interface Brain {
  readonly kind: string;
  readonly [field: string]: unknown;
}

export interface Body {
  readonly cubes?: readonly Cube[];
  readonly joints?: readonly Joint[];
  readonly graph?: Graph;
}

export interface Rule {
  readonly when: string;
  readonly shed?: readonly string[];
  readonly adopt?: readonly string[];
  readonly grow?: readonly string[];
  readonly resize?: readonly { readonly part: string; readonly scale: number }[];
  readonly enter?: number;
  readonly [field: string]: unknown;
}

export interface Genome {
  readonly format: "nmes-genome/1";
  readonly name: string;
  readonly description?: string;
  readonly body: Body;
  readonly later?: readonly string[];
  readonly development?: readonly Rule[];
  readonly sensors?: readonly SensorEntry[];
  readonly brain?: Brain;
  readonly [field: string]: unknown;
}

/** The three edges of a cube or a part. */
export function edges(part: { readonly size: number | Vector }): Vector {
  return typeof part.size === "number" ? [part.size, part.size, part.size] : part.size;
}

/** Says whether a name fits one in which `*` and `?` stand for others, as the command line reads it. */
export function fits(pattern: string, name: string): boolean {
  const source = pattern.replace(/[.+^${}()|[\]\\]/g, "\\$&").replace(/\*/g, ".*").replace(/\?/g, ".");
  return new RegExp(`^${source}$`).test(name);
}
