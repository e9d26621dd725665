/** The lessons: five that a class does in 45 minutes. Each step says something, does it, and sees whether it came so. */
import type { Command } from "nmes-client";
import { withBrain } from "../creature/brains.js";
import { add, fresh } from "../creature/creature.js";
import type { Brain, Genome, Vector } from "../creature/genome.js";

/** What a step can do with the lab. */
export interface Lab {
  /** Sends a command to the lesson's world. */
  send(command: Command): Promise<unknown>;
  /** Puts a creature called `it` into the lesson's world, and nothing else. */
  release(genome: Genome, more?: { readonly asleep?: boolean; readonly target?: Vector }): Promise<void>;
  /** Empties the lesson's world. */
  clear(): Promise<void>;
  /** Where a cube is, m. */
  position(cube: string): Promise<Vector>;
  /** Waits until the world has gone on by so many seconds of its own. */
  wait(seconds: number): Promise<void>;
  /** A genome that ships. */
  genome(name: string): Promise<Genome>;
  /** Evolves a genome; tells the score of the first candidate and of the best, and its genome. */
  evolve(genome: Genome, budget: number): Promise<Evolved>;
  /** Tells how far a step is. */
  tell(text: string): void;
  /** What steps leave for later ones of their lesson. */
  readonly kept: Map<string, unknown>;
}

export interface Evolved {
  readonly first: number;
  readonly best: number;
  readonly champion: Genome;
}

export interface Step {
  readonly say: string;
  /** What to guess before the button is pressed. */
  readonly guess?: string;
  readonly button: string;
  /** Does it, and returns in words what came of it; throws a `Surprise` where something else came of it. */
  run(lab: Lab): Promise<string>;
}

export interface Lesson {
  readonly id: string;
  readonly title: string;
  readonly minutes: number;
  readonly about: string;
  readonly steps: readonly Step[];
  /** What to do with the time that is left. */
  readonly more: string;
  readonly page: "worlds" | "build" | "evolve";
}

/** What came of a step is not what the lesson says. */
export class Surprise extends Error {}

