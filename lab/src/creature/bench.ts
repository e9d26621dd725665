/** Where a creature stands while it is built: drawn in three dimensions, turned with the pointer, clicked on. */

import * as three from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { h } from "../dom.js";
import { color as themed, onTheme } from "../theme.js";
import { edges, type Cube, type Face, type Joint, type Vector } from "./genome.js";
import { color, type Drawn } from "./portrait.js";
import { quaternion } from "./vectors.js";

/** A place on a part: which of its faces, and where from its centre in its own directions. */
export interface Spot {
  readonly id: string;
  readonly face: Face;
  readonly at: Vector;
}

export interface Handlers {
  /** A part was clicked. */
  press(spot: Spot): void;
  /** What would come of a click there, to be drawn as a ghost. */
  foresee(spot: Spot): readonly Cube[];
  /** What is beside all parts was clicked. */
  leave(): void;
}

const STILL = 5; // px that a pointer may move in a click
const SPEED = Math.PI / 24; // rad a key turns the view by
const START = new three.Vector3(1.0, 0.75, 1.7);

export class Bench {
  readonly element = h("div", { class: "bench" });
  readonly #renderer = new three.WebGLRenderer({ antialias: true, alpha: true });
  readonly #scene = new three.Scene();
  readonly #camera = new three.PerspectiveCamera(38, 1, 0.01, 200);
  readonly #controls: OrbitControls;
  readonly #parts = new three.Group();
  readonly #marks = new three.Group();
  readonly #ghost = new three.Group();
  readonly #ray = new three.Raycaster();
  readonly #grid = new three.LineSegments(cells(), new three.LineBasicMaterial());
  #height: number | undefined; // of the first part, m
  #due = 0;
  #framed = false;

