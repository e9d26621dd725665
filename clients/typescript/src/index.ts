/** A client of the NMES protocol for any platform: over WebSockets, or over a transport of the program's own. */
export * from "./client.js";
export * from "./errors.js";
export * from "./messages.js";
export * from "./transport.js";
export { webSocket } from "./websocket.js";
