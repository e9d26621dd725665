/**
 * The driver of this client for nmes conform-client: it reads one instruction a line, has the client do it, and writes
 * one answer a line. The project's docs/client-conformance.md says what the instructions are.
 */
import * as readline from "node:readline";

import { type Client, type Command, CommandError, connect, Disconnected, type Event } from "../src/node.js";

interface Instruction {
  do: string;
  host: string;
  port: number;
  password: string;
  world?: string;
  command: Command;
  commands: Command[];
  count: number;
}

let client: Client | undefined;

async function outcome(reply: Promise<unknown>, name = "reply"): Promise<object> {
  try {
    return { [name]: await reply };
  } catch (error) {
    return failure(error);
  }
}

function failure(error: unknown): object {
  if (error instanceof CommandError) {
    return { error: { code: error.code, message: error.message, field: error.field } };
  }
  if (error instanceof Disconnected) {
    return { lost: `${error.code}: ${error.message}` };
  }
  throw error;
}

async function open({ host, port, password, world }: Instruction): Promise<object> {
  client = await connect({ host, port, password, world });
  return client.welcome;
}

async function batch(one: Client, commands: Command[]): Promise<object> {
  try {
    const results = await one.batch(commands);
    return { outcomes: results.map((each) => (each instanceof CommandError ? failure(each) : { reply: each })) };
  } catch (error) {
    return failure(error);
  }
}

async function events(one: Client, count: number): Promise<object> {
  const found: Event[] = [];
  for await (const event of one.events()) {
    if (found.push(event) === count) {
      break;
    }
  }
  return { events: found };
}

async function obey(told: Instruction): Promise<object> {
  if (told.do === "open") {
    return outcome(open(told), "opened");
  }
  if (told.do === "close") {
    client?.close();
    return {};
  }
  const one = client;
  if (one === undefined) {
    throw new Error("nothing is open");
  }
  switch (told.do) {
    case "send":
      return outcome(one.request(told.command));
    case "pipeline":
      return { outcomes: await Promise.all(told.commands.map((command) => outcome(one.request(command)))) };
    case "batch":
      return batch(one, told.commands);
    case "events":
      return events(one, told.count);
    default:
      return { unsupported: told.do };
  }
}

for await (const line of readline.createInterface({ input: process.stdin })) {
  process.stdout.write(`${JSON.stringify(await obey(JSON.parse(line) as Instruction))}\n`);
}
