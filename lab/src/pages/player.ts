/** One recording, played: a time line that scrubs, marks of what happened, and what can be done with it. */
import { get, kept, part, post, socketUrl, words } from "../api.js";
import { action, done, line } from "../command.js";
import { Link } from "../connection.js";
import { type Child, fill, h, icon, select } from "../dom.js";
import { type Job, ended } from "../jobs.js";
import { type Contact, type Effort, type Food, type Frame, type Push, type Scene, frame } from "../poses.js";
import { Stage } from "../scene.js";
import { failure, go } from "../shell.js";

interface Mark {
  readonly kind: string;
  readonly what: string;
  readonly frame: number;
  readonly count: number;
  /** The last frame of those that `count` counts. */
  readonly until?: number;
  readonly client?: number;
}

export interface About {
  readonly world: string;
  readonly backend: string;
  readonly seed: number;
  readonly tick_rate: number;
  readonly first: number;
  readonly last: number;
  readonly keyframes: readonly number[];
  readonly marks: readonly Mark[];
  readonly marks_whole: boolean;
  readonly complete: boolean;
  readonly parent?: unknown;
}

/** What `nmes replay` says. */
interface Verdict {
  readonly verdict: string;
  readonly ticks: number;
  readonly commands: number;
  readonly speed: number;
  readonly damage?: string | null;
  readonly divergence?: { readonly frame?: number; readonly message?: string } | null;
}

export const SPEEDS = ["0.1", "0.25", "0.5", "1", "2", "4", "8"].map((speed) => [speed, `${speed} ×`] as const);
/** Forces that can be shown: kind, title, what they are. */
const FORCES = [
  ["contacts", "Contacts", "Where cubes touch, and the force along the normal"],
  ["motors", "Motors", "What motors do: torque or force along the axis of the joint"],
  ["pushes", "Pushes", "What clients push, while they do: force, and torque along its axis"],
] as const;
const LISTED = 200; // marks in the list

export class Player {
  readonly element: HTMLElement;
  /** Whether the other one goes along. */
  leads = true;
  private readonly stage: Stage;
  private readonly link: Link;
  private readonly range = h("input", { type: "range", min: 0, max: 0, value: "0", "aria-label": "Frame" });
  private readonly ticks = h("div", { class: "ticks" });
  private readonly clock = h("span", { class: "mono clock" }, "–");
  private readonly play: HTMLButtonElement;
  private readonly speed = select(SPEEDS, "1", { "aria-label": "Speed" });
  private readonly side = h("div", { class: "stack side" });
  private readonly busy = h("span", { class: "badge", hidden: true }, "reading");
  private readonly following = h("input", { type: "checkbox", checked: true });
  /** What is known of the recording; undefined until it is. */
  about: About | undefined;
  /** Called whenever it stands elsewhere, plays or pauses, or more is known of it. */
  watcher: () => void = () => {};
  private marked: string | undefined; // a cube
  private scene: Scene | undefined;
  private other: Player | undefined;
  private wanted = 0; // the frame that is to be shown
  private asked: number | undefined; // the one that was asked for and has not come
  private readonly forces: Readonly<Record<string, HTMLInputElement>>; // kinds, and whether they are shown
  private fewer = false; // whether other forces are wanted than were asked for
  private clocked: { since: number; from: number } | undefined;