  constructor(private readonly handlers: Handlers, signal: AbortSignal) {
    const canvas = this.#renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The creature. Arrow keys turn it, plus and minus come nearer and go away.");
    this.element.append(canvas);
    this.#scene.add(new three.HemisphereLight(0xffffff, 0x8090a0, 1.7), this.#parts, this.#marks, this.#ghost, this.#grid);
    const sun = new three.DirectionalLight(0xffffff, 1.6);
    sun.position.set(2, 5, 3);
    this.#scene.add(sun);
    this.#camera.position.copy(START);
    this.#controls = new OrbitControls(this.#camera, canvas);
    this.#controls.target.set(0, 0.2, 0);
    this.#controls.maxPolarAngle = Math.PI * 0.9;
    this.#controls.addEventListener("change", () => this.#draw());
    this.#listen(canvas, signal);
    const watch = new ResizeObserver(() => this.#fit());
    watch.observe(this.element);
    onTheme(() => this.#draw(), signal);
    signal.addEventListener("abort", () => {
      cancelAnimationFrame(this.#due);
      watch.disconnect();
      this.#controls.dispose();
      this.#renderer.dispose();
      this.#renderer.forceContextLoss();
    });
  }

  /** Shows a body; what is chosen, and its joint, stand out. */
  show(cubes: readonly Drawn[], joints: readonly Joint[], chosen: string | undefined, faint: ReadonlySet<string>): void {
    clear(this.#parts);
    clear(this.#marks);
    clear(this.#ghost);
    cubes.forEach((cube, i) => this.#parts.add(mesh(cube, color(cube, i), cube.id === chosen, faint.has(cube.id))));
    for (const joint of joints) this.#marks.add(...marks(joint, joint.cube2 === chosen || joint.cube1 === chosen));
    // A body that is lifted by its legs stays where it is in the picture: the ground goes.
    const height = cubes[0]?.position[1];
    const lift = (height ?? 0) - (this.#height ?? height ?? 0);
    this.#height = height;
    this.#camera.position.y += lift;
    this.#controls.target.y += lift;
    this.#controls.update();
    if (!this.#framed && cubes.length > 0) this.frame();
    this.#draw();
  }

  /** Brings all of the body into view. */
  frame(): void {
    const box = new three.Box3().setFromObject(this.#parts);
    if (box.isEmpty()) return;
    const sphere = box.getBoundingSphere(new three.Sphere());
    const direction = this.#camera.position.clone().sub(this.#controls.target).normalize();
    this.#controls.target.copy(sphere.center);
    this.#camera.position.copy(sphere.center).addScaledVector(direction, Math.max(1.6, sphere.radius * 3.6));
    this.#controls.update();
    this.#framed = true;
    this.#draw();
  }

  #listen(canvas: HTMLCanvasElement, signal: AbortSignal): void {
    let from: readonly [number, number] | undefined;
    canvas.addEventListener("pointerdown", (event) => { from = [event.clientX, event.clientY]; }, { signal });
    canvas.addEventListener("pointerup", (event) => {
      const still = from !== undefined && Math.hypot(event.clientX - from[0], event.clientY - from[1]) < STILL;
      from = undefined;
      if (!still || event.button !== 0) return;
      const spot = this.#spot(event);
      if (spot === undefined) this.handlers.leave();
      else this.handlers.press(spot);
    }, { signal });
    canvas.addEventListener("pointermove", (event) => {
      if (event.buttons !== 0 || event.pointerType === "touch") return;
      const spot = this.#spot(event);
      canvas.style.setProperty("cursor", spot === undefined ? "grab" : "pointer");
      this.#foresee(spot);
    }, { signal });
    canvas.addEventListener("pointerleave", () => this.#foresee(undefined), { signal });
    canvas.addEventListener("keydown", (event) => {
      const turns: Record<string, () => void> = {
        ArrowLeft: () => this.#orbit(-SPEED, 0),
        ArrowRight: () => this.#orbit(SPEED, 0),
        ArrowUp: () => this.#orbit(0, -SPEED),
        ArrowDown: () => this.#orbit(0, SPEED),
        "+": () => this.#zoom(0.9),
        "=": () => this.#zoom(0.9),
        "-": () => this.#zoom(1 / 0.9),
      };
      const turn = turns[event.key];
      if (turn === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
      event.preventDefault();
      turn();
    }, { signal });
  }

  #orbit(around: number, down: number): void {
    const offset = new three.Spherical().setFromVector3(this.#camera.position.clone().sub(this.#controls.target));
    offset.theta += around;
    offset.phi = Math.min(Math.max(offset.phi + down, 0.05), this.#controls.maxPolarAngle);
    this.#camera.position.setFromSpherical(offset).add(this.#controls.target);
    this.#controls.update();
  }

  #zoom(factor: number): void {
    this.#camera.position.sub(this.#controls.target).multiplyScalar(factor).add(this.#controls.target);
    this.#controls.update();
  }

  #spot(event: PointerEvent): Spot | undefined {
    const bounds = this.#renderer.domElement.getBoundingClientRect();
    const x = ((event.clientX - bounds.left) / bounds.width) * 2 - 1;
    const y = 1 - ((event.clientY - bounds.top) / bounds.height) * 2;
    this.#ray.setFromCamera(new three.Vector2(x, y), this.#camera);
    const hit = this.#ray.intersectObjects(this.#parts.children, false)[0];
    if (hit === undefined) return undefined;
    const at = hit.object.worldToLocal(hit.point.clone());
    const size = (hit.object.userData as { size: Vector }).size;
    // The face that the point is nearest to, as a part of the edge: so that of round ones there is one too.
    const shares = [at.x / size[0], at.y / size[1], at.z / size[2]];
    const axis = shares.reduce((best, share, i) => (Math.abs(share) > Math.abs(shares[best] ?? 0) + 1e-9 ? i : best), 0);
    const face = `${(shares[axis] ?? 0) < 0 ? "-" : "+"}${"xyz"[axis]}` as Face;
    return { id: hit.object.name, face, at: [at.x, at.y, at.z] };
  }

  #foresee(spot: Spot | undefined): void {
    const had = this.#ghost.children.length > 0;
    clear(this.#ghost);
    for (const cube of spot === undefined ? [] : this.handlers.foresee(spot)) {
      const drawn = mesh(cube, color(cube, 0), false, true);
      this.#ghost.add(drawn);
    }
    if (had || this.#ghost.children.length > 0) this.#draw();
  }

  #fit(): void {
    const { clientWidth, clientHeight } = this.element;
    if (clientWidth === 0 || clientHeight === 0) return;
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    this.#renderer.setSize(clientWidth, clientHeight);
    this.#camera.aspect = clientWidth / clientHeight;
    this.#camera.updateProjectionMatrix();
    this.#draw();
  }

  #draw(): void {
    cancelAnimationFrame(this.#due);
    this.#due = requestAnimationFrame(() => {
      this.#grid.material.color.set(themed("ground-line"));
      this.#renderer.render(this.#scene, this.#camera);
    });
  }
}

/** A grid on the ground: cell by cell, since some renderers drop lines that go on behind the camera. */
function cells(): three.BufferGeometry {
  const [reach, cell] = [4, 0.25];
  const points: number[] = [];
  for (let a = -reach; a <= reach; a += cell) {
    for (let b = -reach; b < reach; b += cell) points.push(a, 0, b, a, 0, b + cell, b, 0, a, b + cell, 0, a);
  }
  return new three.BufferGeometry().setAttribute("position", new three.Float32BufferAttribute(points, 3));
}

function mesh(cube: Drawn, [r = 0, g = 0, b = 0]: readonly number[], chosen: boolean, faint: boolean): three.Mesh {
  const size = edges(cube);
  const material = new three.MeshStandardMaterial({ color: new three.Color().setRGB(r, g, b, three.SRGBColorSpace), roughness: 0.75 });
  if (faint) Object.assign(material, { transparent: true, opacity: 0.45, depthWrite: false });
  const drawn = new three.Mesh(geometry(cube.shape ?? "box", size), material);
  drawn.name = cube.id;
  drawn.userData = { size };
  drawn.position.set(...(cube.position as [number, number, number]));
  drawn.quaternion.set(...(quaternion(cube.rotation) as [number, number, number, number]));
  const outline = new three.LineSegments(
    new three.EdgesGeometry(drawn.geometry, 30),
    new three.LineBasicMaterial({ color: chosen ? 0xff9d2e : 0x20262e, transparent: true, opacity: chosen ? 1 : 0.35 }),
  );
  outline.raycast = () => undefined;
  if (chosen) material.emissive.set(0x553300);
  drawn.add(outline);
  return drawn;
}

function geometry(shape: string, [x, y, z]: Vector): three.BufferGeometry {
  if (shape === "sphere") return new three.SphereGeometry(x / 2, 24, 16);
  if (shape === "box") return new three.BoxGeometry(x, y, z);
  const along = x === z ? 1 : y === z ? 0 : 2;
  const [length, across] = [[x, y, z][along] ?? y, [x, y, z][(along + 1) % 3] ?? x];
  const made = shape === "capsule"
    ? new three.CapsuleGeometry(across / 2, length - across, 8, 20)
    : new three.CylinderGeometry(across / 2, across / 2, length, 28);
  if (along === 0) made.rotateZ(-Math.PI / 2);
  if (along === 2) made.rotateX(Math.PI / 2);
  return made;
}

function marks(joint: Joint, chosen: boolean): three.Object3D[] {
  const paint = { color: chosen ? 0xff9d2e : 0x9aa4b0, depthTest: false, transparent: true, opacity: chosen ? 1 : 0.5 };
  const ball = new three.Mesh(new three.SphereGeometry(chosen ? 0.018 : 0.011, 12, 8), new three.MeshBasicMaterial(paint));
  const anchor = new three.Vector3(...(joint.anchor as [number, number, number]));
  ball.position.copy(anchor);
  ball.renderOrder = 2;
  if (!chosen || (joint.type !== "hinge" && joint.type !== "slide")) return [ball];
  const axis = new three.Vector3(...((joint.axis ?? (joint.type === "hinge" ? [0, 0, 1] : [1, 0, 0])) as [number, number, number]));
  const reach = axis.normalize().multiplyScalar(0.16);
  const line = new three.Line(
    new three.BufferGeometry().setFromPoints([anchor.clone().sub(reach), anchor.clone().add(reach)]),
    new three.LineBasicMaterial(paint),
  );
  line.renderOrder = 2;
  return [ball, line];
}

function clear(group: three.Group): void {
  group.traverse((each) => {
    if (each instanceof three.Mesh || each instanceof three.Line) {
      (each.geometry as three.BufferGeometry).dispose();
      for (const material of [each.material].flat() as three.Material[]) material.dispose();
    }
  });
  group.clear();
}
