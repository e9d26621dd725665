/** A WebSocket server that carries each message on to a TCP port as a frame, and frames back as messages. */
import { createHash } from "node:crypto";
import * as http from "node:http";
import type { AddressInfo } from "node:net";
import type { Duplex } from "node:stream";

import { tcp } from "../src/node.js";

const MAGIC = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11"; // of RFC 6455

/** Starts one before a port; returns its address, and what ends it. */
export async function bridge(port: number): Promise<{ url: string; close: () => void }> {
  const server = http.createServer();
  const open = new Set<Duplex>();
  server.on("upgrade", (request, socket) => {
    open.add(socket);
    void (async () => {
      const accepted = createHash("sha1").update(`${request.headers["sec-websocket-key"]}${MAGIC}`).digest("base64");
      const link = await tcp({ port })();
      socket.write(
        "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n" +
          `Sec-WebSocket-Accept: ${accepted}\r\n\r\n`,
      );
      link.start({ frame: (text) => socket.write(message(text)), end: () => socket.destroy() });
      let buffer = Buffer.alloc(0);
      socket.on("data", (data: Buffer) => {
        buffer = Buffer.concat([buffer, data]);
        for (let taken = take(buffer); taken !== undefined; taken = take(buffer)) {
          buffer = buffer.subarray(taken.end);
          if (taken.opcode === 1) {
            link.send(taken.text);
          } else if (taken.opcode === 8) {
            socket.end();
          }
        }
      });
      socket.on("close", () => link.close());
      socket.on("error", () => link.close());
    })();
  });
  await new Promise<void>((resolve) => server.listen(0, "127.0.0.1", resolve));
  return {
    url: `ws://127.0.0.1:${(server.address() as AddressInfo).port}`,
    close: () => {
      open.forEach((socket) => socket.destroy());
      server.close();
    },
  };
}

/** Returns a text as a message of a server, which is not masked. */
function message(text: string): Buffer {
  const data = Buffer.from(text);
  const head = Buffer.alloc(data.length < 126 ? 2 : data.length < 65_536 ? 4 : 10);
  head[0] = 0x81;
  if (data.length < 126) {
    head[1] = data.length;
  } else if (data.length < 65_536) {
    head[1] = 126;
    head.writeUInt16BE(data.length, 2);
  } else {
    head[1] = 127;
    head.writeBigUInt64BE(BigInt(data.length), 2);
  }
  return Buffer.concat([head, data]);
}

/** Takes a message of a client, which is masked, from the start of a buffer. */
function take(buffer: Buffer): { opcode: number; text: string; end: number } | undefined {
  if (buffer.length < 2) {
    return undefined;
  }
  const short = buffer.readUInt8(1) & 127;
  const head = short < 126 ? 2 : short === 126 ? 4 : 10;
  if (buffer.length < head + 4) {
    return undefined;
  }
  const length = short < 126 ? short : short === 126 ? buffer.readUInt16BE(2) : Number(buffer.readBigUInt64BE(2));
  const end = head + 4 + length;
  if (buffer.length < end) {
    return undefined;
  }
  const mask = buffer.subarray(head, head + 4);
  const data = Buffer.from(buffer.subarray(head + 4, end)).map((byte, index) => byte ^ mask.readUInt8(index % 4));
  return { opcode: buffer.readUInt8(0) & 15, text: Buffer.from(data).toString(), end };
}