  constructor(private readonly name: string, private readonly signal: AbortSignal) {
    this.stage = new Stage(`The recording ${name}`, signal);
    this.play = h("button", { class: "primary", onclick: () => this.toggle() });
    this.range.addEventListener("input", () => { this.go(Number(this.range.value)); });
    this.speed.addEventListener("change", () => { if (this.playing) { this.start(); } });
    this.following.addEventListener("change", () => this.follow());
    this.forces = Object.fromEntries(FORCES.map(([kind]) => [kind, h("input", { type: "checkbox", onchange: () => this.exert(kind) })]));
    this.button();
    this.link = new Link(socketUrl("/ws/recording", { name }), {
      open: () => { this.asked = undefined; this.ask(); },
      message: (message) => this.read(message),
      data: (bytes) => this.show(frame(bytes)),
    }, signal);
    this.stage.element.append(h("div", { class: "hud" }, h("span", {}, this.busy), this.clock),
      h("button", { class: "square corner", title: "Show all", "aria-label": "Show all", onclick: () => this.stage.overview() }, icon("follow", 18)));
    this.element = h("section", { class: "pane", "aria-label": name },
      h("h2", { class: "breaks" }, name),
      this.link.banner,
      h("div", { class: "watching" }, h("div", { class: "stack" }, this.stage.element,
        h("div", { class: "timeline" }, this.ticks, this.range),
        h("div", { class: "bar controls" }, this.play,
          h("button", { class: "square", title: "One frame back", "aria-label": "One frame back", onclick: () => this.nudge(-1) }, icon("back", 18)),
          h("button", { class: "square flipped", title: "One frame on", "aria-label": "One frame on", onclick: () => this.nudge(1) }, icon("back", 18)),
          this.speed, h("label", { class: "check" }, this.following, "Follow")),
        h("div", { class: "bar options" }, ...FORCES.map(([kind, title, text]) => h("label", { class: "check", title: text }, this.forces[kind], title)))),
      this.side));
    void this.learn();
    const step = (): void => {
      if (!signal.aborted) {
        this.advance();
        requestAnimationFrame(step);
      }
    };
    requestAnimationFrame(step);
  }

  /** Has another one go along. */
  lead(other: Player | undefined): void {
    this.other = other;
  }

  /** The frame that is to be shown. */
  get at(): number {
    return this.wanted;
  }

  /** Whether it plays. */
  get playing(): boolean {
    return this.clocked !== undefined;
  }

  /** How many times faster than it was it plays. */
  set pace(times: number) {
    this.speed.value = String(times);
    if (this.playing) {
      this.start();
    }
  }

  /** Pauses at a frame; the other one goes along. */
  go(to: number): void {
    this.stop();
    this.seek(to);
  }

  /** Marks a cube, by its name, in whatever is shown. */
  point(cube: string | undefined): void {
    this.marked = cube;
    this.stage.choose(this.scene?.cubes.findIndex(({ name }) => name === cube) ?? -1);
  }

  private async learn(): Promise<void> {
    try {
      const about = await get<About>(`/recordings/${part(this.name)}`, {}, this.signal);
      this.about = { ...about, marks: gathered(about.marks) };
    } catch (error) {
      if (!this.signal.aborted) {
        fill(this.side, failure(error, () => void this.learn()));
      }
      return;
    }
    const { first, last } = this.about;
    this.range.min = String(first);
    this.range.max = String(last);
    this.mark();
    fill(this.side, this.doing(), this.told());
    this.seek(Math.max(this.wanted, first));
  }

  /** Draws marks over the time line. */
  private mark(): void {
    const { first = 0, last = 1, marks = [], keyframes = [] } = this.about ?? {};
    const at = (when: number): string => `${((when - first) / Math.max(last - first, 1)) * 100}%`;
    fill(this.ticks, ...keyframes.slice(0, 500).map((when) => h("i", { class: "keyframe", style: { left: at(when) } })),
      ...marks.slice(0, 500).map(({ kind, frame: when, until = when }) =>
        h("i", { class: `mark ${kind}${until > when ? " long" : ""}`, style: { left: at(when), ...(until > when ? { width: `calc(${at(first + until - when)} + 2px)` } : {}) } })));
  }

