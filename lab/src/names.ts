/** The lists that several pages choose from: genomes and tasks, those of the lab's folder first. */
import { get } from "./api.js";

export interface Named {
  readonly name: string;
  readonly ships: boolean;
}

export interface TaskItem extends Named {
  readonly description?: string;
  readonly unit?: string;
  readonly duration?: number;
  readonly roles?: readonly string[];
}

export async function genomes(signal?: AbortSignal): Promise<readonly Named[]> {
  return (await get<{ items: readonly Named[] }>("/genomes", {}, signal)).items;
}

export async function tasks(signal?: AbortSignal): Promise<readonly TaskItem[]> {
  return (await get<{ items: readonly TaskItem[] }>("/tasks", {}, signal)).items;
}

/** A run in the list. */
export interface RunItem extends Pick<Named, "name"> {
  readonly job?: number | null;
  readonly details?: Readonly<Record<string, unknown>> | null;
}

/** The newest runs whose names have this in them. */
export async function runs(name = "", signal?: AbortSignal): Promise<readonly RunItem[]> {
  return (await get<{ items: readonly RunItem[] }>("/runs", { name }, signal)).items;
}

/** Whether there is a run of that name: one that has just been started makes its folder in its first second. */
export async function isRun(name: string): Promise<boolean> {
  return (await runs(name)).some((run) => run.name === name);
}
