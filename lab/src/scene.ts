/**
 * A scene of cubes, drawn: one instanced mesh a shape, the ground, scenery, joints and contacts, and a camera that can
 * be turned, moved, and set to follow somebody. Hides three.js. It draws only when something has changed.
 */
import * as THREE from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { Arrows } from "./arrows.js";
import { h } from "./dom.js";
import { type Contact, type Effort, type Food, type Frame, type Push, STRIDE, type Scene, type SceneCube, type SceneJoint } from "./poses.js";
import { color, onTheme } from "./theme.js";

export type Point = readonly [number, number, number];

/** A cube that is pulled with the pointer, from where it was gripped to where the pointer is. */
export interface Pull {
  /** Its name, since places change with each scene. */
  readonly cube: string;
  readonly grip: Point;
  readonly to: Point;
}

export interface StageEvents {
  /** A cube was clicked, or nothing (-1). */
  pick?(cube: number): void;
  /** A cube is pulled, told anew with each frame that is shown; `null` when it is let go. Only where this is given can cubes be pulled. */
  pull?(pull: Pull | null): void;
  /** A point of the ground was double-clicked. */
  place?(point: Point): void;
}

type Kind = "box" | "sphere" | "cylinder";

/** One body of which a cube is drawn: a capsule is three. */
interface Piece {
  readonly cube: number;
  readonly kind: Kind;
  readonly offset: THREE.Vector3;
  readonly scale: THREE.Vector3;
  readonly turn: THREE.Quaternion;
  readonly instance: number;
}

const LIGHT = new THREE.Vector3(0.45, 1, 0.35); // where the sun stands
/** What lays all flat on the ground, away from the sun. */
const FLAT = new THREE.Matrix4().set(1, -LIGHT.x / LIGHT.y, 0, 0, 0, 0, 0, 0.002, 0, -LIGHT.z / LIGHT.y, 1, 0, 0, 0, 0, 1);
const HALF_TURN = Math.PI;
const WATERY = 100; // kg/m3 from which on a medium is seen
const SLOW = 30; // ms between two drawings from which on there are fewer pixels
const FEWEST = 0.35; // pixels of the picture for one of the page, along a side, while it moves
const STILL = 300; // ms after which a picture that stands still is drawn with all pixels

const SOFTWARE = software();

export class Stage {
  readonly element: HTMLElement;
  /** Whether a cube is pulled by dragging it, also without Shift. */
  pulling = false;
  /** Whether joints are drawn. */
  joints = true;
  /** Frames that were drawn. */
  drawn = 0;
  private readonly renderer: THREE.WebGLRenderer;
  private readonly scene = new THREE.Scene();
  private readonly camera = new THREE.PerspectiveCamera(45, 1, 0.02, 2000);
  private readonly controls: OrbitControls;
  private readonly sun = new THREE.DirectionalLight(0xffffff, 2.6);
  private readonly sky = new THREE.HemisphereLight(0xffffff, 0x777777, 1.5);
  private readonly meshes = new Map<Kind, THREE.InstancedMesh>();
  private readonly geometries: Record<Kind, THREE.BufferGeometry> = {
    box: new THREE.BoxGeometry(1, 1, 1),
    sphere: new THREE.SphereGeometry(0.5, 20, 14),
    cylinder: new THREE.CylinderGeometry(0.5, 0.5, 1, 24),
  };
  private readonly fixed = new THREE.Group(); // ground and scenery
  private readonly outline = new THREE.LineSegments(new THREE.EdgesGeometry(new THREE.BoxGeometry(1.04, 1.04, 1.04)));
  private readonly axes = new THREE.LineSegments(new THREE.BufferGeometry());
  private readonly contacts = new Arrows(true);
  private readonly motors = new Arrows(false);
  private readonly pushes = new Arrows(true);
  private food = new THREE.InstancedMesh(new THREE.SphereGeometry(0.12, 10, 8), new THREE.MeshLambertMaterial(), 0);
  private readonly rope = new THREE.Line(new THREE.BufferGeometry());
  private pieces: Piece[] = [];
  private described: Scene | undefined;
  private poses = new Float32Array(0);
  private efforts: readonly Effort[] = [];
  private followed: readonly number[] = [];
  private chosen = -1;
  private requested = 0;
  private shaded = true; // whether the ground is level, so that bodies throw shadows on it
  private readonly finest = SOFTWARE ? 1 : Math.min(devicePixelRatio, 2); // pixels of the picture for one of the page
  private ratio = this.finest; // likewise, while it moves
  private still = 0; // the timer
  private pace = 16; // ms between two drawings, about
  private last = 0;
  private framed = false; // whether the camera was set once
  private pulled: { name: string; cube: number; local: THREE.Vector3; plane: THREE.Plane; to?: THREE.Vector3 } | undefined;

