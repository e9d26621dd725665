/** The inspector for bodies that grow: the parts of the graph, and on what each grows. */
import { action } from "../command.js";
import { h } from "../dom.js";
import { choice, panel, slider, tick } from "./controls.js";
import { edges, type Connection, type Face, type Hold, type JointType, type Part, type Vector } from "./genome.js";
import { changeConnection, changePart, graphOf, grow, partOf, prune } from "./graph.js";
import { JOINTS, axisRows } from "./joints.js";
import type { Shop } from "./panels.js";

const FACES: readonly Face[] = ["+x", "-x", "+y", "-y", "+z", "-z"];

/** All parts of the graph; one is chosen by itself, or by what grew of it. */
export function graphPanels(shop: Shop): HTMLElement[] {
  const graph = graphOf(shop.genome);
  const chosen = shop.chosen === undefined ? undefined : partOf(shop.genome, shop.chosen);
  const items = graph.parts.map((part) => h("li", {}, h("button", { class: "ghost small part", "aria-pressed": String(part === chosen), onclick: () => shop.choose(part.id) }, part.id,
    part.id === graph.root && h("span", { class: "badge" }, "root"))));
  const panels = [panel("Parts that grow", shop.memory, true, h("p", { class: "hint" }, "This body grows: each part as often as its connections say."), h("ul", { class: "parts" }, ...items))];
  if (chosen === undefined) return panels;
  const size = edges(chosen);
  const shape = (fields: Parameters<typeof changePart>[2], step?: string): void => shop.commit(changePart(shop.genome, chosen.id, fields), step);
  const bare = shop.stamp === "leg" ? "+z" : "+x";
  panels.push(panel("Chosen part", shop.memory, true,
    h("div", { class: "title" }, h("strong", {}, chosen.id), chosen.id !== graph.root && action({ label: "Remove this part", icon: "trash", bare: true, look: "danger", run: () => { shop.commit(prune(shop.genome, chosen.id)); shop.choose(undefined); } })),
    ...["Length (x)", "Height (y)", "Width (z)"].map((label, axis) => slider({ label, unit: "m", value: size[axis] ?? 0, low: 0.02, high: 1, step: 0.01,
      set: (value, final) => shape({ size: edges(graphOf(shop.genome).parts.find((each) => each.id === chosen.id) ?? chosen).map((edge, i) => (i === axis ? Math.min(Math.max(value, 0.01), 10) : edge)) as unknown as Vector }, final ? undefined : `grown ${axis}`) })),
    slider({ label: "Grown on one way", unit: "times", value: chosen.recursive_limit ?? 1, low: 1, high: 12, step: 1, set: (value, final) => shape({ recursive_limit: Math.min(Math.max(Math.round(value), 1), 64) }, final ? undefined : "times") }),
    action({ label: "Let a part grow on it", icon: "plus", run: () => shop.commit(grow(shop.genome, chosen.id, bare)) })));
  if (chosen.id !== graph.root) panels.push(holdPanel(shop, chosen));
  (graph.connections ?? []).forEach((each, i) => {
    if (each.from === chosen.id || each.to === chosen.id) panels.push(connectionPanel(shop, each, i));
  });
  return panels;
}

/** How a part hangs on the one that it grew on. */
function holdPanel(shop: Shop, { id, joint = { type: "fixed" } }: Part): HTMLElement {
  const driven = joint.type === "hinge" || joint.type === "slide";
  const now = (): Hold => partOf(shop.genome, id)?.joint ?? joint;
  const set = (hold: Hold, step?: string): void => shop.commit(changePart(shop.genome, id, { joint: hold }), step);
  const most = joint.type === "slide" ? 0.5 : 3.1;
  const limit = (end: 0 | 1): HTMLElement => slider({
    label: end === 0 ? "Lowest" : "Highest", unit: joint.type === "slide" ? "m" : "rad", value: joint.limits?.[end] ?? 0, low: end === 0 ? -most : 0, high: end === 0 ? 0 : most, step: 0.05,
    set: (value, final) => {
      const [low, high] = now().limits ?? [0, 0];
      set({ ...now(), limits: end === 0 ? [Math.min(value, 0), high] : [low, Math.max(value, 0)] }, final ? undefined : `limit ${end} ${id}`);
    },
  });
  const typed = (type: JointType): Hold => {
    const { axis, limits, motor, ...rest } = now();
    const moves = type === "hinge" || type === "slide";
    return { ...rest, type, ...(moves && axis !== undefined ? { axis } : {}), ...(type === joint.type && limits !== undefined ? { limits } : {}), ...(moves && motor !== undefined ? { motor } : {}) };
  };
  return panel("Its joint", shop.memory, true,
    choice("Type", JOINTS, joint.type, (type) => set(typed(type as JointType))),
    ...(driven ? axisRows(joint, (axis, final) => set({ ...now(), axis }, final ? undefined : `axis ${id}`)) : []),
    ...(joint.limits === undefined ? [] : [limit(0), limit(1)]));
}

function connectionPanel(shop: Shop, each: Connection, index: number): HTMLElement {
  const set = (fields: Parameters<typeof changeConnection>[2], step?: string): void => shop.commit(changeConnection(shop.genome, index, fields), step);
  return panel(`${each.to} on ${each.from}`, shop.memory, true,
    choice("Face", FACES, each.face, (face) => set({ face: face as Face })),
    slider({ label: "Scale", value: each.scale ?? 1, low: 0.3, high: 2, step: 0.05, set: (value, final) => set({ scale: Math.min(Math.max(value, 0.1), 10) }, final ? undefined : `scale ${index}`) }),
    choice("Mirrored across", [["", "nothing"], "x", "y", "z"], each.mirror ?? "", (mirror) => set({ mirror: mirror === "" ? undefined : (mirror as "x" | "y" | "z") })),
    tick("Only at the end", each.terminal ?? false, (terminal) => set({ terminal: terminal ? true : undefined })));
}
