/**
 * A swarm: cubes that see each other once a tick, gather, and keep their distance. Start a server, then
 *
 *     NMES_PASSWORD=... node dist/examples/swarm.js 127.0.0.1 14000
 *
 * It prints how far the cubes are from their middle, m, at first and in the end.
 */
import { connect, type Vector } from "../src/node.js";

const CUBES = 24;
const TICKS = 480;
const APART = 1.5; // m that they keep

const [host, port] = process.argv.slice(2);
const client = await connect({ host, port: port === undefined ? undefined : Number(port) });
await client.setMode({ mode: "lockstep" });
const names = Array.from({ length: CUBES }, (_, number) => `swarm_${number}`);
await client.batch(
  names.map((cube_name, number) => {
    const angle = (2 * Math.PI * number) / CUBES;
    const position: Vector = [15 * Math.cos(angle), 0.3, 15 * Math.sin(angle)];
    return { type: "spawn_cube", cube_name, position, size: 0.5, mass: 1, friction: 0.2 };
  }),
);

let places = await look();
const first = spread(places);
for (let tick = 0; tick < TICKS; tick++) {
  // Sent together: the world ticks when it has all of the forces, and is looked at after that.
  const acted = [...places].map(([cube_name, place]) => client.applyPhysics({ cube_name, force: pull(place) }));
  const stepped = client.step();
  places = await look();
  await Promise.all([...acted, stepped]);
}
console.log(`${first.toFixed(1)} ${spread(places).toFixed(1)}`);
client.close();

async function look(): Promise<Map<string, Vector>> {
  const state = await client.getWorldState({ cubes: names });
  return new Map(state.cubes.map((cube) => [cube.cube_name, cube.position]));
}

function middle(): Vector {
  const all = [...places.values()];
  const mean = (axis: 0 | 2) => all.reduce((total, place) => total + place[axis], 0) / all.length;
  return [mean(0), 0, mean(2)];
}

/** Returns the force on a cube, N: towards the middle, away from whoever is too near. */
function pull(place: Vector): Vector {
  const centre = middle();
  let [x, z] = [centre[0] - place[0], centre[2] - place[2]];
  for (const other of places.values()) {
    const [dx, dz] = [place[0] - other[0], place[2] - other[2]];
    const distance = Math.hypot(dx, dz);
    if (distance > 0 && distance < APART) {
      x += (8 * dx * (APART - distance)) / distance;
      z += (8 * dz * (APART - distance)) / distance;
    }
  }
  return [0.5 * x, 0, 0.5 * z];
}

function spread(all: Map<string, Vector>): number {
  places = all;
  const centre = middle();
  return Math.max(...[...all.values()].map((place) => Math.hypot(place[0] - centre[0], place[2] - centre[2])));
}
