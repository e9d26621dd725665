/** What the server says of a command that it refused; nothing was changed. */
export class CommandError extends Error {
  override readonly name = "CommandError";

  constructor(
    /** Of docs/errors.md, such as cube_not_found. */
    readonly code: string,
    message: string,
    /** Where in the command the reason lies, such as mass or position/1. */
    readonly field?: string,
  ) {
    super(message);
  }
}

/** Why a connection is lost: it cannot be used any more. */
export class Disconnected extends Error {
  override readonly name = "Disconnected";

  constructor(
    /** unreachable, disconnected, world_closed, bad_reply, closed (by the program), or what the server said. */
    readonly code: string,
    message: string,
  ) {
    super(message);
  }
}
