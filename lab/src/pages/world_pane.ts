/** One world, live: drawn as it moves, with its clock, what can be put into it, and an inspector of what is clicked. */
import type { ApplyForce, CubeInfo, SpawnCreature, WorldInfo } from "nmes-client";
import { get, kept, part, socketUrl, words } from "../api.js";
import { type Command as Shown, action, done, line, preview } from "../command.js";
import { Link } from "../connection.js";
import { type Child, fill, h, icon, select } from "../dom.js";
import { type Contact, type Effort, type Food, type Push, type Scene, frame } from "../poses.js";
import { type Pull, Stage } from "../scene.js";
import { address, attempt, notify } from "../shell.js";
import { Visit } from "../world.js";

const LOOK = 1000; // ms between two looks at what the inspector shows
const STIFFNESS = 45; // N/m for each kg that is pulled
const STRONGEST = 400; // N for each kg

type Force = ApplyForce & { type: "apply_force" };

/** Returns a pane that shows a world until the signal. */
export function pane(world: string, signal: AbortSignal, close?: () => void): HTMLElement {
  return new Pane(world, signal, close).element;
}

class Pane {
  readonly element: HTMLElement;
  private readonly visit: Visit;
  private readonly stage: Stage;
  private readonly clock = h("span", { class: "mono clock" }, "–");
  private readonly badge = h("span", { class: "badge" }, "connecting");
  private readonly following = select([["", "Follow nobody"]], "", { "aria-label": "Follow a creature" });
  private readonly inspector = h("div", { class: "inspector" });
  private readonly running: HTMLButtonElement;
  private readonly mode: HTMLSelectElement;
  private readonly contacts: HTMLInputElement;
  private readonly motors: HTMLInputElement;
  private readonly pushes: HTMLInputElement;
  private link: Link | undefined;
  private linked: AbortController | undefined;
  private readonly banner = h("div");
  private scene: Scene | undefined;
  private info: WorldInfo | undefined;
  private chosen: string | undefined;
  // `at`: in which frame a force was due last; `waiting`: whether one has no answer yet
  private pulled: { pull: Pull; at: number; sent?: Force; waiting: boolean; refused: boolean } | undefined;
  private now = -1; // the frame that the world has told last
  private frames = 0;
  private pulls = 0; // that were answered
  private known = 0; // creatures of the scene before

  constructor(private readonly world: string, private readonly signal: AbortSignal, close: (() => void) | undefined) {
    this.visit = new Visit(world, signal, (event) => this.told(event));
    this.stage = new Stage(`The world ${world}`, signal, { pick: (cube) => this.pick(cube), pull: (pull) => this.pull(pull) });
    this.running = action({
      label: "Pause", icon: "pause", command: () => this.message(this.info?.paused === true ? { type: "resume" } : { type: "pause" }),
      run: async () => {
        await (this.info?.paused === true ? this.visit.request({ type: "resume" }) : this.visit.request({ type: "pause" }));
        await this.learn();
      },
    });
    this.mode = select([["realtime", "Real time"], ["lockstep", "Lockstep"], ["fast", "As fast as it can"]], "realtime", { "aria-label": "What makes it tick" });
    this.mode.addEventListener("change", () => void attempt(async () => {
      const message = { type: "set_mode", mode: this.mode.value as WorldInfo["mode"] } as const;
      await this.visit.request(message);
      done(this.message(message));
      await this.learn();
    }));
    const forces = (tells: () => Shown): HTMLInputElement => {
      const box = h("input", { type: "checkbox", onchange: () => {
        this.connect();
        if (box.checked) {
          done(tells());
        }
      } });
      return box;
    };
    this.contacts = forces(() => this.message({ type: "get_world_state", sensors: true }));
    this.motors = forces(() => this.message({ type: "batch", commands: (this.scene?.joints ?? []).slice(0, 100).map(({ name }) => ({ type: "get_joint_info", joint_name: name })) }));
    this.pushes = forces(() => `${line("nmes", "export", kept("recordings", `${this.world}-`))}*.mcap --to jsonl`);
    this.following.addEventListener("change", () => this.follow());
    this.element = this.layout(close);
    this.connect();
    const timer = setInterval(() => document.hidden || void this.look(), LOOK);
    signal.addEventListener("abort", () => clearInterval(timer));
  }

