import { CommandError, Disconnected } from "./errors.js";
import { type AuthSuccess, type Command, Commands, EVENT_TYPES, type KnownEvent, type Replies } from "./messages.js";
import type { Dial, Transport } from "./transport.js";

/** How many events wait to be read; of more the oldest are dropped. */
export const EVENT_BACKLOG = 10_000;

/** An event that this client's schemas have not: perhaps the server is newer. */
export interface UnknownEvent {
  readonly type: "unknown";
  /** It, as it came. */
  readonly message: { readonly type: string; readonly [field: string]: unknown };
}

/** What the server tells unasked; `type` tells them apart. */
export type Event = KnownEvent | UnknownEvent;

/** How a world is entered. */
export interface Options {
  /** Of the server. */
  readonly password: string;
  /** The name of one of the server's worlds; its first if left out. */
  readonly world?: string | undefined;
  /** In a world with roles, one that the password opens; the first of those if left out. */
  readonly role?: string | undefined;
  /** That of an earlier connection, to be its player again. */
  readonly token?: string | undefined;
}

/** What became of one command of a batch: its reply, or why it was refused. */
export type Outcome = Replies[keyof Replies] | CommandError;

type Message = { type: string; id?: unknown; [field: string]: unknown };

interface Waiting {
  readonly id: number | undefined; // undefined of the authentication, which has none
  readonly resolve: (reply: never) => void;
  readonly reject: (reason: Error) => void;
}

/**
 * A connection to a world. Commands are methods that return promises, and are pipelined: each is sent at once, and
 * replies come in the order of the commands. What the server refuses is a CommandError, a lost connection a Disconnected.
 */
export class Client extends Commands {
  #welcome!: AuthSuccess;
  #connection!: Connection;
  #newest!: Connection; // the one that was dialled last: that same one, but while somebody enters
  #token: string | undefined;
  #entering: Promise<void> | undefined; // while somebody reconnects
  #closes = 0; // how many times it was closed: who has dialled, and finds that it was meanwhile, does not enter

  private constructor(
    private readonly dial: Dial,
    private readonly options: Options,
  ) {
    super();
    this.#token = options.token;
  }

  /** Connects and enters a world. */
  static async open(dial: Dial, options: Options): Promise<Client> {
    const client = new Client(dial, options);
    await client.#enter();
    return client;
  }

  async #enter(): Promise<void> {
    const closes = this.#closes;
    const connection = new Connection(await this.dial());
    if (this.#closes !== closes) {
      connection.lose(closed());
      throw closed();
    }
    this.#newest = connection;
    const { password, world, role } = this.options;
    try {
      this.#welcome = await connection.authenticate({ type: "auth", password, world, role, token: this.#token });
    } catch (error) {
      connection.lose(new Disconnected("closed", "the server did not let the client in"));
      throw error;
    }
    this.#token = this.#welcome.token ?? this.#token;
    this.#connection = connection;
  }

  /** What the server said when this client entered: world, engine, ticks a second, this client's number. */
  get welcome(): AuthSuccess {
    return this.#welcome;
  }

  /** How many events were lost since the connection began because nobody read them. */
  get dropped(): number {
    return this.#connection.dropped;
  }

  override request<C extends Command>(command: C): Promise<Replies[C["type"]]> {
    return this.#connection.command(command);
  }

  /**
   * Has commands act with nothing in between. One that fails does not undo the earlier, but a batch that holds an
   * invalid command is refused as a whole.
   */
  async batch(commands: readonly Command[]): Promise<Outcome[]> {
    const reply = await this.#connection.command<{ results: Message[] }>({ type: "batch", commands });
    return reply.results.map((each) => (each.type === "error" ? refusal(each) : (each as unknown as Outcome)));
  }

  /**
   * The events in the order in which they came, waiting for more. Ends after world_closed and when the client is
   * closed; throws Disconnected when the connection is lost.
   */
  async *events(): AsyncGenerator<Event, void, void> {
    const connection = this.#connection;
    for (;;) {
      const event = connection.events.shift();
      if (event !== undefined) {
        yield event;
      } else if (connection.lost === undefined) {
        await connection.arrival();
      } else if (connection.lost.code === "world_closed" || connection.lost.code === "closed") {
        return;
      } else {
        throw connection.lost;
      }
    }
  }

  /**
   * Closes the connection and enters again: in a world with roles as the same player, while the server runs.
   * Subscriptions, objectives and events that were not read are gone. Of those who call it at once, one enters, and the
   * others share his connection. It fails when close is called meanwhile.
   */
  reconnect(): Promise<void> {
    if (this.#entering === undefined) {
      this.close();
      const entering = this.#enter().finally(() => {
        if (this.#entering === entering) {
          this.#entering = undefined;
        }
      });
      this.#entering = entering;
    }
    return this.#entering;
  }

  /**
   * Ends the connection; commands that wait for replies fail, as does a reconnect that is under way. It may be called
   * more than once.
   */
  close(): void {
    this.#closes++;
    this.#entering = undefined; // who reconnects from here on enters himself
    this.#newest.lose(closed());
  }
}

function closed(): Disconnected {
  return new Disconnected("closed", "the client was closed");
}