  constructor(label: string, private readonly signal: AbortSignal, private readonly events: StageEvents = {}) {
    this.renderer = new THREE.WebGLRenderer({ antialias: !SOFTWARE, stencil: true, powerPreference: "high-performance" });
    const canvas = this.renderer.domElement;
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "application");
    canvas.setAttribute("aria-label", `${label}. Arrow keys turn the camera, plus and minus bring it nearer and farther.`);
    this.element = h("div", { class: "stage" }, canvas);
    this.sun.position.copy(LIGHT);
    this.camera.position.set(4, 3, 6);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.enableDamping = false;
    this.controls.maxPolarAngle = HALF_TURN * 0.55;
    this.controls.minDistance = 0.3;
    this.controls.maxDistance = 800;
    this.controls.addEventListener("change", () => this.request());
    for (const lines of [this.outline, this.axes, this.rope]) {
      lines.frustumCulled = false;
      lines.renderOrder = 2;
      lines.visible = false;
    }
    this.scene.add(this.sky, this.sun, this.fixed, this.outline, this.axes, this.rope, this.contacts.group, this.motors.group, this.pushes.group);
    this.paint();
    onTheme(() => this.paint(), signal);
    const watcher = new ResizeObserver(() => this.resize());
    watcher.observe(this.element);
    this.listen(canvas);
    signal.addEventListener("abort", () => {
      watcher.disconnect();
      cancelAnimationFrame(this.requested);
      clearTimeout(this.still);
      this.controls.dispose();
      this.renderer.dispose();
      this.renderer.forceContextLoss();
    });
  }

  /** Shows who is there; where they are, the next frame says. */
  describe(scene: Scene): void {
    this.described = scene;
    this.poses = new Float32Array(scene.cubes.length * STRIDE);
    this.efforts = []; // they were those of joints of the scene before
    const counts: Record<Kind, number> = { box: 0, sphere: 0, cylinder: 0 };
    this.pieces = scene.cubes.flatMap((cube, place) => piecesOf(cube, place, counts));
    for (const kind of ["box", "sphere", "cylinder"] as const) {
      const before = this.meshes.get(kind);
      if (before !== undefined) {
        this.scene.remove(before);
        for (const mesh of [before, ...before.children] as THREE.InstancedMesh<THREE.BufferGeometry, THREE.Material>[]) {
          mesh.material.dispose(); // not what boxes are painted with, which all share
          mesh.dispose();
        }
      }
      this.meshes.delete(kind);
      if (counts[kind] > 0) {
        const material = new THREE.MeshLambertMaterial(kind === "box" ? { map: edged() } : {});
        const mesh = new THREE.InstancedMesh(this.geometries[kind], material, counts[kind]);
        mesh.instanceMatrix.setUsage(THREE.DynamicDrawUsage);
        mesh.frustumCulled = false;
        this.meshes.set(kind, mesh);
        this.scene.add(mesh);
        mesh.add(this.shadow(mesh));
      }
    }
    for (const { cube, kind, instance } of this.pieces) {
      const [red = 0.8, green = 0.8, blue = 0.8] = scene.cubes[cube]?.color ?? [];
      this.meshes.get(kind)?.setColorAt(instance, new THREE.Color().setRGB(red, green, blue, THREE.SRGBColorSpace));
    }
    this.furnish(scene);
    this.regrip(scene);
    this.request();
  }

  /** Shows where they are. */
  show({ scene, poses }: Frame): void {
    if (this.described === undefined || scene !== this.described.scene || poses.length !== this.poses.length) {
      return;
    }
    const before = this.centre();
    this.poses = poses as Float32Array<ArrayBuffer>;
    const matrix = new THREE.Matrix4();
    const position = new THREE.Vector3();
    const turn = new THREE.Quaternion();
    for (const { cube, kind, offset, scale, turn: own, instance } of this.pieces) {
      turn.fromArray(poses, cube * STRIDE + 3);
      position.copy(offset).applyQuaternion(turn);
      position.x += poses[cube * STRIDE] ?? 0;
      position.y += poses[cube * STRIDE + 1] ?? 0;
      position.z += poses[cube * STRIDE + 2] ?? 0;
      this.meshes.get(kind)?.setMatrixAt(instance, matrix.compose(position, turn.multiply(own), scale));
    }
    for (const mesh of this.meshes.values()) {
      mesh.instanceMatrix.needsUpdate = true;
      mesh.boundingSphere = null;
    }
    if (!this.framed) {
      this.overview(this.followed);
    } else if (this.followed.length > 0) {
      this.shift(this.centre().sub(before));
    }
    this.mark();
    this.tug();
    this.request();
  }

  /** Shows where food is. */
  feed(food: Food): void {
    this.scene.remove(this.food);
    this.food.dispose();
    this.food = new THREE.InstancedMesh(this.food.geometry, this.food.material, food.length);
    food.forEach(([x = 0, y = 0, z = 0], place) => this.food.setMatrixAt(place, new THREE.Matrix4().makeTranslation(x, y, z)));
    this.scene.add(this.food);
    this.element.dataset["food"] = String(food.length);
    this.request();
  }

  /** Shows where cubes touch: an arrow along the normal, the longer the more force. */
  touch(contacts: readonly Contact[]): void {
    this.contacts.show(contacts.map(([, , x, y, z, nx, ny, nz, force]) =>
      ({ at: new THREE.Vector3(x, y, z), along: new THREE.Vector3(nx, ny, nz).normalize(), strength: force })));
    this.element.dataset["contacts"] = String(this.contacts.count);
    this.request();
  }

  /** Shows what clients push: an arrow along each force, and one along the axis of each torque. */
  push(pushes: readonly Push[]): void {
    this.pushes.show(pushes.flatMap(([, x, y, z, fx, fy, fz, tx, ty, tz]) =>
      [new THREE.Vector3(fx, fy, fz), new THREE.Vector3(tx, ty, tz)].filter((vector) => vector.lengthSq() > 0)
        .map((vector) => ({ at: new THREE.Vector3(x, y, z), strength: vector.length(), along: vector.normalize() }))));
    this.element.dataset["pushes"] = String(this.pushes.count);
    this.request();
  }

  /** Shows what motors do: an arrow along the axis of the joint, the longer the more torque or force. */
  strain(efforts: readonly Effort[]): void {
    this.efforts = efforts;
    this.exert();
    this.request();
  }

  private exert(): void {
    this.motors.show(this.efforts.flatMap(([joint, effort]) => {
      const place = this.described?.joints[joint];
      if (place === undefined) return [];
      const { centre, axis } = this.standing(place);
      return [{ at: centre, along: axis.multiplyScalar(Math.sign(effort)), strength: Math.abs(effort) }];
    }));
    this.element.dataset["motors"] = String(this.motors.count);
  }

  /** Where a joint is now, and its axis, a unit vector. */
  private standing({ a, anchor, axis }: SceneJoint): { centre: THREE.Vector3; axis: THREE.Vector3 } {
    const turn = new THREE.Quaternion().fromArray(this.poses, a * STRIDE + 3);
    return {
      centre: new THREE.Vector3(...(anchor ?? [0, 0, 0])).applyQuaternion(turn).add(new THREE.Vector3(...this.position(a))),
      axis: new THREE.Vector3(...(axis ?? [0, 1, 0])).applyQuaternion(turn).normalize(),
    };
  }

  /** Marks a cube; none with -1. */
  choose(cube: number): void {
    this.chosen = cube;
    this.mark();
    this.request();
  }

  /** Has the camera go with these cubes; with none it stays where it is. */
  follow(cubes: readonly number[]): void {
    this.followed = cubes;
    if (cubes.length > 0) {
      this.shift(this.centre().sub(this.controls.target));
    }
  }

  /** Where a cube is. */
  position(cube: number): Point {
    const [x = 0, y = 0, z = 0] = this.poses.subarray(cube * STRIDE, cube * STRIDE + 3);
    return [x, y, z];
  }

  /** Brings all into the picture with the next scene that is shown: somebody is about to come. */
  widen(): void {
    this.framed = false;
  }

  /** Brings all into the picture, or some cubes. */
  overview(some: readonly number[] = []): void {
    this.framed = true;
    const box = new THREE.Box3();
    for (const cube of some.length > 0 ? some : (this.described?.cubes ?? []).keys()) {
      const half = Math.max(...(this.described?.cubes[cube]?.size ?? [1])) / 2;
      const centre = new THREE.Vector3(...this.position(cube));
      box.expandByPoint(centre.clone().addScalar(half)).expandByPoint(centre.subScalar(half));
    }
    if (box.isEmpty()) {
      box.set(new THREE.Vector3(-2, 0, -2), new THREE.Vector3(2, 1, 2));
      this.framed = false;
    }
    const sphere = box.getBoundingSphere(new THREE.Sphere());
    const radius = Math.max(sphere.radius, 0.6);
    const narrow = Math.min(this.camera.aspect, 1);
    const away = this.described?.dims === 2 ? new THREE.Vector3(0, 0.12, 1) : new THREE.Vector3(0.62, 0.48, 0.8);
    this.controls.target.copy(sphere.center);
    this.camera.position.copy(away.normalize().multiplyScalar((radius * 2.7) / narrow).add(sphere.center));
    this.controls.update();
    this.request();
  }

  /** Where the camera looks. */
  target(): Point {
    return this.controls.target.toArray();
  }

  /** Draws joints or leaves them out, as `joints` says. */
  refresh(): void {
    this.mark();
    this.request();
  }

  /** Draws when the browser next draws. */
  private request(): void {
    if (this.requested === 0 && !this.signal.aborted) {
      this.requested = requestAnimationFrame((now) => this.draw(now));
    }
  }

  private draw(now: number): void {
    this.requested = 0;
    this.measure(now - this.last);
    this.last = now;
    this.render(this.ratio);
    this.drawn++;
    clearTimeout(this.still);
    if (this.ratio < this.finest) {
      this.still = setTimeout(() => this.render(this.finest), STILL);
    }
    this.element.dataset["drawn"] = String(this.drawn);
  }

  private render(ratio: number): void {
    if (this.renderer.getPixelRatio() !== ratio) {
      this.renderer.setPixelRatio(ratio);
    }
    this.renderer.render(this.scene, this.camera);
    this.element.dataset["ratio"] = ratio.toFixed(2);
  }

  /** Draws fewer pixels where drawing falls behind. */
  private measure(between: number): void {
    if (between < 1000) {
      this.pace += (between - this.pace) * 0.1;
      if (this.pace > SLOW && this.ratio > FEWEST) {
        this.ratio = Math.max(this.ratio * 0.8, FEWEST);
        this.pace = 16;
      }
    }
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.element;
    if (width > 0 && height > 0) {
      this.renderer.setSize(width, height, false);
      this.camera.aspect = width / height;
      this.camera.updateProjectionMatrix();
      this.request();
    }
  }

  /** Takes the theme's colours. */
  private paint(): void {
    this.air("stage");
    this.outline.material = new THREE.LineBasicMaterial({ color: color("accent"), depthTest: false });
    this.axes.material = new THREE.LineBasicMaterial({ color: color("joint"), depthTest: false });
    this.food.material.color.set(color("good"));
    this.contacts.paint(color("contact"));
    this.motors.paint(color("series-3"));
    this.pushes.paint(color("series-2"));
    this.rope.material = new THREE.LineBasicMaterial({ color: color("accent"), depthTest: false });
    if (this.described !== undefined) {
      this.furnish(this.described);
    }
    this.request();
  }

  /** Takes a colour for what is far away. */
  private air(name: string): void {
    const background = new THREE.Color(color(name));
    this.scene.background = background;
    this.scene.fog = new THREE.Fog(background, 25, 160);
  }

  /** The shadows of a mesh's bodies on level ground, each place darkened once. */
  private shadow(mesh: THREE.InstancedMesh): THREE.Mesh {
    const material = new THREE.MeshBasicMaterial({ color: 0x000000, transparent: true, opacity: 0.22, depthWrite: false, fog: false });
    material.stencilWrite = true;
    material.stencilFunc = THREE.EqualStencilFunc;
    material.stencilRef = 0;
    material.stencilZPass = THREE.IncrementStencilOp;
    material.polygonOffset = true;
    material.polygonOffsetFactor = material.polygonOffsetUnits = -2;
    const shadow = new THREE.InstancedMesh(mesh.geometry, material, mesh.count);
    shadow.instanceMatrix = mesh.instanceMatrix;
    shadow.frustumCulled = false;
    shadow.matrixAutoUpdate = false;
    shadow.matrix.copy(FLAT);
    shadow.visible = this.shaded;
    shadow.raycast = () => {};
    return shadow;
  }

  /** Puts up what never moves. */
  private furnish({ scenery = { ground: true }, creatures = [] }: Scene): void {
    const { ground = true, boxes = [], planets = [], landscape = null, medium } = scenery;
    for (const child of [...this.fixed.children]) {
      this.fixed.remove(child);
      if (child instanceof THREE.Mesh) {
        const { geometry, material } = child as THREE.Mesh<THREE.BufferGeometry, THREE.MeshBasicMaterial>;
        geometry.dispose();
        material.map?.dispose(); // the ground's, which is drawn anew in the theme's colours
        material.dispose();
      }
    }
    const material = new THREE.MeshLambertMaterial({ color: color("scenery") });
    const put = (mesh: THREE.Mesh): void => void this.fixed.add(mesh);
    this.shaded = ground && landscape === null && planets.length === 0;
    for (const mesh of this.meshes.values()) {
      mesh.children.forEach((child) => (child.visible = this.shaded));
    }
    if (landscape !== null) {
      put(heightfield(landscape));
    } else if (ground) {
      const plane = new THREE.Mesh(new THREE.PlaneGeometry(400, 400), new THREE.MeshBasicMaterial({ map: grid(400, 400) }));
      plane.rotation.x = -HALF_TURN / 2;
      this.fixed.add(plane);
    }
    for (const { size, position, quaternion, shape } of boxes) {
      const mesh = new THREE.Mesh(this.geometries[shape === "sphere" || shape === "cylinder" ? shape : "box"].clone(), material);
      mesh.scale.fromArray(size);
      mesh.position.fromArray(position);
      mesh.quaternion.fromArray(quaternion);
      put(mesh);
    }
    for (const { position, radius } of planets) {
      const mesh = new THREE.Mesh(new THREE.SphereGeometry(radius, 48, 32), material);
      mesh.position.fromArray(position);
      put(mesh);
    }
    this.air(medium !== undefined && medium.level === null && medium.density > WATERY ? "deep" : "stage");
    if (medium !== undefined && medium.level !== null) {
      const surface = new THREE.MeshBasicMaterial({ color: color("water"), transparent: true, opacity: 0.45, side: THREE.DoubleSide, depthWrite: false });
      const plane = new THREE.Mesh(new THREE.PlaneGeometry(400, 400), surface);
      plane.rotation.x = -HALF_TURN / 2;
      plane.position.y = medium.level;
      put(plane);
    }
    for (const { target } of creatures) {
      if (Array.isArray(target)) {
        const mark = new THREE.Mesh(new THREE.TorusGeometry(0.25, 0.04, 8, 24), new THREE.MeshBasicMaterial({ color: color("accent") }));
        mark.rotation.x = HALF_TURN / 2;
        mark.position.fromArray(target as number[]);
        put(mark);
      }
    }
  }

  /** Puts the marks of the chosen cube and of joints where they are now. */
  private mark(): void {
    const cube = this.described?.cubes[this.chosen];
    this.outline.visible = cube !== undefined;
    if (cube !== undefined) {
      this.outline.position.set(...this.position(this.chosen));
      this.outline.quaternion.fromArray(this.poses, this.chosen * STRIDE + 3);
      this.outline.scale.set(...cube.size);
    }
    const points: number[] = [];
    if (this.joints) {
      for (const joint of this.described?.joints ?? []) {
        const edges = [joint.a, joint.b].flatMap((cube) => this.described?.cubes[cube]?.size ?? [1]);
        const { centre, axis } = this.standing(joint);
        const along = axis.multiplyScalar(Math.min(...edges) * 0.9);
        points.push(...centre.clone().sub(along).toArray(), ...centre.add(along).toArray());
      }
    }
    replace(this.axes, points);
    this.axes.visible = points.length > 0;
    this.exert();
  }

  private centre(): THREE.Vector3 {
    const sum = new THREE.Vector3();
    for (const cube of this.followed) {
      sum.add(new THREE.Vector3(...this.position(cube)));
    }
    return sum.divideScalar(Math.max(this.followed.length, 1));
  }

  private shift(by: THREE.Vector3): void {
    this.controls.target.add(by);
    this.camera.position.add(by);
    this.controls.update();
    this.request();
  }

  private listen(canvas: HTMLCanvasElement): void {
    const { signal } = this;
    let pressed: PointerEvent | undefined;
    canvas.addEventListener("pointerdown", (event) => {
      pressed = event;
      const hit = this.events.pull !== undefined && event.button === 0 && (event.shiftKey || this.pulling) ? this.hit(event) : undefined;
      if (hit !== undefined) {
        this.grip(hit.cube, hit.point);
        event.stopImmediatePropagation();
        canvas.setPointerCapture(event.pointerId);
      }
    }, { signal, capture: true });
    canvas.addEventListener("pointermove", (event) => this.drag(event), { signal });
    canvas.addEventListener("pointerup", (event) => {
      if (this.pulled !== undefined) {
        this.release();
      } else if (pressed !== undefined && Math.hypot(event.clientX - pressed.clientX, event.clientY - pressed.clientY) < 5) {
        this.events.pick?.(this.hit(event)?.cube ?? -1);
      }
      pressed = undefined;
    }, { signal });
    canvas.addEventListener("pointercancel", () => this.release(), { signal });
    canvas.addEventListener("keydown", (event) => this.turn(event), { signal });
  }

  private grip(cube: number, point: THREE.Vector3): void {
    const turn = new THREE.Quaternion().fromArray(this.poses, cube * STRIDE + 3);
    const local = point.clone().sub(new THREE.Vector3(...this.position(cube))).applyQuaternion(turn.invert());
    const plane = new THREE.Plane().setFromNormalAndCoplanarPoint(this.camera.getWorldDirection(new THREE.Vector3()), point);
    this.pulled = { name: this.described?.cubes[cube]?.name ?? "", cube, local, plane };
    this.controls.enabled = false;
  }

  /** Finds what is pulled in a new scene, and lets it go where it is no more. */
  private regrip({ cubes }: Scene): void {
    const { pulled } = this;
    if (pulled !== undefined) {
      pulled.cube = cubes.findIndex(({ name }) => name === pulled.name);
      if (pulled.cube < 0) {
        this.release();
      }
    }
  }

  private drag(event: PointerEvent): void {
    const { pulled } = this;
    const to = pulled && this.ray(event).ray.intersectPlane(pulled.plane, new THREE.Vector3());
    if (pulled === undefined || to === null || to === undefined) {
      return;
    }
    pulled.to = to;
    this.tug();
    this.request();
  }

  /** Pulls what is pulled, from where it was gripped and is now to where the pointer was last. */
  private tug(): void {
    if (this.pulled?.to === undefined) {
      return;
    }
    const { name, cube, local, to } = this.pulled;
    const turn = new THREE.Quaternion().fromArray(this.poses, cube * STRIDE + 3);
    if (turn.lengthSq() === 0) {
      return; // where it is in this scene, the next frame says
    }
    const grip = local.clone().applyQuaternion(turn).add(new THREE.Vector3(...this.position(cube)));
    replace(this.rope, [...grip.toArray(), ...to.toArray()]);
    this.rope.visible = true;
    this.events.pull?.({ cube: name, grip: grip.toArray(), to: to.toArray() });
  }

  private release(): void {
    if (this.pulled !== undefined) {
      this.pulled = undefined;
      this.controls.enabled = true;
      this.rope.visible = false;
      this.events.pull?.(null);
      this.request();
    }
  }

  private ray(event: MouseEvent): THREE.Raycaster {
    const { left, top, width, height } = this.renderer.domElement.getBoundingClientRect();
    const caster = new THREE.Raycaster();
    caster.setFromCamera(new THREE.Vector2(((event.clientX - left) / width) * 2 - 1, 1 - ((event.clientY - top) / height) * 2), this.camera);
    return caster;
  }

  private hit(event: MouseEvent): { cube: number; point: THREE.Vector3 } | undefined {
    const [nearest] = this.ray(event).intersectObjects([...this.meshes.values()], false);
    if (nearest?.instanceId === undefined) {
      return undefined;
    }
    const [kind] = [...this.meshes].find(([, mesh]) => mesh === nearest.object) ?? [];
    const piece = this.pieces.find((each) => each.kind === kind && each.instance === nearest.instanceId);
    return piece && { cube: piece.cube, point: nearest.point };
  }

  private turn(event: KeyboardEvent): void {
    const turns: Record<string, readonly [number, number, number]> = {
      ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, -0.08, 1], ArrowDown: [0, 0.08, 1],
      "+": [0, 0, 0.85], "=": [0, 0, 0.85], "-": [0, 0, 1.18],
    };
    const turn = turns[event.key];
    if (turn === undefined || event.ctrlKey || event.metaKey || event.altKey) {
      return;
    }
    event.preventDefault();
    const away = new THREE.Spherical().setFromVector3(this.camera.position.clone().sub(this.controls.target));
    away.theta += turn[0];
    away.phi = Math.min(Math.max(away.phi + turn[1], 0.05), this.controls.maxPolarAngle);
    away.radius = Math.min(Math.max(away.radius * turn[2], this.controls.minDistance), this.controls.maxDistance);
    this.camera.position.setFromSpherical(away).add(this.controls.target);
    this.controls.update();
  }
}

