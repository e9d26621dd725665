"""Replies and events, as dicts of known keys.

It hides nothing: the schemas describe every key, with units and bounds, and docs/messages.md shows them; a test
compares the names here with those there.
"""

from __future__ import annotations

from typing import Any, Literal, NotRequired, TypedDict

__all__ = ["Event", "JointType", "Mode", "Names"]

Names = list[str]


class AuthSuccess(TypedDict):
    type: Literal["auth_success"]
    protocol: int
    client: int
    world: str
    backend: str
    dims: int
    timestep: float
    tick_rate: float
    mode: str
    role: NotRequired[str]
    player: NotRequired[int]
    token: NotRequired[str]


class CubeList(TypedDict):
    type: Literal["cube_list"]
    spawned: NotRequired[str]
    cubes: NotRequired[Names]
    moved_to: NotRequired[list[float]]


class CubeDespawned(TypedDict):
    type: Literal["cube_despawned"]
    cube_name: str
    joints: Names


class Given(TypedDict):
    type: Literal["given"]
    player: int
    cubes: Names


class JointCreated(TypedDict):
    type: Literal["joint_created"]
    joint_name: str


class BoneCreated(TypedDict):
    type: Literal["bone_created"]
    bone_name: str


class JointRemoved(TypedDict):
    type: Literal["joint_removed"]
    joint_name: str


class JointParamSet(TypedDict):
    type: Literal["joint_param_set"]
    joint_name: str
    param_name: str
    value: float | bool


class JointParamsSet(TypedDict):
    type: Literal["joint_params_set"]
    joint_name: str
    params: dict[str, float | bool]


class JointsForCube(TypedDict):
    type: Literal["joints_for_cube"]
    cube_name: str
    joints: Names


class CubesLinked(TypedDict):
    type: Literal["cubes_linked"]
    joints: Names


class CreatureSpawned(TypedDict):
    type: Literal["creature_spawned"]
    creature: str
    cubes: dict[str, str]
    joints: dict[str, str]
    motors: Names
    voices: NotRequired[Names]
    sensors: Names
    moved_to: NotRequired[list[float]]


class Driven(TypedDict):
    type: Literal["driven"]
    creature: str
    layout: NotRequired[int]


class GenomeDocument(TypedDict):
    type: Literal["genome"]
    creature: str
    genome: dict[str, Any]


class Said(TypedDict):
    type: Literal["said"]
    channel: str
    cube_name: str


class HeardVoice(TypedDict):
    cube_name: str
    value: list[float]
    distance: float


class Heard(TypedDict):
    type: Literal["heard"]
    channel: str
    voices: list[HeardVoice]


class FoodItem(TypedDict):
    position: list[float]
    energy: float


class LivingCreature(TypedDict):
    creature: str
    energy: float
    age: float
    generation: int
    species: int
    parents: Names
    meals: int


class Life(TypedDict):
    type: Literal["life"]
    frame: int
    t: float
    born: int
    died: int
    food: list[FoodItem]
    living: list[LivingCreature]


class Fed(TypedDict):
    type: Literal["fed"]
    position: list[float]
    food: int


class Senses(TypedDict):
    type: Literal["senses"]
    creature: str
    values: list[float]
    layout: NotRequired[int]


class PartGrown(TypedDict):
    type: Literal["part_grown"]
    creature: str
    part: str
    cube: str
    layout: int


class PartShed(TypedDict):
    type: Literal["part_shed"]
    creature: str
    layout: int
    cubes: list[str]


class WorldSummary(TypedDict):
    world: str
    port: int
    backend: str
    mode: str
    frame: int | None
    clients: int
    fault: str | None
    asleep: NotRequired[bool]
    worker_port: NotRequired[int]
    ratio: NotRequired[float | None]


class WorldList(TypedDict):
    type: Literal["world_list"]
    worlds: list[WorldSummary]
    next: NotRequired[int | None]


class JointSummary(TypedDict):
    joint_name: str
    joint_type: str
    cube1: str
    cube2: str


class JointList(TypedDict):
    type: Literal["joint_list"]
    joints: list[JointSummary]


class JointInfo(JointSummary):
    type: Literal["joint_info"]
    anchor: list[float]
    axis: list[float]
    position: float
    velocity: float
    effort: float
    params: dict[str, float | bool]
    notes: NotRequired[dict[str, float]]


class PhysicsApplied(TypedDict):
    type: Literal["physics_applied"]
    cube_name: str


class CubeStateSet(TypedDict):
    type: Literal["cube_state_set"]
    cube_name: str
    moved_to: NotRequired[list[float]]


class ColorSet(TypedDict):
    type: Literal["color_set"]
    cube_name: str
    color: list[float]


class CubeFrozen(TypedDict):
    type: Literal["cube_frozen"]
    cube_name: str
    freeze: bool


class CubeMotion(TypedDict):
    cube_name: str
    position: list[float]
    rotation: list[float]
    quaternion: list[float]
    linear_velocity: list[float]
    angular_velocity: list[float]


class CubeState(CubeMotion):
    type: Literal["cube_state"]


class Touch(TypedDict):
    cube_name: str | None
    face: Literal["+x", "-x", "+y", "-y", "+z", "-z"]
    position: list[float]
    normal: list[float]
    force: float