/** One connection in the json dialect: it numbers commands and matches replies, which come in their order. */
class Connection {
  readonly events = new Queue<Event>();
  dropped = 0;
  lost: Disconnected | undefined;
  #waiting = new Queue<Waiting>();
  #count = 0;
  #closed = false; // the server said that it closes the world
  #wake: (() => void)[] = [];

  constructor(private readonly transport: Transport) {
    transport.start({
      frame: (text) => this.#take(text),
      end: (code, reason) =>
        this.lose(this.#closed ? new Disconnected("world_closed", "the server closed the world") : new Disconnected(code, reason)),
    });
  }

  /** Says who this is; there is no number, as it is no command. */
  authenticate(message: object): Promise<AuthSuccess> {
    return this.#send(() => encode(message), undefined);
  }

  /** Sends a command, with a number; what cannot be encoded is not counted, so that it puts nothing out of step. */
  command<R>(message: object): Promise<R> {
    const id = this.#count;
    return this.#send(() => {
      const text = encode(message);
      this.#count++;
      return `${text.slice(0, -1)},"id":${id}}`;
    }, id);
  }

  #send<R>(frame: () => string, id: number | undefined): Promise<R> {
    return new Promise<R>((resolve, reject) => {
      if (this.lost !== undefined) {
        throw this.lost;
      }
      this.transport.send(frame());
      this.#waiting.push({ id, resolve, reject });
    });
  }

  /** Waits until an event has come, or the connection is lost. */
  arrival(): Promise<void> {
    return new Promise((resolve) => this.#wake.push(resolve));
  }

  #take(text: string): void {
    if (this.lost !== undefined) {
      return;
    }
    let message: Message;
    try {
      message = JSON.parse(text) as Message;
    } catch (error) {
      return this.lose(new Disconnected("bad_reply", `the server sent what is no JSON: ${String(error)}`));
    }
    if (typeof message !== "object" || message === null || typeof message.type !== "string") {
      return this.lose(new Disconnected("bad_reply", "the server sent what is no message"));
    }
    const next = this.#waiting.first;
    if (next !== undefined && next.id === message.id) {
      this.#waiting.shift();
      if (message.type === "error") {
        next.reject(refusal(message));
      } else {
        next.resolve(message as never);
      }
    } else if (message.id !== undefined) {
      const told = JSON.stringify(message.id);
      this.lose(new Disconnected("bad_reply", `the server answered a command that was not next in line: ${told}`));
    } else if (message.type === "error") { // of the connection, since commands have an id
      this.lose(new Disconnected(String(message["code"]), String(message["message"])));
    } else {
      this.#tell(EVENT_TYPES.has(message.type) ? (message as unknown as KnownEvent) : { type: "unknown", message });
    }
  }

  #tell(event: Event): void {
    this.#closed ||= event.type === "world_closed";
    this.events.push(event);
    if (this.events.length > EVENT_BACKLOG) {
      this.events.shift();
      this.dropped++;
    }
    this.#awaken();
  }

  /** Ends the connection; the first reason is the one that counts. */
  lose(reason: Disconnected): void {
    if (this.lost !== undefined) {
      return;
    }
    this.lost = reason;
    this.transport.close();
    for (let next = this.#waiting.shift(); next !== undefined; next = this.#waiting.shift()) {
      next.reject(reason);
    }
    this.#awaken();
  }

  #awaken(): void {
    if (this.#wake.length > 0) {
      const waiting = this.#wake;
      this.#wake = [];
      waiting.forEach((resolve) => resolve());
    }
  }
}

/** First in, first out, in constant time. */
class Queue<T> {
  #items: (T | undefined)[] = [];
  #start = 0;

  get length(): number {
    return this.#items.length - this.#start;
  }

  get first(): T | undefined {
    return this.#items[this.#start];
  }

  push(item: T): void {
    this.#items.push(item);
  }

  shift(): T | undefined {
    const item = this.#items[this.#start];
    if (this.#start < this.#items.length) {
      this.#items[this.#start++] = undefined;
    }
    if (this.#start > 1024 && this.#start * 2 > this.#items.length) {
      this.#items = this.#items.slice(this.#start);
      this.#start = 0;
    }
    return item;
  }
}

function refusal(message: Message): CommandError {
  const field = message["field"];
  return new CommandError(String(message["code"]), String(message["message"]), typeof field === "string" ? field : undefined);
}

// What JSON.stringify makes of numbers that are none and of halves of characters, and what has to be escaped.
const SUSPECT = /null|\\ud|</;

/** Returns a message as JSON whose strings hold no delimiter. */
function encode(message: object): string {
  const text = JSON.stringify(message);
  if (SUSPECT.test(text)) {
    JSON.stringify(message, refuse);
    return text.replaceAll("<", "\\u003c");
  }
  return text;
}

/** Throws a RangeError of what JSON.stringify would change: numbers that are none, halves of characters. */
function refuse(key: string, value: unknown): unknown {
  if (typeof value === "number" && !Number.isFinite(value)) {
    throw new RangeError(`${key}: ${value} is no number that JSON has`);
  }
  if (typeof value === "string" && /\p{Surrogate}/u.test(value)) {
    throw new RangeError(`${key}: a string with half a character`);
  }
  return value;
}
