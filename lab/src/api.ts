/** Questions to the lab's server, at /api: JSON in both directions, and errors that say what to do. */

/** Why a question was not answered. */
export class ApiError extends Error {
  override readonly name = "ApiError";

  constructor(
    /** unreachable, where there is no server; else what the server said. */
    readonly code: string,
    message: string,
    readonly status: number,
    /** Where in what was asked the reason lies. */
    readonly path?: string,
  ) {
    super(message);
  }
}

type Query = Record<string, string | number | undefined>;

/** Asks for something. */
export function get<T>(path: string, query: Query = {}, signal?: AbortSignal): Promise<T> {
  const asked = Object.entries(query).filter(([, value]) => value !== undefined && value !== "");
  const search = new URLSearchParams(asked.map(([name, value]) => [name, String(value)])).toString();
  return ask<T>(search === "" ? path : `${path}?${search}`, signal === undefined ? {} : { signal });
}

/** Has something done. */
export function post<T>(path: string, body: unknown = {}): Promise<T> {
  return ask<T>(path, { method: "POST", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
}

/** Keeps a document. */
export function put<T>(path: string, body: unknown): Promise<T> {
  return ask<T>(path, { method: "PUT", body: JSON.stringify(body), headers: { "Content-Type": "application/json" } });
}

/** Removes a document. */
export function remove<T>(path: string): Promise<T> {
  return ask<T>(path, { method: "DELETE" });
}

async function ask<T>(path: string, options: RequestInit): Promise<T> {
  let response: Response;
  try {
    response = await fetch(`/api${path}`, options);
  } catch (error) {
    if (error instanceof DOMException && error.name === "AbortError") {
      throw error;
    }
    throw new ApiError("unreachable", "the lab does not answer: is `nmes lab` still running?", 0);
  }
  let answer: unknown;
  try {
    answer = response.status === 204 ? {} : await response.json();
  } catch {
    throw new ApiError("bad_answer", `the lab answered /api${path} with what is no JSON (${response.status})`, response.status);
  }
  if (!response.ok) {
    const { code, message, path: where } = (answer as { error?: { code?: string; message?: string; path?: string } }).error ?? {};
    throw new ApiError(code ?? "refused", message ?? `the lab refused it (${response.status})`, response.status, where);
  }
  return answer as T;
}

/** A name as a part of a path. */
export function part(name: string): string {
  return encodeURIComponent(name);
}

/** The address of a WebSocket of the lab. */
export function socketUrl(path: string, query: Record<string, string> = {}): string {
  const search = new URLSearchParams(query).toString();
  return `${location.protocol === "https:" ? "wss:" : "ws:"}//${location.host}${path}${search === "" ? "" : `?${search}`}`;
}

/** What the lab is: asked once. */
export interface State {
  version: string;
  port?: number;
  folder?: string;
  backends?: readonly string[];
  templates?: readonly string[];
  [more: string]: unknown;
}

let known: Promise<State> | undefined;
let folder = "lab";

/** The path of something that the lab keeps, for command lines: `kept("recordings", "NAME.mcap")`. */
export function kept(...parts: readonly string[]): string {
  return [folder, ...parts].join("/");
}

/** Returns what the lab is. */
export function state(): Promise<State> {
  known ??= get<State>("/state").then((told) => {
    folder = told.folder ?? folder;
    return told;
  }).catch((error: unknown) => {
    known = undefined;
    throw error;
  });
  return known;
}

/** An error in words for people. */
export function words(error: unknown): string {
  if (error instanceof ApiError && error.path !== undefined && error.path !== "") {
    return `${error.path}: ${error.message}`;
  }
  return error instanceof Error ? error.message : String(error);
}
