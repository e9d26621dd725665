/** Arrows in a scene: forces that act at a place along a direction. They are drawn over all else, in one call each. */
import * as THREE from "three";

const UP = new THREE.Vector3(0, 1, 0);
const HEAD = 0.09; // m

/** An arrow from a place along a unit vector, so strong (N or N m): the longer the more, as its logarithm. */
export interface Arrow {
  readonly at: THREE.Vector3;
  readonly along: THREE.Vector3;
  readonly strength: number;
}

export class Arrows {
  readonly group = new THREE.Group();
  private readonly material = new THREE.MeshBasicMaterial({ depthTest: false, fog: false });
  private readonly stems = new THREE.CylinderGeometry(0.012, 0.012, 1, 5).translate(0, 0.5, 0);
  private readonly heads = new THREE.ConeGeometry(0.035, HEAD, 8).translate(0, -HEAD / 2, 0);
  private readonly dots = new THREE.SphereGeometry(0.022, 8, 6);
  private meshes: THREE.InstancedMesh[] = [];
  private room = 0;

  /** @param dotted Whether the places are marked. */
  constructor(private readonly dotted: boolean) {
    this.group.renderOrder = 3;
  }

  /** How many are shown. */
  get count(): number {
    return this.meshes[0]?.count ?? 0;
  }

  paint(color: string): void {
    this.material.color.set(color);
  }

  show(arrows: readonly Arrow[]): void {
    if (arrows.length > this.room) {
      this.grow(arrows.length * 2);
    }
    const [stems, heads, dots] = this.meshes;
    const matrix = new THREE.Matrix4();
    const turn = new THREE.Quaternion();
    const tip = new THREE.Vector3();
    const scale = new THREE.Vector3();
    arrows.forEach(({ at, along, strength }, place) => {
      const length = Math.min(0.05 + Math.log1p(Math.max(strength, 0)) * 0.12, 2);
      turn.setFromUnitVectors(UP, along);
      stems?.setMatrixAt(place, matrix.compose(at, turn, scale.set(1, length, 1)));
      heads?.setMatrixAt(place, matrix.compose(tip.copy(at).addScaledVector(along, length + HEAD / 2), turn, scale.set(1, 1, 1)));
      dots?.setMatrixAt(place, matrix.compose(at, turn, scale.set(1, 1, 1)));
    });
    for (const mesh of this.meshes) {
      mesh.count = arrows.length;
      mesh.instanceMatrix.needsUpdate = true;
    }
  }

  private grow(room: number): void {
    this.dispose();
    this.room = room;
    this.meshes = [this.stems, this.heads, ...(this.dotted ? [this.dots] : [])].map((geometry) => {
      const mesh = new THREE.InstancedMesh(geometry, this.material, room);
      mesh.instanceMatrix.setUsage(THREE.DynamicDrawUsage);
      mesh.frustumCulled = false;
      mesh.renderOrder = 3;
      return mesh;
    });
    this.group.add(...this.meshes);
  }

  dispose(): void {
    this.group.remove(...this.meshes);
    this.meshes.forEach((mesh) => mesh.dispose());
  }
}
