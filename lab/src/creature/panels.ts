/** The inspector of the builder: what there is to say about a body, the part that is chosen, its joint, senses and brain. */
import { action } from "../command.js";
import { fill, h, icon } from "../dom.js";
import { cubeOf, cubesOf, depthOf, hangsBy, jointsOf, twinOf } from "./anatomy.js";
import { entries, KINDS, type Kind, kindsFor, motorsOf, withBrain } from "./brains.js";
import { choice, panel, slider, tick } from "./controls.js";
import { JOINTS, axisRows } from "./joints.js";
import { add, change, join, motorize, move, rejoin, remove, reshape, resize, sense, type Stamp } from "./creature.js";
import { edges, type Face, fits, type Genome, type Joint, type JointType, type SensorEntry, type Shape, type Vector } from "./genome.js";
import { color } from "./portrait.js";

/** What the panels work on. */
export interface Shop {
  readonly genome: Genome;
  readonly chosen: string | undefined;
  readonly mirror: boolean;
  readonly stamp: Stamp;
  /** Which panels are open. */
  readonly memory: Map<string, boolean>;
  /** Goes on to another genome; `step` names what goes on while a slider is drawn. */
  commit(genome: Genome, step?: string): void;
  choose(id: string | undefined): void;
}

const FACES: readonly (readonly [Face, string])[] = [
  ["+x", "front"], ["-x", "back"], ["+y", "top"], ["-y", "bottom"], ["+z", "right"], ["-z", "left"],
];
const AXES = ["x", "y", "z"] as const;
const EDGES = ["Length (x)", "Height (y)", "Width (z)"] as const;
const SHAPES: readonly Shape[] = ["box", "sphere", "capsule", "cylinder"];
const BRAINS: Record<Kind, string> = {
  none: "It has no brain: it is driven from outside.",
  sine: "A wave for each motor.",
  cpg: "Waves that pull at each other, as in spines.",
  graph: "A network of any shape, as NEAT makes.",
  ctrnn: "Neurons that swing by themselves.",
  mlp: "Layers of units, which learning trains.",
};
const OF_JOINT = ["position", "velocity", "effort"];
const OF_CUBE = ["touch", "up", "height", "velocity", "spin", "target_direction", "target_distance", "food_direction", "food_distance"];

/** All parts, each under what it hangs on. */
export function partsPanel(shop: Shop): HTMLElement {
  const { genome } = shop;
  const items = cubesOf(genome).map((cube, i) => {
    const [r = 0, g = 0, b = 0] = color(cube, i);
    const dot = h("span", { class: "dot", style: { background: `rgb(${r * 255} ${g * 255} ${b * 255})` } });
    const button = h("button", { class: "ghost small part", "aria-pressed": String(cube.id === shop.chosen), onclick: () => shop.choose(cube.id) }, dot, cube.id);
    button.style.setProperty("margin-left", `${Math.min(depthOf(genome, cube.id), 6) * 14}px`);
    return h("li", {}, button);
  });
  const mass = cubesOf(genome).reduce((total, cube) => total + cube.mass, 0);
  const title = `Parts (${items.length})`;
  return panel(title, shop.memory, true, h("ul", { class: "parts" }, ...items), h("p", { class: "hint" }, `${mass.toFixed(1)} kg, ${motorsOf(genome).length} motors`));
}