/** The pieces of a cube. A capsule or cylinder lies along the axis whose edge differs from two equal ones, y if none does. */
function piecesOf({ size, shape = "box" }: SceneCube, cube: number, counts: Record<Kind, number>): Piece[] {
  const [x, y, z] = size;
  const piece = (kind: Kind, scale: Point, offset: Point = [0, 0, 0], turn = new THREE.Quaternion()): Piece =>
    ({ cube, kind, offset: new THREE.Vector3(...offset), scale: new THREE.Vector3(...scale), turn, instance: counts[kind]++ });
  if (shape === "box" || shape === "sphere") {
    return [piece(shape, size)];
  }
  const along = new THREE.Vector3(...(x === z ? [0, 1, 0] : y === z ? [1, 0, 0] : [0, 0, 1]) as [number, number, number]);
  const length = along.dot(new THREE.Vector3(x, y, z));
  const across = x === z ? x : y === z ? y : x;
  const turn = new THREE.Quaternion().setFromUnitVectors(new THREE.Vector3(0, 1, 0), along);
  if (shape === "cylinder") {
    return [piece("cylinder", [across, length, across], [0, 0, 0], turn)];
  }
  const end = along.clone().multiplyScalar((length - across) / 2);
  return [
    piece("cylinder", [across, length - across, across], [0, 0, 0], turn),
    piece("sphere", [across, across, across], end.toArray()),
    piece("sphere", [across, across, across], end.clone().negate().toArray()),
  ];
}

