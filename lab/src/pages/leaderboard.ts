/** Leaderboards: scores, each with recordings that prove it, and the proof done again. */
import { get, kept, part, post, words } from "../api.js";
import { action, line } from "../command.js";
import { type Child, append, fill, h, icon, select } from "../dom.js";
import { type Job, ended } from "../jobs.js";
import { type View, empty, go, heading, load } from "../shell.js";

interface Entry {
  readonly id: number;
  readonly task: string;
  readonly task_hash: string;
  readonly name: string;
  readonly author: string;
  /** Of the signer; empty where nobody signed. */
  readonly key: string;
  readonly score: number;
  readonly spread: number;
  readonly recordings: readonly string[];
  readonly recorded: string;
  readonly broken: string | null;
  readonly unit: string;
}

interface Board {
  readonly name: string;
  readonly items: readonly Entry[];
}

interface Verdict {
  readonly id: number;
  readonly verdict: "holds" | "broken" | "not_judged";
  readonly reason: string | null;
}

export function open({ root, params, signal }: View): Promise<void> {
  const body = h("div", { class: "stack" });
  append(root, [heading("Leaderboard", "A score stands here with the recordings that prove it. Anybody can have them run again."), body]);
  return load(body, "leaderboards", async () => (await get<{ items: { name: string }[] }>("/leaderboards", {}, signal)).items, (boards) => {
    const [first] = boards;
    if (first === undefined) {
      return empty("No leaderboards yet", "A leaderboard is a file in the lab's folder. Score a creature with its recordings, then list them:",
        h("code", {}, line("nmes", "leaderboard", "add", kept("leaderboards", "board.sqlite"), "proofs/*.mcap").replace("'proofs/*.mcap'", "proofs/*.mcap")));
    }
    const name = params[0] ?? first.name;
    const choice = select(boards.map((each) => each.name), name, { "aria-label": "Leaderboard" });
    choice.addEventListener("change", () => go("leaderboard", choice.value));
    const table = h("div");
    void load(table, "entries", () => get<Board>(`/leaderboards/${part(name)}`, {}, signal), (board) => entries(board, choice, signal), signal);
    return table;
  }, signal);
}