  private message(message: object): Shown {
    return { world: this.world, message };
  }

  private layout(close: (() => void) | undefined): HTMLElement {
    const joints = h("input", { type: "checkbox", checked: true, onchange: (event: Event) => { this.stage.joints = (event.target as HTMLInputElement).checked; this.stage.refresh(); } });
    const ticks = h("input", { type: "number", min: 1, max: 10000, value: "1", "aria-label": "How many ticks", class: "few" });
    const step = action({
      label: "Step", icon: "step", command: () => this.message({ type: "step", ticks: Number(ticks.value) }),
      run: () => this.visit.request({ type: "step", ticks: Number(ticks.value) }),
    });
    const reset = action({
      label: "Reset", icon: "reset", look: "ghost", command: () => this.message({ type: "reset" }),
      run: async () => confirm(`Empty ${this.world}, back to tick 0?`) && this.visit.request({ type: "reset" }),
    });
    const push = h("button", { class: "small", "aria-pressed": "false", title: "Drag a cube to push it; or hold Shift and drag", onclick: () => {
      this.stage.pulling = !this.stage.pulling;
      push.setAttribute("aria-pressed", String(this.stage.pulling));
    } }, "Push by dragging");
    this.stage.element.append(h("div", { class: "hud" }, this.badge, this.clock),
      h("button", { class: "square corner", title: "Show all", "aria-label": "Show all", onclick: () => this.stage.overview() }, icon("follow", 18)));
    return h("section", { class: "pane", "aria-label": this.world },
      close !== undefined && h("div", { class: "bar" }, h("h2", { class: "breaks" }, this.world), h("span", { class: "grow" }),
        h("button", { class: "ghost square small", "aria-label": `Close the view of ${this.world}`, onclick: close }, icon("close", 16))),
      this.banner,
      h("div", { class: "watching" },
        h("div", { class: "stack" }, this.stage.element,
          h("div", { class: "bar controls" }, this.running, step, ticks, this.mode, h("span", { class: "grow" }), this.following),
          h("div", { class: "bar options" },
            h("label", { class: "check" }, joints, "Joints"), h("label", { class: "check", title: "Where cubes touch, and the force along the normal" }, this.contacts, "Contacts"),
            h("label", { class: "check", title: "What motors do: torque or force along the axis of the joint" }, this.motors, "Motors"),
            h("label", { class: "check", title: "What clients push, while they do: force, and torque along its axis" }, this.pushes, "Pushes"),
            push, h("span", { class: "hint" }, "Click a cube to inspect it."), h("span", { class: "grow" }), reset)),
        h("div", { class: "stack side" }, this.arrivals(), h("div", { class: "card" }, this.inspector),
          h("p", { class: "hint" }, "All that happens here is recorded. ", h("a", { href: `#/recordings?name=${encodeURIComponent(this.world)}` }, "Its recordings")))));
  }

  /** What can be put into the world. */
  private arrivals(): HTMLElement {
    const genomes = select([["", "Loading …"]], "", { "aria-label": "Genome" });
    const autonomous = h("input", { type: "checkbox", checked: true });
    let genome: Record<string, unknown> | undefined;
    const fetched = async (): Promise<void> => {
      genome = undefined;
      const name = genomes.value;
      const document = await get<Record<string, unknown>>(`/genomes/${part(name)}`, {}, this.signal);
      genome = genomes.value === name ? document : genome;
    };
    const choose = (): void => void attempt(fetched);
    void get<{ items: { name: string }[] }>("/genomes").then(({ items }) => {
      fill(genomes, ...items.map(({ name }) => h("option", { value: name }, name)));
      choose();
    }, (error: unknown) => fill(genomes, h("option", { value: "" }, words(error))));
    genomes.addEventListener("change", choose);
    const message = (): SpawnCreature & { type: "spawn_creature" } =>
      ({ type: "spawn_creature", genome: genome ?? {}, position: this.free(), autonomous: autonomous.checked });
    const drop = action({
      label: "Drop it in", look: "primary", command: () => this.message(message()),
      run: async () => {
        if (genome === undefined) {
          await fetched();
        }
        const { creature } = await this.visit.request(message());
        this.stage.widen();
        notify(`${creature} is in ${this.world}.`, "good");
      },
    });
    const cube = action({
      label: "Drop a cube", command: () => this.message({ type: "spawn_cube", position: this.above() }),
      run: () => this.visit.request({ type: "spawn_cube", position: this.above() }),
    });
    return h("div", { class: "card stack" }, h("h2", {}, "Put in"), genomes,
      h("label", { class: "check" }, autonomous, "The world runs its brain"), h("div", { class: "row" }, drop, cube));
  }

