/** How frames are carried to a server and back. A transport knows nothing of what is in them. */
export interface Transport {
  /** Says who takes what comes; called once, before anything is sent. */
  start(receiver: Receiver): void;
  /** Sends a frame, without its delimiter. */
  send(frame: string): void;
  /** Ends the connection; nothing comes after that. */
  close(): void;
}

/** Who takes what a transport brings. */
export interface Receiver {
  /** Takes a frame, without its delimiter. */
  frame(text: string): void;
  /** Notes the end of the connection, and why. */
  end(code: string, reason: string): void;
}

/** Connects, as often as it is called. */
export type Dial = () => Promise<Transport>;

/** What ends each frame where bytes have no bounds of their own. */
export const DELIMITER = "<???DONE???---";
