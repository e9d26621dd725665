import { Disconnected } from "./errors.js";
import type { Dial, Receiver, Transport } from "./transport.js";

/** Dials a WebSocket that carries one frame a message: where there is one, as in browsers. */
export function webSocket(url: string): Dial {
  return () =>
    new Promise((resolve, reject) => {
      const socket = new WebSocket(url);
      socket.binaryType = "arraybuffer";
      socket.onopen = () => resolve(new WebSocketTransport(socket));
      socket.onerror = () => reject(new Disconnected("unreachable", `cannot connect to ${url}`));
    });
}

class WebSocketTransport implements Transport {
  constructor(private readonly socket: WebSocket) {}

  start(receiver: Receiver): void {
    this.socket.onmessage = (event: MessageEvent<unknown>) => {
      if (typeof event.data === "string") {
        receiver.frame(event.data);
      } else {
        this.socket.close();
        receiver.end("bad_reply", "the server sent a message that is no text");
      }
    };
    this.socket.onerror = null;
    this.socket.onclose = (event) => receiver.end("disconnected", `the server closed the connection (${event.code})`);
  }

  send(frame: string): void {
    this.socket.send(frame);
  }

  close(): void {
    this.socket.close();
  }
}