  /** A place on the ground where nobody is: beside all that is there. */
  private free(): [number, number, number] {
    const places = (this.scene?.cubes ?? []).map((_, cube) => this.stage.position(cube)[0]);
    return [places.length === 0 ? 0 : Math.round((Math.max(...places) + 2) * 10) / 10, 0, 0];
  }

  private above(): [number, number, number] {
    const [x, , z] = this.stage.target();
    return [Math.round(x * 100) / 100, 3, Math.round(z * 100) / 100];
  }

  /** Watches, with contacts, motors and pushes or without; anew when that changes. */
  private connect(): void {
    this.linked?.abort();
    this.linked = new AbortController();
    const query = { world: this.world, ...(this.contacts.checked ? { contacts: "1" } : {}), ...(this.motors.checked ? { motors: "1" } : {}), ...(this.pushes.checked ? { pushes: "1" } : {}) };
    this.link = new Link(socketUrl("/ws/poses", query), {
      open: () => void this.enter(),
      message: (message) => this.read(message),
      data: (bytes) => this.show(bytes),
    }, AbortSignal.any([this.signal, this.linked.signal]));
    fill(this.banner, this.link.banner);
    if (!this.contacts.checked) {
      this.stage.touch([]);
    }
    if (!this.motors.checked) {
      this.stage.strain([]);
    }
    if (!this.pushes.checked) {
      this.stage.push([]);
    }
  }

  private read(message: Record<string, unknown>): void {
    if (message["type"] === "scene") {
      this.scene = message as unknown as Scene;
      this.stage.describe(this.scene);
      this.describe();
    } else if (message["type"] === "food") {
      this.stage.feed((message as { food?: Food }).food ?? []);
    } else if (message["type"] === "contacts") {
      this.stage.touch((message as { contacts?: readonly Contact[] }).contacts ?? []);
    } else if (message["type"] === "motors") {
      this.stage.strain((message as { motors?: readonly Effort[] }).motors ?? []);
    } else if (message["type"] === "pushes") {
      this.stage.push((message as { pushes?: readonly Push[] }).pushes ?? []);
    }
  }

  private show(bytes: ArrayBuffer): void {
    const read = frame(bytes);
    this.stage.show(read);
    this.frames++;
    this.element.dataset["frames"] = String(this.frames);
    this.tell(read.frame);
  }

  /** Draws what a new scene changes beside the picture. */
  private describe(): void {
    const creatures = this.creatures();
    const alone = this.known === 0 && creatures.length === 1; // who comes alone is followed, so that it is not lost
    const chosen = alone ? creatures[0] : this.following.value;
    this.known = creatures.length;
    fill(this.following, h("option", { value: "" }, "Follow nobody"), ...creatures.map((name) => h("option", { value: name, selected: name === chosen }, name)));
    this.follow();
    this.stage.choose(this.place(this.chosen));
    this.inspect();
  }

  private creatures(): string[] {
    const listed = this.scene?.creatures?.map(({ name }) => name);
    return listed ?? [...new Set((this.scene?.cubes ?? []).map(({ creature }) => creature).filter((name) => typeof name === "string"))];
  }

  private follow(): void {
    const name = this.following.value;
    this.stage.follow(name === "" ? [] : (this.scene?.cubes ?? []).flatMap(({ creature }, cube) => (creature === name ? [cube] : [])));
  }

  private place(name: string | undefined): number {
    return name === undefined ? -1 : (this.scene?.cubes ?? []).findIndex((cube) => cube.name === name);
  }

  /** Enters, and has the world tell its time also while nothing moves, when no poses come. */
  private async enter(): Promise<void> {
    await this.learn();
    if (this.info !== undefined) {
      await attempt(() => this.visit.request({ type: "subscribe", events: ["tick"], every: Math.max(Math.round(this.rate() / 4), 1) }));
    }
  }

