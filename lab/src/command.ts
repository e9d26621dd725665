/** Nothing lives only in the page: each button tells, in the dock, the command line or message that does the same. */
import { words } from "./api.js";
import { type Child, type Icon, fill, h, icon } from "./dom.js";
import { notify } from "./shell.js";

/** The same without the page: a command line, or a message of the protocol and the world that it goes to. */
export type Command = string | { readonly world?: string; readonly message: object };

const MOST = 50;
const text = h("code", { class: "command", id: "command" });
const origin = h("span", { class: "origin" });
const copying = h("button", { class: "ghost small", disabled: true }, icon("copy", 16), "Copy as command");
const list = h("ol", { class: "history" });
const past = h("details", { class: "past" }, h("summary", {}, "Earlier"), list);
let shown = "";

/** The strip at the foot of the page. */
export function dock(): HTMLElement {
  copying.addEventListener("click", () => void copy(shown, copying));
  past.hidden = true;
  fill(text, "What a button does is shown here, as a command line or a message.");
  return h("footer", { class: "dock", "aria-label": "Commands" }, icon("terminal", 18), origin, text, copying, past);
}

/** Shows what a button would do. */
export function preview(command: Command): void {
  put(command, "same as");
}

/** Shows what was done. */
export function done(command: Command): void {
  put(command, "done");
  list.prepend(h("li", {}, h("code", {}, written(command)), h("button", {
    class: "ghost square small", "aria-label": "Copy this command", onclick: (event: Event) => void copy(written(command), event.currentTarget as HTMLElement),
  }, icon("copy", 16))));
  while (list.children.length > MOST) {
    list.lastElementChild?.remove();
  }
  past.hidden = false;
}

function put(command: Command, label: string): void {
  shown = written(command);
  text.textContent = shown;
  text.title = shown;
  const world = typeof command === "string" ? undefined : command.world;
  origin.textContent = typeof command === "string" ? `${label} · command line` : `${label} · message${world === undefined ? "" : ` to ${world}`}`;
  copying.disabled = false;
}

/** A command as it is copied. */
export function written(command: Command): string {
  return typeof command === "string" ? command : JSON.stringify(command.message);
}

async function copy(what: string, button: HTMLElement): Promise<void> {
  await navigator.clipboard.writeText(what);
  button.classList.add("copied");
  setTimeout(() => button.classList.remove("copied"), 1200);
}

/** A command line with its words quoted where a shell wants it. */
export function line(...parts: readonly (string | number)[]): string {
  return parts.map((part) => quoted(String(part))).join(" ");
}

function quoted(word: string): string {
  return /^[\w@%+=:,./-]+$/.test(word) ? word : `'${word.replaceAll("'", "'\\''")}'`;
}

export interface Action {
  readonly label: string;
  readonly icon?: Icon;
  /** primary, plain (default), ghost or danger. */
  readonly look?: "primary" | "plain" | "ghost" | "danger";
  /** Only the icon is seen; the label is read out, and shown when the pointer rests. */
  readonly bare?: boolean;
  /** What does the same without the page, as it is now. */
  readonly command?: () => Command;
  /** What the button does; it is disabled until that is over. `command` is shown as done unless it throws or returns false. */
  readonly run: () => Promise<unknown> | unknown;
}

/** A button with its command. */
export function action({ label, icon: drawing, look = "plain", bare = false, command, run }: Action): HTMLButtonElement {
  const children: Child[] = [drawing !== undefined && icon(drawing, 18), !bare && label];
  const button = h("button", { class: `${look}${bare ? " square" : ""}`, type: "button" }, ...children);
  if (bare) {
    button.setAttribute("aria-label", label);
    button.title = label;
  }
  if (command !== undefined) {
    const tell = (): void => preview(command());
    button.addEventListener("pointerenter", tell);
    button.addEventListener("focus", tell);
  }
  button.addEventListener("click", () => void press());
  const press = async (): Promise<void> => {
    if (button.getAttribute("aria-disabled") === "true") {
      return;
    }
    const same = command?.();
    button.setAttribute("aria-disabled", "true"); // not disabled, which would lose the focus
    try {
      const did = await run();
      if (did !== false && same !== undefined) {
        done(same);
      }
    } catch (error) {
      notify(words(error), "bad");
    } finally {
      button.removeAttribute("aria-disabled");
    }
  };
  return button;
}
