/** Two recordings side by side, on one time line, with where they part. */
import { kept, part, post, words } from "../api.js";
import { action, line } from "../command.js";
import { type Child, fill, h, icon, select } from "../dom.js";
import { type Job, ended } from "../jobs.js";
import { Player, SPEEDS } from "./player.js";

const LISTED = 12; // cubes that come apart most

type Drift = { readonly time: number; readonly distance: number; readonly angle: number };

/** What `nmes diff --json` prints. */
interface Comparison {
  readonly same: boolean;
  readonly ticks: readonly [number, number];
  readonly inputs: { readonly ticks: number; readonly first: string; readonly second: string; readonly field: string | null; readonly values: readonly [unknown, unknown] } | null;
  readonly states: { readonly tick: number; readonly cube: string | null; readonly field: string | null; readonly first: unknown; readonly second: unknown } | null;
  readonly drifts: Readonly<Record<string, readonly Drift[]>>;
}

export class Pair {
  readonly element: HTMLElement;
  private readonly players: readonly [Player, Player];
  private readonly range = h("input", { type: "range", min: 0, max: 0, value: "0", "aria-label": "Frame of both" });
  private readonly ticks = h("div", { class: "ticks" });
  private readonly clock = h("span", { class: "mono clock" }, "–");
  private readonly play = h("button", { class: "primary" });
  private readonly speed = select(SPEEDS, "1", { "aria-label": "Speed of both" });
  private readonly verdict = h("div", { class: "stack", role: "status" });
  private readonly panes: HTMLElement;
  private comparison: Comparison | undefined;
  private played: boolean | undefined; // whether that is what is drawn
  private known = 0; // recordings of which it is known how long they are

  constructor(private readonly names: readonly [string, string], private readonly signal: AbortSignal) {
    this.players = [new Player(names[0], signal), new Player(names[1], signal)];
    const [one, other] = this.players;
    one.lead(other);
    other.lead(one);
    for (const player of this.players) {
      player.watcher = () => this.tell();
    }
    this.range.addEventListener("input", () => this.seek(Number(this.range.value)));
    this.speed.addEventListener("change", () => (this.leader.pace = Number(this.speed.value)));
    this.play.addEventListener("click", () => this.leader.toggle());
    const together = h("input", { type: "checkbox", checked: true });
    together.addEventListener("change", () => this.link(together.checked));
    this.panes = h("div", { class: "panes of-2 paired" }, one.element, other.element);
    const nudge = (by: number, label: string, look: string): HTMLElement =>
      h("button", { class: `square${look}`, title: label, "aria-label": label, onclick: () => this.seek(this.leader.at + by) }, icon("back", 18));
    this.element = h("div", { class: "stack" },
      h("section", { class: "card stack", "aria-label": "Both" },
        h("div", { class: "timeline shared" }, this.ticks, this.range),
        h("div", { class: "bar controls" }, this.play, nudge(-1, "Both one frame back", ""), nudge(1, "Both one frame on", " flipped"), this.speed, this.clock, h("span", { class: "grow" }),
          h("label", { class: "check" }, together, "Move together"),
          action({ label: "Find where they part", icon: "search", command: () => this.command(), run: () => this.compare() })),
        this.verdict),
      this.panes);
    this.tell();
  }

  /** The one that is played: the one that goes on for longer. */
  private get leader(): Player {
    const [one, other] = this.players;
    return (other.about?.last ?? 0) > (one.about?.last ?? 0) ? other : one;
  }

  private command(): string {
    return line("nmes", "diff", ...this.names.map((name) => kept("recordings", `${name}.mcap`)));
  }

  private link(together: boolean): void {
    this.players.forEach((player) => (player.leads = together));
    this.panes.classList.toggle("paired", together);
    for (const control of [this.range, this.play, this.speed]) {
      control.disabled = !together;
    }
    if (together) {
      this.seek(this.leader.at);
    }
  }

  private seek(to: number): void {
    this.leader.go(to);
  }

  /** Shows where both are. */
  private tell(): void {
    const spans = this.players.flatMap(({ about }) => (about === undefined ? [] : [about]));
    const { at, playing } = this.leader;
    if (playing !== this.played) {
      this.played = playing;
      fill(this.play, icon(playing ? "pause" : "play", 18), playing ? "Pause both" : "Play both");
    }
    if (spans.length !== this.known) {
      this.known = spans.length;
      this.range.min = String(Math.min(...spans.map(({ first }) => first)));
      this.range.max = String(Math.max(...spans.map(({ last }) => last)));
      this.mark();
    }
    const rate = spans[0]?.tick_rate ?? 60;
    this.range.value = String(at);
    this.clock.textContent = `${(at / rate).toFixed(2)} s · ${at.toLocaleString("en")}`;
    this.range.setAttribute("aria-valuetext", `${(at / rate).toFixed(2)} s`);
  }

