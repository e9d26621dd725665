/** A client of the NMES protocol for Node: over TCP, or TLS. */
import * as net from "node:net";
import * as tls from "node:tls";

import { Client, type Options } from "./client.js";
import { Disconnected } from "./errors.js";
import { DELIMITER, type Dial, type Receiver, type Transport } from "./transport.js";

export * from "./index.js";

/** The environment's variable that has the password where options do not. */
export const PASSWORD_VARIABLE = "NMES_PASSWORD";

// Bytes of one frame: a world of 10,000 cubes is a reply of some megabytes.
const LARGEST_FRAME = 256 << 20;
const END = Buffer.from(DELIMITER);

/** Where a server is, and how it is spoken to. */
export interface Address {
  /** Its name or address. Default: this machine. */
  readonly host?: string | undefined;
  /** Its TCP port. Default: 14000. */
  readonly port?: number | undefined;
  /** Speak TLS: true trusts whom Node trusts, options say more than that. Default: plain TCP. */
  readonly tls?: boolean | tls.ConnectionOptions | undefined;
}

/** Connects over TCP and enters a world. Without a password, the variable NMES_PASSWORD has it. */
export async function connect(options: Address & Partial<Options> = {}): Promise<Client> {
  const { host, port, tls: secure, ...others } = options;
  const password = others.password ?? process.env[PASSWORD_VARIABLE];
  if (!password) {
    throw new TypeError(`a client needs the server's password: give password, or set ${PASSWORD_VARIABLE}`);
  }
  return Client.open(tcp({ host, port, tls: secure }), { ...others, password });
}

/** Dials TCP, or TLS. */
export function tcp({ host = "127.0.0.1", port = 14000, tls: secure = false }: Address = {}): Dial {
  return () =>
    new Promise((resolve, reject) => {
      const more = secure === true ? {} : secure;
      const socket = more ? tls.connect({ ...more, host, port }) : net.connect({ host, port });
      const fail = (error: Error) => reject(new Disconnected("unreachable", `cannot connect to ${host}:${port}: ${error.message}`));
      socket.once("error", fail);
      socket.once(more ? "secureConnect" : "connect", () => {
        socket.off("error", fail);
        resolve(new TcpTransport(socket));
      });
    });
}

/** Frames over a socket: those that are sent in one turn of the event loop go out in one write. */
class TcpTransport implements Transport {
  #unsent: string[] = [];
  #buffer = Buffer.allocUnsafe(64 << 10);
  #length = 0; // bytes in the buffer
  #searched = 0; // no delimiter begins before this

  constructor(private readonly socket: net.Socket) {
    socket.setNoDelay(true);
  }

  start(receiver: Receiver): void {
    let reason = "the server closed the connection";
    this.socket.on("data", (data) => this.#receive(data, receiver));
    this.socket.on("error", (error) => (reason = error.message));
    this.socket.on("close", () => receiver.end("disconnected", reason));
  }

  send(frame: string): void {
    if (this.#unsent.push(frame) === 1) {
      setImmediate(() => {
        if (this.#unsent.length > 0) {
          this.#unsent.push("");
          this.socket.write(this.#unsent.join(DELIMITER));
          this.#unsent = [];
        }
      });
    }
  }

  close(): void {
    this.#unsent = [];
    this.socket.destroy();
  }

  #receive(data: Buffer, receiver: Receiver): void {
    if (this.#length + data.length > this.#buffer.length) {
      const larger = Buffer.allocUnsafe(2 * (this.#length + data.length));
      this.#buffer.copy(larger, 0, 0, this.#length);
      this.#buffer = larger;
    }
    data.copy(this.#buffer, this.#length);
    this.#length += data.length;
    const whole = this.#buffer.subarray(0, this.#length);
    const last = whole.subarray(this.#searched).lastIndexOf(END);
    if (last >= 0) {
      const end = this.#searched + last;
      // The delimiter is ASCII, so that what is decoded together may be split as text.
      const frames = whole.toString("utf8", 0, end).split(DELIMITER);
      this.#buffer.copyWithin(0, end + END.length, this.#length);
      this.#length -= end + END.length;
      for (const frame of frames) {
        const text = frame.trim();
        if (text !== "") {
          receiver.frame(text);
        }
      }
    }
    this.#searched = Math.max(0, this.#length - END.length + 1);
    if (this.#length > LARGEST_FRAME) {
      this.close();
      receiver.end("bad_reply", `a frame is longer than ${LARGEST_FRAME} bytes`);
    }
  }
}
