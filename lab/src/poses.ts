/** What /ws/poses and /ws/recording send: scenes, which say who is there, food, and frames, which say where they are. */

export interface SceneCube {
  readonly name: string;
  readonly size: readonly [number, number, number];
  readonly color: readonly number[];
  readonly shape?: "box" | "sphere" | "capsule" | "cylinder";
  readonly creature?: string | null;
  readonly frozen?: boolean;
  readonly mass?: number;
}

export interface SceneJoint {
  readonly name: string;
  readonly kind?: string;
  /** Which cubes of the scene it holds. */
  readonly a: number;
  readonly b: number;
  /** Where it is, and its axis, both in the frame of the first cube. */
  readonly anchor?: readonly [number, number, number];
  readonly axis?: readonly [number, number, number];
}

export interface Scenery {
  readonly ground?: boolean;
  readonly boxes?: readonly { size: readonly number[]; position: readonly number[]; quaternion: readonly number[]; shape?: string }[];
  readonly planets?: readonly { position: readonly number[]; radius: number }[];
  /** What all is in, kg/m3, up to its level, m; without one everywhere. */
  readonly medium?: { readonly density: number; readonly level: number | null };
  readonly landscape?: { readonly size: readonly number[]; readonly heights: readonly (readonly number[])[] } | null;
}

export interface Scene {
  readonly type: "scene";
  readonly scene: number;
  readonly world?: string;
  readonly frame?: number;
  readonly dims?: number;
  readonly tick_rate?: number;
  readonly cubes: readonly SceneCube[];
  readonly joints: readonly SceneJoint[];
  readonly creatures?: readonly { name: string; genome?: string; target?: unknown }[];
  readonly scenery?: Scenery;
}

/** Where food is. */
export type Food = readonly (readonly number[])[];

/** Places in the scene of what touches (-1: ground), position, normal, force (N). */
export type Contact = readonly [number, number, number, number, number, number, number, number, number];

/** A joint's place in the scene, and what its motor does (N m, of a slide N). */
export type Effort = readonly [number, number];

/** The place of a cube in the scene, where it was pushed (m), the force (N) and the torque (N m). */
export type Push = readonly [number, number, number, number, number, number, number, number, number, number];

export const STRIDE = 7; // numbers of a cube: position x y z, quaternion x y z w

/** A binary frame. */
export interface Frame {
  readonly scene: number;
  readonly frame: number;
  readonly poses: Float32Array;
}

/** Reads a binary frame. */
export function frame(bytes: ArrayBuffer): Frame {
  const head = new DataView(bytes, 0, 8);
  return { scene: head.getUint32(0, true), frame: head.getUint32(4, true), poses: new Float32Array(bytes, 8) };
}