  private rate(): number {
    const rate = this.info?.config["tick_rate"] ?? this.scene?.tick_rate;
    return typeof rate === "number" ? rate : 60;
  }

  private tell(frame: number): void {
    this.now = frame;
    const { pulled } = this;
    // Of the two sockets that tell frames one may be behind the other; far behind is a world that was reset.
    if (pulled !== undefined && (frame > pulled.at || frame < pulled.at - this.rate())) {
      pulled.at = frame;
      void this.push();
    }
    this.clock.textContent = `${(frame / this.rate()).toFixed(2)} s · ${frame.toLocaleString("en")}`;
  }

  /** Asks how the world is: when it is entered, and after its clock was changed. */
  private async learn(): Promise<void> {
    try {
      this.info = await this.visit.request({ type: "get_world_info" });
    } catch (error) {
      this.badge.className = "badge bad";
      this.badge.textContent = words(error);
      return;
    }
    const { paused, mode, fault, backend, frame: now } = this.info;
    this.tell(now);
    const stopped = fault as { code: string; message: string } | null;
    this.badge.className = `badge ${stopped === null ? (paused ? "warn" : "good") : "bad"}`;
    this.badge.textContent = stopped !== null ? `stopped: ${stopped.message}` : paused ? "paused" : mode === "lockstep" ? "waits for steps" : "runs";
    this.badge.title = backend;
    fill(this.running, icon(paused ? "play" : "pause", 18), paused ? "Resume" : "Pause");
    this.mode.value = mode;
    this.inspect();
  }

  private told(event: { readonly type: string; readonly [more: string]: unknown }): void {
    if (event.type === "tick") {
      this.tell(Number(event["frame"]));
    } else if (event.type === "world_fault") {
      void this.learn();
    } else if (event.type === "world_closed") {
      this.badge.className = "badge bad";
      this.badge.textContent = "closed";
    }
  }

  private pick(cube: number): void {
    this.chosen = this.scene?.cubes[cube]?.name;
    this.stage.choose(cube);
    this.inspect();
  }

  private cube: CubeInfo | undefined;

  /** Looks at the chosen cube again. */
  private async look(): Promise<void> {
    const { chosen } = this;
    if (chosen === undefined || this.place(chosen) < 0) {
      return;
    }
    try {
      this.cube = await this.visit.request({ type: "get_cube_info", cube_name: chosen });
      if (this.chosen === chosen) {
        this.inspect();
      }
    } catch (error) {
      fill(this.inspector, h("h2", {}, chosen), h("p", { class: "bad" }, words(error)));
    }
  }

  private inspect(): void {
    const place = this.place(this.chosen);
    const drawn = this.scene?.cubes[place];
    if (drawn === undefined) {
      fill(this.inspector, this.overview());
      return;
    }
    if (this.cube?.cube_name !== drawn.name) {
      this.cube = undefined;
      void this.look();
    }
    const { cube } = this;
    const creature = drawn.creature;
    fill(this.inspector, h("div", { class: "bar titled" }, h("h2", { class: "breaks" }, drawn.name),
      h("button", { class: "ghost square small", "aria-label": "Inspect nothing", onclick: () => this.pick(-1) }, icon("close", 16))),
    facts([
      ["Creature", typeof creature === "string" && h("a", { href: address("brain", this.world, creature) }, creature)],
      ["Shape", `${drawn.shape ?? "box"}, ${drawn.size.map(short).join(" × ")} m`],
      ["Mass", cube && `${short(cube.mass)} kg`],
      ["Position", cube && vector(cube.position, "m")],
      ["Speed", cube && `${short(Math.hypot(...cube.linear_velocity))} m/s`],
      ["Friction", cube && short(cube.friction)],
      ["Joints", cube && cube.joints.join(", ")],
      ["Touches", cube && touched(cube)],
      ["State", cube && [cube.frozen && "frozen", cube.sleeping && "at rest"].filter(Boolean).join(", ")],
    ]));
  }

