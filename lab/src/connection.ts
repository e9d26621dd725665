/** WebSockets that come back: what is lost is dialled again, later and later, and the page says so. */
import { type Child, fill, h, icon } from "./dom.js";
import { announce } from "./shell.js";

const FIRST = 0.5; // s
const LONGEST = 10; // s
const FINAL = 4000; // codes of the application from which on it makes no sense to try again

export interface Handlers {
  /** Takes a text frame, parsed. */
  message?(message: Record<string, unknown>): void;
  /** Takes a binary frame. */
  data?(bytes: ArrayBuffer): void;
  /** Told when the connection stands, and each time it does again. */
  open?(): void;
}

/** A socket that is dialled again until the signal. */
export class Link {
  /** What says that the connection is broken; empty while it stands. */
  readonly banner = h("div", { class: "banner", role: "status", hidden: true });
  #socket: WebSocket | undefined;
  #wait = FIRST;
  #timer = 0;

  constructor(
    private readonly url: string,
    private readonly handlers: Handlers,
    private readonly signal: AbortSignal,
  ) {
    signal.addEventListener("abort", () => {
      clearInterval(this.#timer);
      this.#socket?.close();
    });
    this.#dial();
  }

  /** Sends a text frame; false where there is no connection. */
  send(message: object): boolean {
    if (this.#socket?.readyState !== WebSocket.OPEN) {
      return false;
    }
    this.#socket.send(JSON.stringify(message));
    return true;
  }

  #dial(): void {
    clearInterval(this.#timer);
    if (this.signal.aborted) {
      return;
    }
    const socket = new WebSocket(this.url);
    this.#socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      if (!this.banner.hidden) {
        announce("Connected again.");
      }
      this.#wait = FIRST;
      this.banner.hidden = true;
      this.handlers.open?.();
    };
    socket.onmessage = (event: MessageEvent<string | ArrayBuffer>) => {
      if (typeof event.data === "string") {
        this.handlers.message?.(JSON.parse(event.data) as Record<string, unknown>);
      } else {
        this.handlers.data?.(event.data);
      }
    };
    socket.onclose = (event) => this.#lost(event);
  }

  #lost({ code, reason }: CloseEvent): void {
    if (this.signal.aborted) {
      return;
    }
    if (code >= FINAL) {
      this.#say(`The lab ended this connection: ${reason === "" ? code : reason.replaceAll("_", " ")}.`);
      return;
    }
    const due = performance.now() + this.#wait * 1000;
    this.#wait = Math.min(this.#wait * 2, LONGEST);
    announce("The connection is lost; trying again.");
    const count = (): void => {
      const left = Math.ceil((due - performance.now()) / 1000);
      if (left > 0) {
        this.#say(`The connection is lost. Trying again in ${left} s.`, this.#now());
      } else {
        this.#again();
      }
    };
    this.#timer = setInterval(count, 250);
    count();
  }

  /** Dials, once: until that socket is lost too there is no button. */
  #again(): void {
    this.#say("The connection is lost. Trying again …");
    this.#dial();
  }

  #now(): HTMLElement {
    return h("button", { class: "small", onclick: () => this.#again() }, "Now");
  }

  #say(text: string, ...more: Child[]): void {
    this.banner.hidden = false;
    const shown = this.banner.querySelector("span");
    if (shown !== null && more.length > 0 && this.banner.querySelector("button") !== null) {
      shown.textContent = text; // the button stays, so that it can be pressed
    } else {
      fill(this.banner, icon("warning", 18), h("span", {}, text), ...more);
    }
  }
}
