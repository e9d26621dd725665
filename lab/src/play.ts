/** A creature put into a world of its own, and that world watched: what Build, Evolve and Lessons end with. */
import type { Client, Command as Message } from "nmes-client";
import { ApiError, part, post, socketUrl } from "./api.js";
import { done } from "./command.js";
import { Link } from "./connection.js";
import type { Genome } from "./creature/genome.js";
import { h } from "./dom.js";
import { type Food, frame, type Scene } from "./poses.js";
import { Stage } from "./scene.js";
import { askHost, Visit } from "./world.js";

type Config = Parameters<Client["spawnCreature"]>[0]["genome"];

/** Makes sure that there is a world of that name; one that is new is made from a template. */
export async function provide(world: string, template = "default"): Promise<void> {
  const message = { type: "auth", create: { world, template } };
  try {
    await askHost(message);
    done({ message });
  } catch (error) {
    if (!(error instanceof ApiError && error.code === "world_exists")) throw error;
  }
}

export interface Wanted {
  /** The world is made anew for it: what was in it is gone. */
  readonly world: string;
  readonly name: string;
  readonly genome: Genome;
  readonly template?: string;
  readonly target?: readonly [number, number, number];
  /** Left to itself, its brain drives it. */
  readonly asleep?: boolean;
}

/** Puts a creature into a world that holds nothing else, driven by its own brain. */
export async function release({ world, name, genome, template, target, asleep = false }: Wanted): Promise<void> {
  await provide(world, template);
  const leaving = new AbortController();
  const visit = new Visit(world, leaving.signal);
  try {
    await visit.request({ type: "reset" });
    await visit.request({ type: "resume" });
    const autonomous = genome.brain !== undefined && !asleep;
    const message = {
      type: "spawn_creature" as const,
      name,
      genome: genome as unknown as Config,
      ...(autonomous ? { autonomous } : {}),
      ...(target === undefined ? {} : { target: [...target] as [number, number, number] }),
    };
    await visit.request(message);
    done({ world, message });
  } finally {
    leaving.abort();
  }
}

/** A candidate of a run in a world like that of its task, which is made anew for it. */
export interface Staged {
  readonly world: string;
  readonly creature: string;
  readonly task: string;
  readonly seed: number;
  readonly command: string;
}

/** Puts a candidate of a run into a world of its task, driven by its own brain. */
export async function stage(world: string, run: string, candidate: number | "best"): Promise<Staged> {
  const closing = { type: "auth", close: world };
  try {
    await askHost({ close: world });
    done({ message: closing });
  } catch (error) {
    if (!(error instanceof ApiError && error.code === "world_not_found")) throw error;
  }
  const staged = await post<Staged & { readonly commands: readonly Message[] }>(`/runs/${part(run)}/candidates/${candidate}/world`, { world });
  const leaving = new AbortController();
  const visit = new Visit(world, leaving.signal);
  try {
    for (const message of staged.commands) {
      await visit.request(message);
      done({ world, message });
    }
  } finally {
    leaving.abort();
  }
  done(staged.command);
  return staged;
}

/** A name for a world, made of one that a person chose. */
export function worldName(prefix: string, name: string): string {
  return `${prefix}-${name.replace(/[^\p{L}\p{N}_.-]+/gu, "-").slice(0, 60)}`;
}

/** A live view of a world; `creature` is followed. */
export function watch(world: string, creature: string | undefined, signal: AbortSignal): HTMLElement {
  const stage = new Stage(`The world ${world}`, signal);
  const places = (scene: Scene): number[] =>
    scene.cubes.flatMap((cube, place) => (creature !== undefined && cube.creature === creature ? [place] : []));
  let scene: Scene | undefined;
  let fresh = false;
  const link = new Link(socketUrl("/ws/poses", { world }), {
    message(message) {
      if (message["type"] === "food") stage.feed((message as { food?: Food }).food ?? []);
      if (message["type"] !== "scene") return;
      scene = message as unknown as Scene;
      stage.describe(scene);
      fresh = true;
    },
    data(bytes) {
      stage.show(frame(bytes));
      if (fresh && scene !== undefined) stage.follow(places(scene)); // once it is known where they are
      fresh = false;
    },
  }, signal);
  return h("div", { class: "watched" }, link.banner, stage.element);
}
