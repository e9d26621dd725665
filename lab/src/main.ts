/** The lab: its pages, in the order of the navigation; each is loaded when it is first opened. */
import { start } from "./shell.js";

start([
  { name: "worlds", title: "Worlds", icon: "worlds", load: () => import("./pages/worlds.js") },
]);