  private overview(): Child {
    const creatures = this.creatures();
    return [h("h2", {}, "In this world"), facts([
      ["Cubes", String(this.scene?.cubes.length ?? "–")],
      ["Joints", String(this.scene?.joints.length ?? "–")],
      ["Creatures", String(creatures.length)],
      ["Engine", this.info && `${this.info.backend} ${this.info.versions.engine}`],
      ["Seed", this.info && String(this.info.seed)],
      ["Clients", this.info && String(this.info.counts.clients)],
    ]), creatures.length > 0 && h("ul", { class: "list" }, ...creatures.slice(0, 30).map((name) => h("li", {},
      h("button", { class: "ghost small", title: "Follow it", onclick: () => { this.following.value = name; this.follow(); } }, icon("follow", 16), name),
      h("a", { href: address("brain", this.world, name) }, "brain"))))];
  }

  /**
   * Pulls a cube towards the pointer, tick by tick, until it is let go: a force acts for one tick, and all that come
   * before a tick act together. So one is sent for each that the world tells of, and one at first where it ticks by itself;
   * and none while another has no answer, or a page that was held up would send all that it missed at once.
   */
  private pull(pull: Pull | null): void {
    if (pull === null) {
      void this.letGo();
    } else if (this.pulled !== undefined) {
      this.pulled.pull = pull;
    } else {
      this.pulled = { pull, at: this.now, waiting: false, refused: false };
      preview(this.message(this.force(pull)));
      if (this.info?.paused === false && this.info.mode !== "lockstep") {
        void this.push();
      }
    }
  }

  /** Sends a force; what was refused once is not tried again until another cube is gripped. */
  private async push(): Promise<void> {
    const { pulled } = this;
    if (pulled !== undefined && !pulled.waiting && !pulled.refused) {
      pulled.sent = this.force(pulled.pull);
      pulled.waiting = true;
      try {
        await this.visit.request(pulled.sent);
      } catch (error) {
        pulled.refused = true;
        notify(words(error), "bad");
      } finally {
        pulled.waiting = false;
        this.element.dataset["pulls"] = String(++this.pulls);
      }
    }
  }

  /** Ends a pull. Where the world stands still and nothing was sent, one force is, for the next tick, if the cube is there. */
  private async letGo(): Promise<void> {
    const { pulled } = this;
    if (pulled !== undefined && pulled.sent === undefined && this.place(pulled.pull.cube) >= 0) {
      await this.push();
    }
    if (this.pulled === pulled) {
      this.pulled = undefined;
    }
    if (pulled?.sent !== undefined && !pulled.refused) {
      done(this.message(pulled.sent));
    }
  }

  private force({ cube, grip, to }: Pull): Force {
    const cubes = this.scene?.cubes ?? [];
    const { creature } = cubes.find(({ name }) => name === cube) ?? {};
    const pulled = cubes.filter((each) => each.name === cube || (typeof creature === "string" && each.creature === creature));
    const mass = pulled.reduce((total, each) => total + (each.mass ?? 1), 0);
    const way = to.map((value, axis) => (value - (grip[axis] ?? 0)) * STIFFNESS * mass);
    const scale = Math.min(1, (STRONGEST * mass) / Math.max(Math.hypot(...way), 1e-9));
    const [x = 0, y = 0, z = 0] = way.map((value) => Math.round(value * scale * 1000) / 1000);
    return { type: "apply_force", cube_name: cube, force: [x, y, z], at: [grip[0], grip[1], grip[2]] };
  }
}

function facts(rows: readonly (readonly [string, Child])[]): HTMLElement {
  return h("dl", { class: "facts" }, ...rows.flatMap(([name, value]) =>
    (value === undefined || value === false || value === "" ? [] : [h("dt", {}, name), h("dd", {}, value)])));
}

/** What a cube touches, each with the force that all contacts with it have together. */
function touched({ contacts }: CubeInfo): string {
  const forces = new Map<string, number>();
  for (const { cube_name: name, force } of contacts) {
    forces.set(name ?? "ground", (forces.get(name ?? "ground") ?? 0) + force);
  }
  return [...forces].map(([name, force]) => `${name} (${short(force)} N)`).join(", ");
}

function short(value: number): string {
  return value.toLocaleString("en", { maximumSignificantDigits: 4 });
}

function vector(values: readonly number[], unit: string): string {
  return `${values.map((value) => value.toFixed(2)).join(", ")} ${unit}`;
}