  /** Draws marks over the time line: of the first in the upper half, of the second in the lower. */
  private mark(): void {
    const [first, last] = [Number(this.range.min), Number(this.range.max)];
    const place = (frame: number): string => `${((frame - first) / Math.max(last - first, 1)) * 100}%`;
    const marks = this.players.flatMap(({ about }, row) => (about?.marks ?? []).slice(0, 250).map(({ kind, frame }) =>
      h("i", { class: `mark ${kind} ${row === 0 ? "upper" : "lower"}`, style: { left: place(frame) } })));
    fill(this.ticks, ...marks, ...this.parted().map((frame) => h("i", { class: "mark parted", title: "They part here", style: { left: place(frame) } })));
  }

  /** The frames at which inputs and states part. */
  private parted(): number[] {
    const { inputs, states } = this.comparison ?? {};
    return [inputs?.ticks, states?.tick].filter((frame) => frame !== undefined);
  }

  private async compare(): Promise<boolean> {
    fill(this.verdict, h("p", { class: "soft" }, "Laying them beside each other …"));
    try {
      const [one, other] = this.names;
      const { result, status, lines } = await ended(await post<Job>(`/recordings/${part(one)}/diff`, { other }), this.signal);
      if (result === null || typeof result !== "object") {
        const more = "there is more to tell than the lab keeps: run the command that stands at the foot of the page";
        throw new Error(status === 0 || status === 1 ? more : lines.at(-1) ?? "they could not be compared");
      }
      this.comparison = result as Comparison;
      fill(this.verdict, ...this.told(this.comparison));
      const [frame] = this.parted();
      if (frame !== undefined) {
        this.jump(frame);
      }
      this.mark();
      return true;
    } catch (error) {
      fill(this.verdict, h("p", { class: "bad" }, words(error)));
      return false;
    }
  }

  /** Shows a moment in both, and marks what differs there. */
  private jump(frame: number): void {
    const cube = this.comparison?.states?.cube ?? undefined;
    this.players.forEach((player) => player.point(cube));
    this.seek(frame);
  }

  private told({ same, ticks, inputs, states, drifts }: Comparison): Child[] {
    if (same) {
      return [h("p", {}, h("span", { class: "badge good" }, "the same"), ` Inputs and states, after each of ${ticks[0].toLocaleString("en")} ticks.`)];
    }
    const [one, other] = ticks;
    const to = (frame: number): Child => h("button", { class: "small", onclick: () => this.jump(frame) }, `Go to frame ${frame.toLocaleString("en")}`);
    return [
      h("p", {}, h("span", { class: "badge bad" }, "they part"), ` The first has ${one.toLocaleString("en")} ticks, the second ${other.toLocaleString("en")}.`),
      inputs === null ? h("p", {}, "Inputs are the same.") : h("div", { class: "stack" },
        h("div", { class: "bar" }, h("strong", {}, "Inputs part"), to(inputs.ticks)),
        inputs.field !== null && h("p", {}, "Field ", h("code", {}, inputs.field), ": ", sides(JSON.stringify(inputs.values[0]), JSON.stringify(inputs.values[1]))),
        h("p", { class: "hint breaks" }, sides(inputs.first, inputs.second))),
      states === null ? h("p", {}, "States are the same after each tick.") : h("div", { class: "stack" },
        h("div", { class: "bar" }, h("strong", {}, "States part"), to(states.tick)),
        states.field !== null && h("p", {}, states.cube !== null && ["Cube ", h("code", { class: "breaks" }, states.cube), ", "], h("code", {}, states.field), ": ", sides(shown(states.first), shown(states.second)))),
      ...apart(drifts),
    ];
  }
}

function sides(first: string, second: string): Child[] {
  return [h("span", { class: "side-a" }, "first "), h("code", { class: "breaks" }, first), " ", h("span", { class: "side-b" }, "second "), h("code", { class: "breaks" }, second)];
}

function shown(value: unknown): string {
  return typeof value === "number" ? String(value) : JSON.stringify(value)?.slice(0, 300) ?? "nothing";
}

/** The cubes that come apart most. */
function apart(drifts: Comparison["drifts"]): Child[] {
  const worst = Object.entries(drifts).map(([name, line]) => ({ name, most: Math.max(...line.map(({ distance }) => distance)), last: line.at(-1)?.distance ?? 0 }));
  const rows = worst.filter(({ most }) => most > 0).sort((one, other) => other.most - one.most);
  if (rows.length === 0) {
    return [];
  }
  return [h("details", {}, h("summary", {}, `How far ${rows.length === 1 ? "a cube comes" : `${rows.length.toLocaleString("en")} cubes come`} apart`),
    h("div", { class: "table" }, h("table", {}, h("thead", {}, h("tr", {}, h("th", {}, "Cube"), h("th", { class: "number" }, "At most"), h("th", { class: "number" }, "At last"))),
      h("tbody", {}, ...rows.slice(0, LISTED).map(({ name, most, last }) => h("tr", {},
        h("td", { class: "name" }, name), h("td", { class: "number" }, `${most.toPrecision(3)} m`), h("td", { class: "number" }, `${last.toPrecision(3)} m`))))))) ];
}
