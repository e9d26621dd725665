import type { View } from "../shell.js";
import { heading } from "../shell.js";
import { append } from "../dom.js";

export function open({ root }: View): void {
  append(root, [heading("Worlds", "Worlds of this host.")]);
}
