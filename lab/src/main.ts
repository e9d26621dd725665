/** The lab: its pages, in the order of the navigation; each is loaded when it is first opened. */
import { start } from "./shell.js";

start([
  { name: "worlds", title: "Worlds", icon: "worlds", load: () => import("./pages/worlds.js") },
  { name: "build", title: "Build", icon: "build", load: () => import("./pages/build.js") },
  { name: "evolve", title: "Evolve", icon: "evolve", load: () => import("./pages/evolve.js") },
  { name: "recordings", title: "Recordings", icon: "recordings", load: () => import("./pages/recordings.js") },
  { name: "brain", title: "Brain", icon: "brain", load: () => import("./pages/brain.js") },
  { name: "leaderboard", title: "Leaderboard", icon: "leaderboard", load: () => import("./pages/leaderboard.js") },
  { name: "lessons", title: "Lessons", icon: "lessons", load: () => import("./pages/lessons.js") },
]);