export const LESSONS: readonly Lesson[] = [
  {
    id: "worlds",
    title: "A world that obeys",
    minutes: 6,
    about: "A world here is a list of commands and ticks: the same list makes the same world, on every machine.",
    more: "In Worlds, make a world of your own, and pull its cubes about with the mouse.",
    page: "worlds",
    steps: [
      {
        say: "This world is empty, but it has gravity. A cube is put three metres above the ground.",
        button: "Drop a cube",
        async run(lab) {
          await lab.clear();
          await lab.send({ type: "spawn_cube", cube_name: "cube", position: [0, 3, 0], size: 0.5, mass: 1, color: [0.85, 0.55, 0.2] });
          const [, height] = await settled(lab, "cube", 1);
          return expect(height < 0.3, `It fell, and rests with its centre at ${metres(height)}: half of its edge.`);
        },
      },
      {
        say: "Now a light cube and one that is five hundred times as heavy, from the same height.",
        guess: "Which is down first?",
        button: "Drop both",
        async run(lab) {
          await lab.clear();
          const common = { type: "spawn_cube", size: 0.4 } as const;
          await Promise.all([
            lab.send({ ...common, cube_name: "light", position: [-0.6, 4, 0], mass: 0.1, color: [0.9, 0.85, 0.6] }),
            lab.send({ ...common, cube_name: "heavy", position: [0.6, 4, 0], mass: 50, color: [0.3, 0.3, 0.35] }),
          ]);
          await lab.wait(0.5);
          const [[, light], [, heavy]] = await Promise.all([lab.position("light"), lab.position("heavy")]);
          return expect(Math.abs(light - heavy) < 0.2, "They fell side by side. Where there is no air, it is all the same how heavy a thing is.");
        },
      },
      {
        say: "A push is a command too. It acts for one tick, a sixtieth of a second, and the cube goes on by itself until the ground has stopped it.",
        button: "Push the light one",
        async run(lab) {
          const [before] = await settled(lab, "light", 0); // it may still fall, and would be pushed in the air
          await lab.send({ type: "apply_physics", cube_name: "light", impulse: [-0.4, 0.2, 0] });
          const [after] = await settled(lab, "light", 1);
          return expect(before - after > 0.5, `It came ${metres(before - after)} far. The command stands below: whoever sends it to the same world gets the same.`);
        },
      },
    ],
  },
  {
    id: "bodies",
    title: "A body",
    minutes: 9,
    about: "A creature is cubes, joints between them, and motors on the joints.",
    more: "In Build, make one with six legs, or none, and drop it into a world.",
    page: "build",
    steps: [
      {
        say: "Every creature begins with a trunk. It lies where it is put.",
        button: "Make a trunk",
        async run(lab) {
          await lab.release(fresh("trunk"));
          return "There it lies: six kilograms that can do nothing.";
        },
      },
      {
        say: "Four legs hang on it now, each by a hinge: a joint that turns about one axis, as a door does.",
        guess: "Will it stand?",
        button: "Give it legs",
        async run(lab) {
          await lab.release(quadruped(), { asleep: true });
          const [, height] = await settled(lab, "it.trunk", 1.5);
          return expect(height > 0.2, `It stands, its trunk ${metres(height)} above the ground. Its motors hold the legs where they are.`);
        },
      },
      {
        say: "A motor takes a number from -1 to 1, and turns its joint to that place in its range. Here you are the brain.",
        button: "Swing its legs",
        async run(lab) {
          const [before] = await lab.position("it.trunk");
          let farthest = 0;
          for (const swing of [0.8, -0.8, 0.8, -0.8, 0]) {
            await lab.send({ type: "drive", creature: "it", controls: [swing, swing, swing, swing] });
            await lab.wait(0.5);
            const [now] = await lab.position("it.trunk");
            farthest = Math.max(farthest, Math.abs(now - before));
          }
          return expect(farthest > 0.03, "It rocked. To walk it would need such numbers sixty times a second: that is what a brain is for.");
        },
      },
    ],
  },
  {
    id: "brains",
    title: "A rhythm is a brain",
    minutes: 9,
    about: "Animals walk by rhythms that their spines make. A wave for each motor is enough to begin with.",
    more: "In Build, choose a leg, and change how its wave begins, how far it swings, and how fast.",
    page: "build",
    steps: [
      {
        say: "All four legs swing alike now, forth and back about the middle.",
        guess: "How far will it come in five seconds?",
        button: "All legs alike",
        async run(lab) {
          const far = await walked(lab, waves(() => ({ phase: 0, offset: 0 })));
          lab.kept.set("alike", far);
          return `It came ${metres(Math.abs(far))} far. What it pushes itself forth by, it pushes itself back by.`;
        },
      },
      {
        say: "Now legs that lie across from each other swing together, and all swing about a place that is farther ahead. Horses call it a trot.",
        guess: "And now?",
        button: "Let it trot",
        async run(lab) {
          const far = await walked(lab, quadruped());
          const before = lab.kept.get("alike") as number | undefined;
          return expect(far > 0.5 && far > (before ?? 0) + 0.3, `It came ${metres(far)} far, and did not fall. Nothing but the timing has changed.`);
        },
      },
    ],
  },
  {
    id: "evolution",
    title: "Evolution",
    minutes: 12,
    about: "Nobody has to find the numbers: change them a little, keep what is better, and do it again.",
    more: "In Evolve, give the run another seed, or begin with random creatures.",
    page: "evolve",
    steps: [
      {
        say: "The lab makes forty children of your creature, one change each: a longer leg, another rhythm. Each walks for ten seconds, three times, and the farther it comes the better. That takes about a minute.",
        guess: "How much farther will the best come?",
        button: "Evolve it",
        async run(lab) {
          const { first, best, champion } = await lab.evolve(quadruped(), 40);
          lab.kept.set("champion", champion);
          return expect(best >= first, `Yours has a score of ${metres(first)}, the best of its children ${metres(best)}. What was changed, nobody planned.`);
        },
      },
      {
        say: "What it has come to can be watched.",
        button: "Watch the champion",
        async run(lab) {
          const champion = lab.kept.get("champion") as Genome | undefined;
          if (champion === undefined) throw new Surprise("Evolve it first.");
          const far = await walked(lab, champion);
          return expect(far > 0.3, `It came ${metres(far)} far in five seconds.`);
        },
      },
    ],
  },
  {
    id: "senses",
    title: "Senses",
    minutes: 9,
    about: "A rhythm is blind. Whoever wants to get somewhere must know where it is.",
    more: "In Build, open the seeker, and look at what its brain listens to.",
    page: "build",
    steps: [
      {
        say: "The seeker has wheels, and one sense: where its target is, seen from itself. Its brain turns to the side on which that is.",
        button: "Show it a target",
        async run(lab) {
          const far = await seek(lab, [3, 0, 2]);
          return expect(far < 1.5, `It drove there: ${metres(far)} are left between it and the target.`);
        },
      },
      {
        say: "The target comes to be behind it, on the other side.",
        guess: "Will it turn round?",
        button: "Move the target",
        async run(lab) {
          const far = await seek(lab, [-2.5, 0, -2]);
          return expect(far < 1.5, `It turned, and came to within ${metres(far)}. Its brain is the same as before: what it senses has changed.`);
        },
      },
    ],
  },
];