class CubeInfo(CubeMotion):
    type: Literal["cube_info"]
    size: list[float]
    shape: NotRequired[Literal["box", "sphere", "capsule", "cylinder"]]
    mass: float
    friction: float
    restitution: float
    color: list[float]
    group: NotRequired[str]
    frozen: bool
    player: NotRequired[int | None]
    sleeping: bool
    joints: Names
    contacts: list[Touch]
    accelerometer: NotRequired[list[float]]
    gyro: NotRequired[list[float]]
    ranges: NotRequired[list[float | None]]


class CameraImage(TypedDict):
    type: Literal["camera_image"]
    cube_name: str
    width: int
    height: int
    image: str


class SensedMotion(CubeMotion):
    contacts: NotRequired[list[Touch]]
    accelerometer: NotRequired[list[float]]
    gyro: NotRequired[list[float]]


class WorldState(TypedDict):
    type: Literal["world_state"]
    frame: int
    t: float
    cubes: list[SensedMotion]


class Skeleton(TypedDict):
    snake_id: str | int
    bones: Names


class WorldInfo(TypedDict):
    type: Literal["world_info"]
    world: str
    backend: str
    versions: dict[str, Any]
    dims: int
    seed: int
    config: dict[str, Any]
    mode: str
    rate: float
    paused: bool
    frame: int
    t: float
    counts: dict[str, int]
    limits: dict[str, int]
    skeletons: NotRequired[list[Skeleton]]
    capabilities: Names
    fault: dict[str, Any] | None


class Position(TypedDict):
    x: float
    y: float
    z: float


class Planet(TypedDict):
    Name: str
    Position: Position
    Seed: int
    BiomeType: int
    ResourceLocations: list[Position]
    TreeLocations: list[Position]


class Planets(TypedDict):
    type: Literal["planets"]
    planets: list[Planet]


class WorldReset(TypedDict):
    type: Literal["world_reset"]
    frame: int
    seed: int


class Stepped(TypedDict):
    type: Literal["stepped"]
    frame: int
    t: float


class Paused(TypedDict):
    type: Literal["paused"]
    frame: int


class Resumed(TypedDict):
    type: Literal["resumed"]
    frame: int


class ModeSet(TypedDict):
    type: Literal["mode_set"]
    mode: str
    rate: float
    barrier: NotRequired[bool]


class Subscribed(TypedDict):
    type: Literal["subscribed"]
    events: Names
    every: int
    position_threshold: float
    rotation_threshold: float


class Unsubscribed(TypedDict):
    type: Literal["unsubscribed"]


class ObjectiveSet(TypedDict):
    type: Literal["objective_set"]
    name: str
    cubes: Names
    needs: list[str]


class Reward(TypedDict):
    type: Literal["reward"]
    value: float
    objective: NotRequired[str]
    metric: NotRequired[str]
    cube_name: NotRequired[str]


class BatchResult(TypedDict):
    type: Literal["batch_result"]
    results: list[dict[str, Any]]


class Pong(TypedDict):
    type: Literal["pong"]


class Tick(TypedDict):
    type: Literal["tick"]
    t: float
    frame: int


class State(TypedDict):
    type: Literal["state"]
    t: float
    frame: int
    cubes: list[CubeMotion]
    removed: Names


class WorldFault(TypedDict):
    type: Literal["world_fault"]
    code: str
    frame: int
    message: str


class BarrierTimeout(TypedDict):
    type: Literal["barrier_timeout"]
    frame: int
    clients: list[int]


class Lagging(TypedDict):
    type: Literal["lagging"]
    frame: int
    ratio: float
    behind: float
    over: bool


class HostDraining(TypedDict):
    type: Literal["host_draining"]
    seconds: float


class CreatureBorn(TypedDict):
    type: Literal["creature_born"]
    frame: int
    creature: str
    cause: Literal["founder", "newcomer", "birth", "entered"]
    parents: Names
    genome: str
    generation: int
    species: int


class CreatureDied(TypedDict):
    type: Literal["creature_died"]
    frame: int
    creature: str
    cause: Literal["starved", "old", "gone", "diverged", "unpriced"]
    generation: int
    species: int
    meals: int
    age: float


class FoodEaten(TypedDict):
    type: Literal["food_eaten"]
    frame: int
    creature: str
    position: list[float]
    energy: float


class CensusMeans(TypedDict, total=False):
    mass: float
    size: float
    cubes: float
    motors: float
    sensors: float
    energy: float
    age: float
    generation: float


class Census(TypedDict):
    type: Literal["census"]
    frame: int
    population: int
    species: int
    food: int
    born: int
    died: int
    means: CensusMeans


class RefusedChange(TypedDict):
    """What a rule of a creature's development could not do."""

    rule: int
    part: str
    code: str


class CreatureChanged(TypedDict):
    type: Literal["creature_changed"]
    frame: int
    creature: str
    layout: int
    lost_cubes: list[str]
    lost_joints: list[str]
    stage: NotRequired[int]
    refused: NotRequired[list[RefusedChange]]


class WorldClosed(TypedDict):
    type: Literal["world_closed"]


LifeEvent = CreatureBorn | CreatureDied | FoodEaten | Census
Event = Tick | State | LifeEvent | CreatureChanged | WorldFault | BarrierTimeout | Lagging | HostDraining | WorldClosed
JointType = Literal["fixed", "hinge", "slide", "slider", "pin", "conetwist"]
Mode = Literal["realtime", "lockstep", "fast"]
