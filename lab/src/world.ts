/** A world of the lab's host: which there are, and being in one, by messages of the protocol. */
import { Client, type Command, Disconnected, type Replies, type WorldList, webSocket } from "nmes-client";
import { ApiError, socketUrl } from "./api.js";

/** What the host says of a world. */
export type WorldEntry = WorldList["worlds"][number];

/** Asks the host, which then hangs up: for its list, to create a world, or to close one. */
export function askHost(message: { list?: true; start?: number; create?: { world: string; template?: string; seed?: number }; close?: string }): Promise<WorldList> {
  return new Promise((resolve, reject) => {
    const socket = new WebSocket(socketUrl("/ws"));
    socket.onopen = () => socket.send(JSON.stringify({ type: "auth", password: "", ...message }));
    socket.onmessage = ({ data }: MessageEvent<string>) => {
      const reply = JSON.parse(data) as { type: string; code?: string; message?: string; field?: string };
      if (reply.type === "world_list") {
        resolve(reply as unknown as WorldList);
      } else {
        reject(new ApiError(reply.code ?? "refused", reply.message ?? "the host refused it", 400, reply.field));
      }
      socket.close();
    };
    socket.onclose = () => reject(new ApiError("unreachable", "the lab does not answer: is `nmes lab` still running?", 0));
  });
}

/** All worlds of the host, up to a number of them. */
export async function allWorlds(most = 10_000): Promise<WorldEntry[]> {
  const worlds: WorldEntry[] = [];
  for (let start = 0; worlds.length < most; ) {
    const page = await askHost(start === 0 ? { list: true } : { list: true, start });
    worlds.push(...page.worlds);
    if (page.next === undefined || page.next === null) {
      break;
    }
    start = page.next;
  }
  return worlds;
}

/**
 * Somebody in a world. It is entered when something is first asked, and again after the connection was lost; what is
 * asked in between fails.
 */
export class Visit {
  #client: Promise<Client> | undefined;

  constructor(
    readonly world: string,
    private readonly signal: AbortSignal,
    private readonly told: (event: { readonly type: string; readonly [more: string]: unknown }) => void = () => {},
  ) {
    signal.addEventListener("abort", () => this.leave());
  }

  /** Sends a command. */
  async request<C extends Command>(command: C): Promise<Replies[C["type"]]> {
    return (await this.#enter()).request(command);
  }

  /** Hangs up; the next request enters again. */
  leave(): void {
    const client = this.#client;
    this.#client = undefined;
    void client?.then((each) => each.close(), () => undefined); // of one that was never entered, who asked has been told
  }

  #enter(): Promise<Client> {
    if (this.signal.aborted) {
      return Promise.reject(new Disconnected("closed", "the page was left"));
    }
    if (this.#client === undefined) {
      const entering = Client.open(webSocket(socketUrl("/ws")), { password: "", world: this.world });
      this.#client = entering;
      entering.then((client) => void this.#listen(client, entering), () => this.#forget(entering));
    }
    return this.#client;
  }

  async #listen(client: Client, entering: Promise<Client>): Promise<void> {
    try {
      for await (const event of client.events()) {
        this.told(event as unknown as { type: string });
      }
    } catch (error) {
      if (!(error instanceof Disconnected)) {
        throw error;
      }
    }
    this.#forget(entering);
  }

  #forget(entering: Promise<Client>): void {
    if (this.#client === entering) {
      this.#client = undefined;
    }
  }
}