  private doing(): HTMLElement {
    const verdict = h("div", { role: "status" });
    const file = (): string => kept("recordings", `${this.name}.mcap`);
    const replay = action({
      label: "Replay and compare", icon: "check", command: () => line("nmes", "replay", file()),
      run: async () => {
        fill(verdict, h("p", { class: "soft" }, "Running it again …"));
        try {
          fill(verdict, judged(await ended(await post<Job>(`/recordings/${part(this.name)}/replay`), this.signal)));
          return true;
        } catch (error) {
          fill(verdict, h("p", { class: "bad" }, words(error)));
          return false;
        }
      },
    });
    const world = h("input", { type: "text", value: `${(this.about?.world ?? "world").slice(0, 100)}-on`, maxlength: 128, "aria-label": "Name of the new world", spellcheck: "false" });
    const on = action({
      label: "Go on from here", icon: "fork", look: "primary",
      command: () => line("nmes", "serve", "--resume", file(), "--at", this.wanted),
      run: async () => {
        await post(`/recordings/${part(this.name)}/fork`, { frame: this.wanted, world: world.value.trim() });
        go("worlds", world.value.trim());
      },
    });
    return h("div", { class: "card stack" }, h("h2", {}, "With this recording"),
      h("div", { class: "row" }, replay, h("a", { class: "button", href: `/api/recordings/${part(this.name)}/file`, download: "" }, icon("download", 18), "Download")),
      verdict, h("label", { class: "hint" }, "A live world that begins at this frame:"), world, on);
  }

  private told(): HTMLElement {
    const { marks = [], marks_whole: whole = true, backend = "", seed = 0, world = "", tick_rate: rate = 60, complete = true } = this.about ?? {};
    const rows = marks.slice(0, LISTED).map(({ kind, what, frame: when, count }) =>
      h("li", {}, h("button", { class: "ghost small", onclick: () => this.go(when) },
        h("i", { class: `dot ${kind}`, "aria-hidden": "true" }), h("span", { class: "mono" }, `${(when / rate).toFixed(2)} s`),
        h("span", { class: "what" }, kind === "command" ? what : `${kind === "fault" ? "fault: " : ""}${what}${kind === "fault" || kind === "command" ? "" : ` ${kind}`}`, count > 1 ? ` × ${count}` : ""))));
    return h("div", { class: "card" }, h("h2", {}, "What happened"),
      h("p", { class: "hint" }, `${world}, ${backend}, seed ${seed}`, complete ? "" : "; it is still written, or was cut off"),
      rows.length === 0 ? h("p", { class: "soft" }, "No command, fault or birth is in it.") : h("ol", { class: "marks" }, ...rows),
      (!whole || marks.length > LISTED) && h("p", { class: "hint" }, "There is more: ", h("code", {}, line("nmes", "info", kept("recordings", `${this.name}.mcap`))), " tells all."));
  }

  /** Plays, or pauses. */
  toggle(): void {
    if (this.clocked === undefined) {
      if (this.about !== undefined && this.wanted >= this.about.last) {
        this.seek(this.about.first);
      }
      this.start();
    } else {
      this.stop();
    }
  }

  private start(): void {
    this.clocked = { since: performance.now(), from: this.wanted };
    this.button();
  }

  private stop(): void {
    this.clocked = undefined;
    this.button();
  }

  private button(): void {
    const on = this.clocked !== undefined;
    fill(this.play, icon(on ? "pause" : "play", 18), on ? "Pause" : "Play");
    this.watcher();
  }

  private nudge(by: number): void {
    this.go(this.wanted + by);
  }

  /** Moves on while it plays. */
  private advance(): void {
    if (this.clocked === undefined || this.about === undefined) {
      return;
    }
    const { since, from } = this.clocked;
    const to = from + Math.floor(((performance.now() - since) / 1000) * this.about.tick_rate * Number(this.speed.value));
    if (to >= this.about.last) {
      this.stop();
    }
    if (to !== this.wanted) {
      this.seek(to);
    }
  }

  /** Shows a frame, as soon as it has come; of several that were wanted meanwhile the last. */
  private seek(to: number, along = false): void {
    this.wanted = Math.min(Math.max(to, this.about?.first ?? 0), this.about?.last ?? to);
    this.range.value = String(this.wanted);
    this.tell();
    this.watcher();
    this.ask();
    if (!along && this.leads) {
      this.other?.seek(to, true);
    }
  }

  private tell(): void {
    const rate = this.about?.tick_rate ?? 60;
    this.clock.textContent = `${(this.wanted / rate).toFixed(2)} s · ${this.wanted.toLocaleString("en")}`;
    this.range.setAttribute("aria-valuetext", `${(this.wanted / rate).toFixed(2)} s`);
  }