/** The part that is chosen. */
export function partPanel(shop: Shop, id: string): HTMLElement {
  const { genome, mirror } = shop;
  const cube = cubeOf(genome, id);
  const size = edges(cube);
  const twin = twinOf(genome, id);
  const paint = h("input", { type: "color", value: hex(color(cube, cubesOf(genome).indexOf(cube))), "aria-label": "Colour" });
  paint.addEventListener("change", () => shop.commit(change(shop.genome, id, { color: rgb(paint.value) }, mirror)));
  const root = cubesOf(genome)[0]?.id === id;
  const resized = (axis: number, value: number, final: boolean): void => {
    const now = [...edges(cubeOf(shop.genome, id))] as [number, number, number];
    now[axis] = value;
    shop.commit(resize(shop.genome, id, now, mirror), final ? undefined : `size ${axis} ${id}`);
  };
  const moved = (axis: number, value: number, final: boolean): void => {
    const by = [0, 0, 0] as [number, number, number];
    by[axis] = value - (cubeOf(shop.genome, id).position[axis] ?? 0);
    shop.commit(move(shop.genome, id, by, mirror), final ? undefined : `move ${axis} ${id}`);
  };
  const axes = root ? ([] as const) : ([0, 2] as const); // how high it is follows from what it hangs on, and the ground
  return panel("Chosen part", shop.memory, true,
    h("div", { class: "title" }, h("strong", {}, id), paint, !root && action({
      label: "Remove this part", icon: "trash", bare: true, look: "danger",
      run: () => { shop.commit(remove(shop.genome, id, mirror)); shop.choose(undefined); },
    })),
    twin !== undefined && h("p", { class: "hint" }, mirror ? `Its twin ${twin.id} changes with it.` : `It has a twin, ${twin.id}, which stays as it is.`),
    ...AXES.map((_, axis) => slider({ label: EDGES[axis] ?? "", unit: "m", value: size[axis] ?? 0, low: 0.02, high: 1.2, step: 0.01, set: (value, final) => resized(axis, value, final) })),
    slider({ label: "Mass", unit: "kg", value: cube.mass, low: 0.05, high: 20, step: 0.05,
      set: (mass, final) => shop.commit(change(shop.genome, id, { mass }, mirror), final ? undefined : `mass ${id}`) }),
    ...axes.map((axis) => slider({ label: `Place along ${AXES[axis]}`, unit: "m", value: cube.position[axis] ?? 0, low: -1, high: 1, step: 0.01, set: (value, final) => moved(axis, value, final) })),
    choice("Shape", SHAPES, cube.shape ?? "box", (shape) => shop.commit(reshape(shop.genome, id, shape as Shape, mirror))),
    facesRow(shop, id),
    joinRow(shop, id));
}

/** What a click on a face does, for those who have no pointer. */
function facesRow(shop: Shop, id: string): HTMLElement {
  const buttons = FACES.map(([face, name]) => action({
    label: name,
    run: () => {
      const half = edges(cubeOf(shop.genome, id)).map((edge) => edge / 2);
      const at = AXES.map((axis, i) => (axis === face[1] ? (face[0] === "+" ? 1 : -1) * (half[i] ?? 0) : 0)) as unknown as Vector;
      const added = add(shop.genome, id, face, at, shop.stamp, shop.mirror);
      shop.commit(added.genome);
      shop.choose(added.id);
    },
  }));
  for (const button of buttons) button.classList.add("small");
  return h("fieldset", { class: "faces" }, h("legend", {}, `Add a ${shop.stamp} at its`), h("div", { class: "row" }, ...buttons));
}

function joinRow(shop: Shop, id: string): HTMLElement | undefined {
  const joined = new Set(jointsOf(shop.genome).flatMap((each) => (each.cube1 === id ? [each.cube2] : each.cube2 === id ? [each.cube1] : [])));
  const others = cubesOf(shop.genome).map((cube) => cube.id).filter((other) => other !== id && !joined.has(other));
  if (others.length === 0) return undefined;
  return choice("Join it to", [["", "another part …"], ...others.map((other) => [other, other] as const)], "", (other) => {
    if (other !== "") shop.commit(join(shop.genome, id, other, "fixed").genome);
  });
}

/** The joint by which the chosen part hangs, with its motor and the wave that drives it. */
export function jointPanel(shop: Shop, id: string): HTMLElement | undefined {
  const joint = hangsBy(shop.genome, id);
  if (joint === undefined) return undefined;
  const { mirror } = shop;
  const set = (fields: Parameters<typeof rejoin>[2], step?: string): void => shop.commit(rejoin(shop.genome, joint.id, fields, mirror), step);
  const driven = joint.type === "hinge" || joint.type === "slide";
  const unit = joint.type === "slide" ? "m" : "rad";
  const most = joint.type === "slide" ? 0.5 : 3.1;
  const now = (): Joint => hangsBy(shop.genome, id) as Joint;
  const limit = (end: 0 | 1, label: string): HTMLElement => slider({
    label, unit, value: joint.limits?.[end] ?? 0, low: end === 0 ? -most : 0, high: end === 0 ? 0 : most, step: 0.05,
    set: (value, final) => {
      const limits = [...(now().limits ?? [0, 0])] as [number, number];
      limits[end] = end === 0 ? Math.min(value, 0) : Math.max(value, 0);
      set({ limits }, final ? undefined : `limit ${end} ${joint.id}`);
    },
  });
  return panel("Its joint", shop.memory, true,
    choice("Type", JOINTS, joint.type, (type) => set({ type: type as JointType })),
    ...(driven ? axisRows(joint, (axis, final) => set({ axis }, final ? undefined : `axis ${joint.id}`)) : []),
    driven && tick("It has limits", joint.limits !== undefined, (on) => set({ limits: on ? [-most / 3, most / 3] : undefined })),
    joint.limits !== undefined && limit(0, "Lowest"),
    joint.limits !== undefined && limit(1, "Highest"),
    driven && tick("It has a motor", joint.motor !== undefined, (on) => (on ? shop.commit(motorize(shop.genome, joint.id, mirror)) : set({ motor: undefined }))),
    ...(joint.motor === undefined ? [] : motorRows(joint, now, unit, set)),
    ...waveRows(shop, joint));
}