/** The creature of the lessons: a trunk with four legs that trot. */
export function quadruped(): Genome {
  const front = add(fresh("quadruped"), "trunk", "+z", [0.22, 0, 0.15], "leg", true).genome;
  return add(front, "trunk", "+z", [-0.22, 0, 0.15], "leg", true).genome;
}

interface Wave {
  readonly motor: string;
  readonly phase: number;
  readonly offset: number;
}

function waves(change: (wave: Wave) => Partial<Wave>): Genome {
  const genome = withBrain(quadruped(), "sine");
  const brain = genome.brain as Brain;
  const oscillators = (brain["oscillators"] as readonly Wave[]).map((wave) => ({ ...wave, ...change(wave) }));
  return { ...genome, brain: { ...brain, oscillators } };
}

/** How far along x a creature comes in five seconds. */
async function walked(lab: Lab, genome: Genome): Promise<number> {
  await lab.release(genome);
  const root = `it.${genome.body.cubes?.[0]?.id ?? "trunk"}`;
  const [before] = await lab.position(root);
  for (let second = 1; second <= 5; second += 1) {
    await lab.wait(1);
    lab.tell(`${second} of 5 s`);
  }
  const [after] = await lab.position(root);
  return after - before;
}

/** Shows the seeker a target; tells how near it comes within fifteen seconds, m. */
async function seek(lab: Lab, target: Vector): Promise<number> {
  await lab.release(await lab.genome("seeker"), { target });
  const marker = [target[0], 0.05, target[2]] as [number, number, number];
  await lab.send({ type: "spawn_cube", cube_name: "flag", position: marker, size: 0.1, mass: 0.01, color: [0.9, 0.2, 0.2] });
  let nearest = Infinity;
  for (let second = 1; second <= 15 && nearest > 0.6; second += 1) {
    await lab.wait(1);
    const [x, , z] = await lab.position("it.chassis");
    nearest = Math.min(nearest, Math.hypot(x - target[0], z - target[2]));
    lab.tell(`${metres(nearest)} to go`);
  }
  return nearest;
}

/** Where a cube is when it has had some seconds to come to rest. */
async function settled(lab: Lab, cube: string, seconds: number): Promise<Vector> {
  await lab.wait(seconds);
  for (let tries = 0; tries < 20; tries += 1) {
    const before = await lab.position(cube);
    await lab.wait(0.25);
    const after = await lab.position(cube);
    if (Math.hypot(...after.map((value, i) => value - (before[i] ?? 0))) < 0.002) return after;
  }
  return lab.position(cube);
}

function expect(so: boolean, words: string): string {
  if (!so) throw new Surprise(`That came out otherwise. Do it once more. (The lesson says: ${words})`);
  return words;
}

const metres = (value: number): string => `${value.toFixed(2)} m`;
