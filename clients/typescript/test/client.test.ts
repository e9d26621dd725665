/** The client against servers whose ports the environment has: NMES_PORT and, with TLS, NMES_TLS_PORT and NMES_TLS_CA. */
import assert from "node:assert/strict";
import * as fs from "node:fs";
import { after, test } from "node:test";

import {
  Client,
  CommandError,
  connect,
  Disconnected,
  EVENT_BACKLOG,
  type Event,
  type Receiver,
  type Transport,
  webSocket,
} from "../src/node.js";
import { bridge } from "./websocket_bridge.js";

const port = Number(process.env["NMES_PORT"]);
const password = process.env["NMES_PASSWORD"] ?? "";
const client = await connect({ port });
await client.setMode({ mode: "lockstep" });
after(() => client.close());

test("commands are methods, and replies have types", async () => {
  const { spawned } = await client.spawnCube({ cube_name: "a", position: [0, 5, 0], friction: 0 });
  assert.equal(spawned, "a");
  const before = await client.getCubeState({ cube_name: "a" });
  await client.step({ ticks: 10 });
  const state = await client.getCubeState({ cube_name: "a" });
  assert.ok(state.position[1] < before.position[1]);
  assert.equal((await client.getWorldInfo()).mode, "lockstep");
});

test("a refused command is a CommandError with code and field, and the next ones go on", async () => {
  await assert.rejects(client.getCubeInfo({ cube_name: "nobody" }), (error: CommandError) => {
    assert.ok(error instanceof CommandError && error instanceof Error);
    assert.deepEqual([error.code, error.field], ["cube_not_found", "cube_name"]);
    return true;
  });
  await assert.rejects(client.spawnCube({ mass: -1 }), { code: "invalid", field: "mass" });
  await client.ping();
});

test("10,000 commands on their way at once are answered each by its own reply", async () => {
  const { frame } = await client.step();
  const steps = await Promise.all(Array.from({ length: 10_000 }, () => client.step()));
  assert.deepEqual(
    steps.map((step) => step.frame),
    Array.from({ length: 10_000 }, (_, number) => frame + 1 + number),
  );
});

test("of a batch each command has its own outcome", async () => {
  const [first, second, third] = await client.batch([
    { type: "spawn_cube", cube_name: "b" },
    { type: "despawn_cube", cube_name: "nobody" },
    { type: "despawn_cube", cube_name: "b" },
  ]);
  assert.ok(first && !(first instanceof CommandError) && first.type === "cube_list" && first.spawned === "b");
  assert.ok(second instanceof CommandError && second.code === "cube_not_found");
  assert.ok(third && !(third instanceof CommandError) && third.type === "cube_despawned");
});

test("what JSON cannot say is refused before it is sent, and puts nothing out of step", async () => {
  await assert.rejects(client.spawnCube({ mass: NaN }), RangeError);
  await assert.rejects(client.spawnCube({ position: [0, Infinity, 0] }), RangeError);
  await assert.rejects(client.spawnCube({ cube_name: "half \ud83d" }), RangeError);
  await assert.rejects(client.request({ type: "step", ticks: 1n as unknown as number }), TypeError);
  await client.ping();
});

test("strings with the delimiter, with null and of any characters arrive", async () => {
  for (const cube_name of ["<???DONE???---", "null", "\\ud", 'ü漢🐙"\\']) {
    assert.equal((await client.spawnCube({ cube_name, list: false })).spawned, cube_name);
    await client.despawnCube({ cube_name });
  }
});

test("events are iterated in their order, and the iteration ends with the client", async () => {
  const other = await connect({ port });
  await other.subscribe({ events: ["tick"] });
  const { frame } = await client.step({ ticks: 3 });
  const seen: Event[] = [];
  for await (const event of other.events()) {
    if (seen.push(event) === 3) {
      break;
    }
  }
  assert.deepEqual(
    seen.map((event) => event.type === "tick" && event.frame),
    [frame - 2, frame - 1, frame],
  );
  const rest = (async () => {
    for await (const event of other.events()) {
      assert.fail(event.type);
    }
  })();
  other.close();
  await rest;
  await assert.rejects(other.ping(), (error: Disconnected) => error instanceof Disconnected && error.code === "closed");
});

test("a client enters again as somebody new", async () => {
  const other = await connect({ port });
  const number = other.welcome.client;
  const waiting = assert.rejects(other.step({ ticks: 10 }), { code: "closed" });
  await other.reconnect();
  await waiting;
  assert.ok(other.welcome.client > number);
  await other.ping();
  other.close();
});

test("who enter again at once make one connection", async () => {
  const other = await connect({ port });
  const number = other.welcome.client;
  await Promise.all(Array.from({ length: 8 }, () => other.reconnect()));
  assert.equal(other.welcome.client, number + 1);
  await other.reconnect();
  assert.equal(other.welcome.client, number + 2);
  other.close();
});

test("a wrong password, a wrong world and a closed port are told", async () => {
  await assert.rejects(connect({ port, password: "wrong" }), { name: "CommandError", code: "auth_failed" });
  await assert.rejects(connect({ port, world: "nowhere" }), { name: "CommandError", code: "world_not_found" });
  await assert.rejects(connect({ port: 1 }), { name: "Disconnected", code: "unreachable" });
  const kept = process.env["NMES_PASSWORD"];
  delete process.env["NMES_PASSWORD"];
  await assert.rejects(connect({ port }), TypeError);
  process.env["NMES_PASSWORD"] = kept;
});

