/** The controls of a joint, of a body as it stands and of one that grows: its type, and its axis in any direction. */
import { h } from "../dom.js";
import { slider } from "./controls.js";
import type { Hold, JointType, Vector } from "./genome.js";

const AXES = ["x", "y", "z"] as const;
const SMALLEST = 1e-6; // that one number of an axis has to be

export const JOINTS: readonly (readonly [JointType, string])[] = [
  ["fixed", "fixed"], ["hinge", "hinge: turns"], ["slide", "slide: shifts"],
  ["pin", "pin: every way"], ["conetwist", "cone and twist"],
];

/** Buttons for the axis along x, y or z, and its three numbers, for any other. */
export function axisRows({ type, axis: given }: Hold, set: (axis: Vector, final: boolean) => void): HTMLElement[] {
  let axis: Vector = given ?? (type === "hinge" ? [0, 0, 1] : [1, 0, 0]);
  const buttons = AXES.map((name, i) => {
    const along = axis.every((value, j) => (Math.abs(value) > 1e-9) === (i === j));
    return h("button", { class: "small", "aria-pressed": String(along), onclick: () => set(AXES.map((_, j) => (i === j ? 1 : 0)) as unknown as Vector, true) }, name);
  });
  return [
    h("div", { class: "choice", role: "group", "aria-label": "Axis" }, h("span", { class: "label" }, "Axis"), h("div", { class: "row" }, ...buttons)),
    ...AXES.map((name, i) => slider({
      label: `Axis along ${name}`, value: axis[i] ?? 0, low: -1, high: 1, step: 0.05,
      set: (value, final) => {
        const turned = axis.map((each, j) => (i === j ? Math.min(Math.max(value, -1000), 1000) : each)) as unknown as Vector;
        if (Math.max(...turned.map(Math.abs)) >= SMALLEST) { // one of no length is none: it waits for another number
          axis = turned;
          set(axis, final);
        }
      },
    })),
  ];
}