function motorRows(joint: Joint, now: () => Joint, unit: string, set: (fields: { motor: NonNullable<Joint["motor"]> }, step?: string) => void): HTMLElement[] {
  const motor = joint.motor as NonNullable<Joint["motor"]>;
  const change = (fields: Partial<typeof motor>, step?: string): void => set({ motor: { ...(now().motor ?? motor), ...fields } }, step);
  const speed = motor.mode === "velocity";
  const reach = Math.max(...motor.range.map(Math.abs));
  return [
    choice("Motor", [["position", "aims at a position"], ["velocity", "aims at a speed"]], motor.mode, (mode) =>
      change(mode === "velocity" ? { mode, range: [-10, 10] } : { mode: "position", range: joint.type === "slide" ? [-0.1, 0.1] : [-0.8, 0.8] })),
    slider({ label: "Reach", unit: speed ? `${unit}/s` : unit, value: reach, low: 0.05, high: speed ? 20 : joint.type === "slide" ? 0.5 : 3.1, step: 0.05,
      set: (value, final) => change({ range: [-value, value] }, final ? undefined : `reach ${joint.id}`) }),
    slider({ label: "Strength", unit: joint.type === "slide" ? "N" : "N m", value: motor.max_effort, low: 1, high: joint.type === "slide" ? 500 : 100, step: 1,
      set: (value, final) => change({ max_effort: Math.max(0, value) }, final ? undefined : `effort ${joint.id}`) }),
  ];
}

interface Wave {
  readonly motor: string;
  readonly frequency?: number;
  readonly amplitude?: number;
  readonly phase?: number;
  readonly offset?: number;
}

const WAVES = [["frequency", "Swings", "a second", 0, 5, 1], ["amplitude", "Swing", "of its reach", 0, 1, 0.5], ["phase", "Begins at", "rad", -3.15, 6.3, 0], ["offset", "Middle", "of its reach", -1, 1, 0]] as const;

/** The oscillator that drives a motor, where its brain has such. */
function waveRows(shop: Shop, joint: Joint): HTMLElement[] {
  const waves = shop.genome.brain?.["oscillators"] as readonly Wave[] | undefined;
  if (waves === undefined || joint.motor === undefined) return [];
  const own = waves.findIndex((wave) => wave.motor === joint.id);
  const place = own >= 0 ? own : waves.findIndex((wave) => fits(wave.motor, joint.id));
  const wave = waves[place];
  if (wave === undefined) return [];
  const rows = WAVES.map(([field, label, unit, low, high, usual]) => slider({
    label, unit, value: wave[field] ?? usual, low, high, step: 0.05,
    set: (value, final) => {
      const brain = shop.genome.brain;
      if (brain === undefined) return;
      const oscillators = (brain["oscillators"] as readonly Wave[]).map((each, i) => (i === place ? { ...each, [field]: value } : each));
      shop.commit({ ...shop.genome, brain: { ...brain, oscillators } }, final ? undefined : `${field} ${place}`);
    },
  }));
  return [h("h3", {}, wave.motor === joint.id ? "Its wave" : `Its wave, shared by ${wave.motor}`), ...rows];
}