  /** The kinds of forces that are to be shown. */
  private shown(): string[] {
    return FORCES.flatMap(([kind]) => (this.forces[kind]?.checked === true ? [kind] : []));
  }

  /** Shows forces of a kind, or no longer. */
  private exert(kind: string): void {
    if (this.forces[kind]?.checked === true) {
      done(line("nmes", "view", kept("recordings", `${this.name}.mcap`)));
    } else {
      this.draw({ type: kind });
    }
    this.fewer = true;
    this.ask();
  }

  private draw(told: { type?: unknown; contacts?: readonly Contact[]; motors?: readonly Effort[]; pushes?: readonly Push[] }): void {
    if (told.type === "contacts") {
      this.stage.touch(told.contacts ?? []);
    } else if (told.type === "motors") {
      this.stage.strain(told.motors ?? []);
    } else {
      this.stage.push(told.pushes ?? []);
    }
  }

  private ask(): void {
    const show = this.shown();
    if (this.asked === undefined && this.about !== undefined && this.link.send({ frame: this.wanted, ...(show.length > 0 ? { show } : {}) })) {
      this.asked = this.wanted;
      this.fewer = false;
    }
  }

  private read(message: Record<string, unknown>): void {
    if (message["type"] === "scene") {
      this.scene = message as unknown as Scene;
      this.stage.describe(this.scene);
      this.point(this.marked);
      this.follow();
    } else if (message["type"] === "food") {
      this.stage.feed((message as { food?: Food }).food ?? []);
    } else if (this.shown().includes(String(message["type"]))) {
      this.draw(message);
    } else if (message["type"] === "error") {
      const again = message["code"] === "not_yet";
      this.busy.hidden = false;
      this.busy.className = again ? "badge warn" : "badge bad";
      this.busy.textContent = again ? "catching up" : String(message["message"]);
      const { asked } = this;
      this.asked = undefined;
      if (!again) {
        this.stop();
      }
      if (again || asked !== this.wanted) {
        this.ask();
      }
    }
  }

  private show(shown: Frame): void {
    this.busy.hidden = true;
    this.stage.show(shown);
    this.element.dataset["frame"] = String(shown.frame);
    const { asked } = this;
    this.asked = undefined;
    if (asked !== this.wanted || this.fewer) {
      this.ask();
    }
  }

  private follow(): void {
    const cubes = this.scene?.cubes ?? [];
    const [first] = cubes.flatMap(({ creature }) => (typeof creature === "string" ? [creature] : []));
    this.stage.follow(!this.following.checked ? [] : cubes.flatMap(({ creature }, cube) => (first === undefined || creature === first ? [cube] : [])));
  }
}

/** Marks with those in one that are the same again and again, as when somebody drives a creature. */
function gathered(marks: readonly Mark[]): Mark[] {
  const kept: Mark[] = [];
  for (const mark of marks) {
    const last = kept.at(-1);
    if (last !== undefined && last.kind === mark.kind && last.what === mark.what && last.client === mark.client && mark.kind === "command") {
      kept[kept.length - 1] = { ...last, count: last.count + mark.count, until: mark.frame };
    } else {
      kept.push(mark);
    }
  }
  return kept;
}

function judged({ status, result, lines }: Job): Child {
  const verdict = result as Verdict | null;
  if (verdict === null || typeof verdict !== "object" || typeof verdict.verdict !== "string") {
    return h("p", { class: "bad" }, lines.at(-1) ?? `it ended with ${status ?? "no status"}`);
  }
  return [
    h("p", {}, h("span", { class: `badge ${status === 0 ? "good" : "bad"}` }, verdict.verdict.replaceAll("_", " "))),
    h("p", { class: "hint" }, `${verdict.ticks.toLocaleString("en")} ticks, ${verdict.commands.toLocaleString("en")} commands, at ${Math.round(verdict.speed)} times real time`),
    typeof verdict.damage === "string" && h("p", { class: "hint" }, verdict.damage),
  ];
}