test("it speaks TLS with whom it trusts", async () => {
  const secure = Number(process.env["NMES_TLS_PORT"]);
  const ca = fs.readFileSync(process.env["NMES_TLS_CA"] ?? "");
  const other = await connect({ port: secure, tls: { ca } });
  await other.ping();
  other.close();
  await assert.rejects(connect({ port: secure, tls: true }), { name: "Disconnected", code: "unreachable" });
});

test("a WebSocket carries one frame a message", { skip: typeof WebSocket === "undefined" && "this Node has none" }, async (t) => {
  const between = await bridge(port);
  const other = await Client.open(webSocket(between.url), { password });
  t.after(() => other.close());
  const steps = await Promise.all(Array.from({ length: 200 }, () => other.step()));
  assert.deepEqual(
    steps.map((step) => step.frame - steps[0]!.frame),
    Array.from({ length: 200 }, (_, number) => number),
  );
  const many = await other.batch(Array.from({ length: 900 }, () => ({ type: "get_world_info" }) as const));
  assert.equal(many.length, 900);
  between.close();
  await assert.rejects(other.ping(), { name: "Disconnected", code: "disconnected" });
  await assert.rejects(Client.open(webSocket(between.url), { password }), { code: "unreachable" });
});

/** A transport whose other end is the test. */
class Loop implements Transport {
  receiver!: Receiver;
  sent: { id: number }[] = [];
  start(receiver: Receiver): void {
    this.receiver = receiver;
  }
  send(frame: string): void {
    this.sent.push(JSON.parse(frame) as { id: number });
    if (this.sent.length === 1) {
      queueMicrotask(() => this.receiver.frame('{"type":"auth_success","client":1}'));
    }
  }
  close(): void {}
}

/** Ends the turn of the event loop, and with it all that follows from what was resolved. */
const turn = (): Promise<void> => new Promise((resolve) => setImmediate(resolve));

/** A transport that notes whether it was closed, and answers when it is told to. */
class Slow extends Loop {
  closed = false;
  override send(frame: string): void {
    this.sent.push(JSON.parse(frame) as { id: number });
  }
  answer(): void {
    this.receiver.frame('{"type":"auth_success","client":1}');
  }
  override close(): void {
    this.closed = true;
  }
}

test("a client that is closed while it enters again is closed", async () => {
  const dialled: { transport: Slow; connect: () => void }[] = [];
  const opening = Client.open(
    () =>
      new Promise((resolve) => {
        const transport = new Slow();
        dialled.push({ transport, connect: () => resolve(transport) });
      }),
    { password: "x" },
  );
  const enter = async (index: number): Promise<void> => {
    dialled[index]!.connect();
    await turn();
    dialled[index]!.transport.answer();
  };
  await enter(0);
  const client = await opening;
  const refused = (entering: Promise<void>) => assert.rejects(entering, { name: "Disconnected", code: "closed" });

  const dialling = refused(client.reconnect());
  client.close();
  const next = client.reconnect(); // which does not share what was closed
  dialled[1]!.connect();
  await dialling;
  assert.ok(dialled[1]!.transport.closed);
  assert.deepEqual(dialled[1]!.transport.sent, []);
  await enter(2);
  await next;

  const authenticating = refused(client.reconnect());
  dialled[3]!.connect();
  await turn();
  client.close();
  await authenticating;
  assert.ok(dialled[3]!.transport.closed);
  await assert.rejects(client.ping(), { code: "closed" });

  const again = client.reconnect();
  await enter(4);
  await again;
  assert.deepEqual(
    dialled.map(({ transport }) => transport.closed),
    [true, true, true, true, false],
  );
});

test("who does not read events loses the oldest, and is told how many", async () => {
  const loop = new Loop();
  const other = await Client.open(() => Promise.resolve(loop), { password: "x" });
  for (let frame = 0; frame < EVENT_BACKLOG + 7; frame++) {
    loop.receiver.frame(JSON.stringify({ type: "tick", frame, t: 0 }));
  }
  assert.equal(other.dropped, 7);
  for await (const event of other.events()) {
    assert.ok(event.type === "tick" && event.frame === 7);
    break;
  }
  assert.deepEqual(loop.sent, [{ type: "auth", password: "x" }]);
});

test("an event that the schemas do not have is handed on as it came", async () => {
  const loop = new Loop();
  const other = await Client.open(() => Promise.resolve(loop), { password: "x" });
  loop.receiver.frame('{"type":"eclipse","of":"the sun"}');
  const { value } = await other.events().next();
  assert.deepEqual(value, { type: "unknown", message: { type: "eclipse", of: "the sun" } });
});

test("the loss of the connection ends an iteration with its reason", async () => {
  const loop = new Loop();
  const other = await Client.open(() => Promise.resolve(loop), { password: "x" });
  const next = other.events().next();
  loop.receiver.frame('{"type":"error","code":"slow_consumer","message":"slow"}');
  await assert.rejects(next, { name: "Disconnected", code: "slow_consumer" });
});