/** What it senses. */
export function sensesPanel(shop: Shop): HTMLElement {
  const { genome } = shop;
  const own = genome.sensors;
  const list = h("ul", { class: "list" }, ...entries(genome).map((entry, i) => h("li", {}, h("span", {}, entry.id ?? `${entry.joint ?? entry.cube ?? ""} · ${entry.type}`),
    own !== undefined && action({ label: "Remove this sense", icon: "close", bare: true, look: "ghost", run: () => shop.commit(sense(shop.genome, own.filter((_, j) => j !== i))) }))));
  const kinds = [...OF_CUBE.map((type) => [`cube ${type}`, `${type} of a part`] as const), ...OF_JOINT.map((type) => [`joint ${type}`, `${type} of a joint`] as const)];
  const kind = choice("Add", kinds, "cube touch", () => targets());
  const where = h("div", {});
  const picked = (element: HTMLElement): string => (element.querySelector("select") as HTMLSelectElement).value;
  const targets = (): void => {
    const names = picked(kind).startsWith("joint") ? jointsOf(genome).filter((each) => each.type === "hinge" || each.type === "slide") : cubesOf(genome);
    fill(where, choice("of", ["*", ...names.map((each) => each.id)], shop.chosen ?? "*", () => undefined));
  };
  targets();
  const adding = action({ label: "Add this sense", icon: "plus", run: () => {
    const [on = "cube", type = "touch"] = picked(kind).split(" ");
    const entry = { type, [on]: picked(where) } as unknown as SensorEntry;
    shop.commit(sense(shop.genome, [...(shop.genome.sensors ?? []), entry]));
  } });
  return panel("Senses", shop.memory, false,
    tick("The senses that every body has", own === undefined, (on) => shop.commit(sense(shop.genome, on ? undefined : entries(shop.genome)))),
    list, own !== undefined && h("div", { class: "adding" }, kind, where, adding));
}

/** The brain, by kinds. */
export function brainPanel(shop: Shop): HTMLElement {
  const { genome } = shop;
  const kind = genome.brain?.kind ?? "none";
  const known = (KINDS as readonly string[]).includes(kind);
  const kinds = kindsFor(genome);
  const options = [...kinds, ...((kinds as readonly string[]).includes(kind) ? [] : [kind])];
  const told = known ? `${BRAINS[kind as Kind]} ` : "";
  return panel("Brain", shop.memory, true,
    choice("Kind", options, kind, (chosen) => shop.commit(withBrain(shop.genome, chosen as Kind))),
    h("p", { class: "hint" }, genome.body.graph === undefined && motorsOf(genome).length === 0 ? "It has no motors yet: a leg, a segment or a wheel brings one." : told + size(genome)),
    kind !== "none" && (kinds as readonly string[]).includes(kind) && action({ label: "Make it anew for this body", icon: "reset", run: () => shop.commit(withBrain(shop.genome, kind as Kind)) }));
}

function size(genome: Genome): string {
  const counts = Object.entries(genome.brain ?? {}).flatMap(([name, value]) => (Array.isArray(value) && value.length > 0 ? [`${value.length} ${name.replace("_", " ")}`] : []));
  return counts.length === 0 ? "" : `${counts.join(", ")}.`;
}

/** What the check found, each with its place; a click leads to the part. */
export function problemsPanel(shop: Shop, problems: readonly { path: string; message: string }[] | undefined): HTMLElement {
  if (problems === undefined) return h("div", { class: "verdict", role: "status" }, "Checking …");
  if (problems.length === 0) return h("div", { class: "verdict good", role: "status" }, icon("check"), "A good genome");
  const items = problems.map(({ path, message }) => h("li", {},
    h("button", { class: "ghost small", onclick: () => shop.choose(partAt(shop.genome, path) ?? shop.chosen) }, h("code", {}, path === "" ? "genome" : path)), h("span", {}, message)));
  return h("div", { class: "verdict bad", role: "status" },
    h("p", {}, icon("warning"), problems.length === 1 ? "One problem" : `${problems.length} problems`), h("ul", {}, ...items));
}

/** The part that a place in the document is about: `body/cubes/3/size`, `body/joints/1`. */
function partAt(genome: Genome, path: string): string | undefined {
  const [, kind, index] = path.split("/");
  if (kind === "cubes") return cubesOf(genome)[Number(index)]?.id;
  return kind === "joints" ? jointsOf(genome)[Number(index)]?.cube2 : undefined;
}

function hex(own: readonly number[]): string {
  return `#${own.slice(0, 3).map((value) => Math.round(value * 255).toString(16).padStart(2, "0")).join("")}`;
}

function rgb(text: string): number[] {
  return [1, 3, 5].map((at) => Math.round((parseInt(text.slice(at, at + 2), 16) / 255) * 1000) / 1000);
}