function replace(lines: THREE.Line | THREE.LineSegments, points: readonly number[]): void {
  const geometry = lines.geometry as THREE.BufferGeometry;
  const held = geometry.getAttribute("position") as THREE.BufferAttribute | undefined;
  if (held !== undefined && held.array.length >= points.length) {
    (held.array as Float32Array).set(points);
    held.needsUpdate = true;
  } else {
    geometry.dispose();
    const attribute = new THREE.BufferAttribute(new Float32Array(Math.max(points.length * 2, 6)), 3);
    (attribute.array as Float32Array).set(points);
    geometry.setAttribute("position", attribute);
  }
  geometry.setDrawRange(0, points.length / 3);
}

/** A landscape: heights in rows along z, columns along x. */
function heightfield({ size, heights }: { size: readonly number[]; heights: readonly (readonly number[])[] }): THREE.Mesh {
  const rows = heights.length;
  const columns = heights[0]?.length ?? 0;
  const [width = 1, depth = width] = size;
  const geometry = new THREE.PlaneGeometry(width, depth, Math.max(columns - 1, 1), Math.max(rows - 1, 1));
  geometry.rotateX(-HALF_TURN / 2);
  const positions = geometry.getAttribute("position") as THREE.BufferAttribute;
  for (let row = 0; row < rows; row++) {
    for (let column = 0; column < columns; column++) {
      positions.setY(row * columns + column, heights[row]?.[column] ?? 0);
    }
  }
  geometry.computeVertexNormals();
  return new THREE.Mesh(geometry, new THREE.MeshLambertMaterial({ map: grid(width, depth) }));
}

