/**
 * Measures this client: started with the port of a world, it reads what to do and how often, a line each (pipelined
 * 20000, trips 300), and writes how many seconds that took.
 */
import * as readline from "node:readline";

import { connect } from "../src/node.js";

const ON_THEIR_WAY = 1000; // commands at once
const PUSH = { cube_name: "box", force: [1, 0, 0] } as const;

const client = await connect({ port: Number(process.argv[2]) });
await client.setMode({ mode: "lockstep" });
await client.spawnCube({ cube_name: "box" });

for await (const line of readline.createInterface({ input: process.stdin })) {
  const [what, count] = line.split(" ");
  const began = performance.now();
  await (what === "trips" ? trips(Number(count)) : pipelined(Number(count)));
  console.log((performance.now() - began) / 1000);
}
client.close();

/** A cube is pushed, the world ticks, and the cube is read; each reply is waited for, as a controller does. */
async function trips(count: number): Promise<void> {
  for (let trip = 0; trip < count; trip++) {
    await client.applyPhysics(PUSH);
    await client.step();
    await client.getCubeState({ cube_name: "box" });
  }
}

async function pipelined(count: number): Promise<void> {
  let left = count;
  const sender = async (): Promise<void> => {
    while (left-- > 0) {
      await client.applyPhysics(PUSH);
    }
  };
  await Promise.all(Array.from({ length: ON_THEIR_WAY }, sender));
}
