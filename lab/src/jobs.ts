/** Commands that the lab has started: how they fare. */
import { get } from "./api.js";

export interface Job {
  readonly id: number;
  readonly state: "running" | "ended";
  /** Its exit status; null while it runs. */
  readonly status: number | null;
  /** What it goes on with: `run NAME`, or nothing. */
  readonly about: string | null;
  /** The last lines that it said. */
  readonly lines: readonly string[];
  /** What it printed as JSON, when it has ended. */
  readonly result: unknown;
  readonly command: string;
}

const PAUSE = 500; // ms between two questions

/** Waits until a command has ended, and tells in between how it fares. */
export async function ended(job: Job, signal: AbortSignal, told: (job: Job) => void = () => {}): Promise<Job> {
  while (job.state === "running") {
    await new Promise((resolve) => setTimeout(resolve, PAUSE));
    signal.throwIfAborted();
    job = await get<Job>(`/jobs/${job.id}`, {}, signal);
    told(job);
  }
  return job;
}