let edges: THREE.CanvasTexture | undefined;

/** What boxes are painted with: white, a little darker along the edges. */
function edged(): THREE.Texture {
  return (edges ??= texture(64, (context) => {
    context.fillStyle = "#ffffff";
    context.fillRect(0, 0, 64, 64);
    context.strokeStyle = "rgba(0, 0, 0, 0.28)";
    context.lineWidth = 3;
    context.strokeRect(0, 0, 64, 64);
  }));
}

/** The ground of so many metres: a line each metre, a stronger one each ten. */
function grid(width: number, depth: number): THREE.Texture {
  const drawing = texture(512, (context) => {
    context.fillStyle = color("ground");
    context.fillRect(0, 0, 512, 512);
    context.strokeStyle = color("ground-line");
    for (let each = 0; each < 10; each++) {
      context.lineWidth = each === 0 ? 3 : 1;
      context.beginPath();
      context.moveTo(each * 51.2, 0);
      context.lineTo(each * 51.2, 512);
      context.moveTo(0, each * 51.2);
      context.lineTo(512, each * 51.2);
      context.stroke();
    }
  });
  drawing.wrapS = drawing.wrapT = THREE.RepeatWrapping;
  drawing.repeat.set(width / 10, depth / 10);
  drawing.anisotropy = SOFTWARE ? 1 : 8;
  return drawing;
}

/** Whether there is no graphics processor: then whatever makes each pixel dearer is left out. */
function software(): boolean {
  const context = h("canvas").getContext("webgl2");
  const about = context?.getExtension("WEBGL_debug_renderer_info");
  const name = context && about ? String(context.getParameter(about.UNMASKED_RENDERER_WEBGL)) : "";
  context?.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

function texture(size: number, draw: (context: CanvasRenderingContext2D) => void): THREE.CanvasTexture {
  const canvas = h("canvas", { width: size, height: size });
  const context = canvas.getContext("2d");
  if (context !== null) {
    draw(context);
  }
  const made = new THREE.CanvasTexture(canvas);
  made.colorSpace = THREE.SRGBColorSpace;
  return made;
}