function entries({ name, items }: Board, choice: HTMLElement, signal: AbortSignal): Child {
  const file = kept("leaderboards", `${name}.sqlite`);
  const tasks = [...new Set(items.map(({ task }) => task))].sort();
  const task = select([["", "All tasks"], ...tasks.map((each) => [each, each] as const)], "", { "aria-label": "Task" });
  const search = h("input", { type: "search", placeholder: "Creature or author", "aria-label": "Creature or author" });
  const verdicts = new Map<number, Verdict>();
  const body = h("div", { class: "stack" });
  const told = h("p", { class: "hint", role: "status" });
  const draw = (): void => {
    const wanted = items.filter((entry) => (task.value === "" || entry.task === task.value)
      && `${entry.name} ${entry.author}`.toLowerCase().includes(search.value.toLowerCase()));
    fill(body, ...(items.length === 0 ? [empty("Nothing is listed yet", "Whoever proves a score is listed:", h("code", {}, `nmes leaderboard add ${line(file)} proofs/*.mcap`))]
      : wanted.length === 0 ? [empty("No entry is like that", "Choose another task, or search for something else.")]
        : tasks.map((each) => ranked(each, wanted.filter((entry) => entry.task === each), verdicts, (entry) => [verify(entry), film(entry)]))));
  };
  const verify = (entry?: Entry): HTMLButtonElement => action({
    label: entry === undefined ? "Verify all" : `Verify ${entry.name}`, icon: "check", look: entry === undefined ? "primary" : "plain", bare: entry !== undefined,
    command: () => line("nmes", "leaderboard", "verify", file, ...(entry === undefined ? [] : [String(entry.id)])),
    run: async () => {
      told.textContent = entry === undefined ? "Every recording is run again …" : `The recordings of ${entry.name} are run again …`;
      try {
        const job = await ended(await post<Job>(`/leaderboards/${part(name)}/verify`, entry === undefined ? {} : { entry: entry.id }), signal);
        if (!Array.isArray(job.result)) {
          throw new Error(job.lines.at(-1) ?? "it could not be verified");
        }
        const found = job.result as Verdict[];
        found.forEach((verdict) => verdicts.set(verdict.id, verdict));
        const held = found.filter(({ verdict }) => verdict === "holds").length;
        told.textContent = entry === undefined ? `${held} of ${found.length} hold.` : `${entry.name} ${held === 1 ? "holds" : `does not hold: ${found[0]?.reason ?? ""}`}.`;
        draw();
        return true;
      } catch (error) {
        told.textContent = signal.aborted ? "" : words(error);
        return false;
      }
    },
  });
  const shown = h("div", {});
  const film = (entry: Entry): HTMLButtonElement => action({
    label: `Film ${entry.name}`, icon: "play", bare: true,
    command: () => line("nmes", "render", ...entry.recordings.slice(0, 1).map((hash) => kept("leaderboards", `${name}.recordings`, `${hash}.mcap`)), "-o", kept("films", `${name.slice(0, 150)}-${entry.id}.gif`),
      "--to", "8s", "--size", "480x360", "--fps", "15"),
    run: async () => {
      fill(shown, h("p", { class: "hint", role: "status" }, `${entry.name} is filmed …`));
      try {
        const begun = await post<Job & { film: string }>(`/leaderboards/${part(name)}/film`, { entry: entry.id });
        const job = await ended(begun, signal);
        if (job.status !== 0) {
          throw new Error(job.lines.at(-1) ?? "it could not be filmed");
        }
        const file = `/api/films/${part(begun.film)}/file?job=${job.id}`;
        fill(shown, h("figure", { class: "card stack film" }, h("img", { src: file, width: 480, height: 360, alt: `A film of ${entry.name} on ${entry.task}` }),
          h("figcaption", {}, `${entry.name} on ${entry.task}, from the recording that proves its score`),
          h("a", { class: "button", href: file, download: `${begun.film}.gif` }, icon("download", 18), "Download")));
        shown.scrollIntoView({ block: "nearest" });
        return true;
      } catch (error) {
        fill(shown, h("p", { class: "bad" }, signal.aborted ? "" : words(error)));
        return false;
      }
    },
  });
  task.addEventListener("change", draw);
  search.addEventListener("input", draw);
  draw();
  return h("div", { class: "stack" }, h("div", { class: "bar" }, choice, task, h("div", { class: "searching" }, icon("search", 18), search), h("span", { class: "grow" }), verify()), told, shown, body);
}

function ranked(task: string, entries: readonly Entry[], verdicts: ReadonlyMap<number, Verdict>, doing: (entry: Entry) => Child): Child {
  return entries.length > 0 && h("section", { class: "stack" }, h("h2", {}, task), h("div", { class: "table" }, h("table", {},
    h("thead", {}, h("tr", {}, h("th", { class: "number" }, "Rank"), h("th", {}, "Creature"), h("th", { class: "wide" }, "Author"), h("th", { class: "number" }, "Score"),
      h("th", { class: "number wide" }, "Recordings"), h("th", {}, "Proof"))),
    h("tbody", {}, ...entries.map((entry, rank) => h("tr", {},
      h("td", { class: "number" }, rank + 1),
      h("td", { class: "name" }, entry.name),
      h("td", { class: "wide" }, entry.author, " ", entry.key !== "" && h("span", { class: "badge", title: `key ${entry.key}` }, "signed")),
      h("td", { class: "number" }, `${entry.score.toLocaleString("en", { maximumFractionDigits: 3 })}${entry.unit === "" ? "" : ` ${entry.unit}`}`,
        entry.spread > 0 && h("span", { class: "soft wide" }, ` ± ${entry.spread.toLocaleString("en", { maximumFractionDigits: 3 })}`)),
      h("td", { class: "number wide" }, entry.recordings.length),
      h("td", {}, h("span", { class: "bar" }, proof(entry, verdicts.get(entry.id)), doing(entry)))))))));
}

function proof({ broken }: Entry, verdict: Verdict | undefined): Child {
  if (verdict !== undefined) {
    return h("span", { class: `badge ${verdict.verdict === "holds" ? "good" : verdict.verdict === "broken" ? "bad" : "warn"}`, title: verdict.reason ?? "" }, verdict.verdict.replaceAll("_", " "));
  }
  return broken === null ? h("span", { class: "badge" }, "recorded") : h("span", { class: "badge bad", title: broken }, "broken");
}
