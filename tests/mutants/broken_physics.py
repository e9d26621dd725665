"""Servers that are wrong about physics or determinism. See `defects`."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pymunk
from pytest import MonkeyPatch

from defects import Answer, JsonObject, around, defect
from nmes.backend import BodySpec, BodyState, JointParams, SceneSpec
from nmes.world import World, joint_params, readings, scenery
from nmes.world import entities as entities_module
from nmes.world.clients import Client
from nmes.world.entities import Cube, Entities, Joint

# -- physics ----------------------------------------------------------------------------------------------------------


@defect("13.9:apply_physics", "13.9:apply_force")
def forces_that_last_two_ticks(patch: MonkeyPatch) -> None:
    """It applies a force during two ticks."""
    apply, tick = Entities.apply, World.tick
    pushes: list[tuple[Entities, Cube, JsonObject]] = []

    def remember(entities: Entities, cube: Cube, command: JsonObject) -> None:
        apply(entities, cube, command)
        pushes.append((entities, cube, command))

    def again(world: World) -> None:
        tick(world)
        for entities, cube, command in pushes:
            if entities is world.entities and entities.cubes.get(cube.name) is cube and "force" in command:
                apply(entities, cube, {"force": command["force"]})
        pushes.clear()

    patch.setattr(Entities, "apply", remember)
    patch.setattr(World, "tick", again)


def _pushes(patch: MonkeyPatch, change: Callable[[Entities, Cube, JsonObject], JsonObject]) -> None:
    """Has what acts on cubes changed."""
    apply = Entities.apply
    patch.setattr(
        Entities, "apply", lambda entities, cube, command: apply(entities, cube, change(entities, cube, command))
    )


@defect("13.8")
def impulses_twice(patch: MonkeyPatch) -> None:
    """It applies an impulse twice."""
    _pushes(
        patch,
        lambda entities, cube, command: (
            {**command, "impulse": [2 * x for x in command["impulse"]]} if "impulse" in command else command
        ),
    )


@defect("13.8")
def impulses_are_velocities(patch: MonkeyPatch) -> None:
    """It changes a velocity by the impulse, whatever the mass."""
    _pushes(
        patch,
        lambda entities, cube, command: (
            {**command, "impulse": [cube.mass * x for x in command["impulse"]]} if "impulse" in command else command
        ),
    )


@defect("13.10")
def the_last_force_only(patch: MonkeyPatch) -> None:
    """It forgets a force when another one comes before the tick."""
    apply = Entities.apply
    last: dict[str, JsonObject] = {}
    tick = World.tick

    def remember(entities: Entities, cube: Cube, command: JsonObject) -> None:
        last[cube.name] = command

    def act(world: World) -> None:
        for name, command in last.items():
            cube = world.entities.cubes.get(name)
            if cube is not None:
                apply(world.entities, cube, command)
        last.clear()
        tick(world)

    patch.setattr(Entities, "apply", remember)
    patch.setattr(World, "tick", act)


@defect("13.11")
def impulses_before_the_tick(patch: MonkeyPatch) -> None:
    """It changes a velocity as soon as it is told of an impulse."""
    apply = Entities.apply

    def at_once(entities: Entities, cube: Cube, command: JsonObject) -> None:
        if "impulse" in command and not cube.frozen:
            state = entities.simulation.body_state(cube.body)
            x, y, z = (v + p / cube.mass for v, p in zip(state.linear_velocity, command["impulse"], strict=True))
            entities.simulation.set_body_state(cube.body, replace(state, linear_velocity=(x, y, z)))
            command = {key: value for key, value in command.items() if key != "impulse"}
        apply(entities, cube, command)

    patch.setattr(Entities, "apply", at_once)


@defect("13.12", "13.14:x", backend="mujoco")
def turned_about_another_axis(patch: MonkeyPatch) -> None:
    """It turns a cube about y where it should about x, and so on."""

    def turn(entities: Entities, cube: Cube, command: JsonObject) -> JsonObject:
        return {key: [v[2], v[0], v[1]] if key == "angular_impulse" else v for key, v in command.items()}

    _pushes(patch, turn)


@defect("13.15", backend="mujoco")
def pushed_on_the_other_side(patch: MonkeyPatch) -> None:
    """It takes the arm of a push from the point to the centre."""

    def mirror(entities: Entities, cube: Cube, command: JsonObject) -> JsonObject:
        if "at" not in command:
            return command
        centre = entities.simulation.body_state(cube.body).position
        return {**command, "at": [2 * a - b for a, b in zip(centre, command["at"], strict=True)]}

    _pushes(patch, mirror)


def _scene(patch: MonkeyPatch, **changes: Any) -> None:
    spec = scenery.scene_spec

    def changed(config: Mapping[str, Any], seed: int) -> SceneSpec:
        return replace(spec(config, seed), **changes)

    patch.setattr(scenery, "scene_spec", changed)


@defect("13.1:1-kg", "13.2", "13.4")
def gravity_upwards(patch: MonkeyPatch) -> None:
    """It lets cubes fall upwards."""
    _scene(patch, gravity=(0.0, 9.81, 0.0))


@defect("13.1:1-kg", "13.1:1-g", "13.2")
def gravity_of_the_moon(patch: MonkeyPatch) -> None:
    """It lets cubes fall with a sixth of the acceleration."""
    _scene(patch, gravity=(0.0, -1.62, 0.0))


@defect("13.3", "13.1:1-kg")
def gravity_along_z(patch: MonkeyPatch) -> None:
    """It takes z for the direction that points up."""
    _scene(patch, gravity=(0.0, 0.0, -9.81))


@defect("13.6:1-m", "13.5:cube", backend="mujoco")
def no_ground(patch: MonkeyPatch) -> None:
    """It has no ground."""
    _scene(patch, ground=False)


@defect("13.7", backend="mujoco")
def ice(patch: MonkeyPatch) -> None:
    """It knows no friction."""

    patch.setattr(entities_module, "BodySpec", lambda **fields: BodySpec(**{**fields, "friction": 0.0}))


GROUPS = {"collision_groups": {"runners": ["runners"], "walls": []}}


@defect("13.45", backend="mujoco", config=GROUPS)
def groups_that_change_nothing(patch: MonkeyPatch) -> None:
    """It lets all cubes collide, whatever their groups."""
    patch.setattr(entities_module, "BodySpec", lambda **fields: BodySpec(**{**fields, "group": 0}))


@defect("13.46", backend="pymunk", config=GROUPS)
def groups_that_are_not_there(patch: MonkeyPatch) -> None:
    """It makes a cube of a group that the world has not, as one of none."""
    spawn = Entities.spawn

    def lenient(entities: Entities, command: JsonObject) -> Cube:
        known = command.get("group") in entities._config.get("collision_groups", {})
        return spawn(entities, command if known else {k: v for k, v in command.items() if k != "group"})

    patch.setattr(Entities, "spawn", lenient)


@defect("13.17")
def frozen_cubes_move(patch: MonkeyPatch) -> None:
    """It moves a frozen cube that something pushes."""
    apply = Entities.apply

    def shift(entities: Entities, cube: Cube, command: JsonObject) -> None:
        apply(entities, cube, command)
        if cube.frozen:
            state = entities.simulation.body_state(cube.body)
            x, y, z = state.position
            entities.simulation.set_body_state(cube.body, replace(state, position=(x + 0.01, y, z)))

    patch.setattr(Entities, "apply", shift)


@defect("13.18")
def frozen_cubes_keep_their_velocity(patch: MonkeyPatch) -> None:
    """It lets a cube go with the velocity that it had when it was frozen."""
    freeze = Entities.freeze
    velocities: dict[int, BodyState] = {}

    def keep(entities: Entities, cube: Cube, frozen: bool) -> None:
        state = entities.simulation.body_state(cube.body)
        if frozen and not cube.frozen:
            velocities[cube.body] = state
        freeze(entities, cube, frozen)
        if not frozen and cube.body in velocities:
            entities.simulation.set_body_state(
                cube.body, replace(state, linear_velocity=velocities.pop(cube.body).linear_velocity)
            )

    patch.setattr(Entities, "freeze", keep)


def _motors(patch: MonkeyPatch, change: Callable[[JointParams], JointParams]) -> None:
    """Has an engine drive joints otherwise than the parameters say."""
    engine_params = joint_params.engine_params
    patch.setattr(joint_params, "engine_params", lambda params: change(engine_params(params)))


@defect("13.34:about-z", "13.35", backend="mujoco")
def motors_backwards(patch: MonkeyPatch) -> None:
    """It turns motors the other way."""
    _motors(patch, lambda params: replace(params, target_velocity=-params.target_velocity))


@defect("13.34:about-z", backend="mujoco")
def motors_in_degrees(patch: MonkeyPatch) -> None:
    """It takes a motor's velocity for one in degrees a second."""
    _motors(patch, lambda params: replace(params, target_velocity=np.deg2rad(params.target_velocity)))


@defect("13.37", backend="mujoco")
def motors_without_limit(patch: MonkeyPatch) -> None:
    """It gives a motor all the force that it wants."""
    _motors(patch, lambda params: replace(params, max_effort=max(params.max_effort, 1e4)))


@defect("13.38:upwards", "13.38:downwards", backend="mujoco")
def joints_without_limits(patch: MonkeyPatch) -> None:
    """It moves joints over their limits."""
    _motors(patch, lambda params: replace(params, limits=None))


@defect("13.39", backend="mujoco")
def servos_that_wander(patch: MonkeyPatch) -> None:
    """It takes a servo to the opposite of where it should."""
    _motors(patch, lambda params: replace(params, target_position=-params.target_position))


@defect("13.33", backend="pymunk")
def joined_cubes_push_each_other(patch: MonkeyPatch) -> None:
    """It lets cubes collide that are joined."""
    patch.setattr(pymunk.Constraint, "collide_bodies", True)


@defect("13.26", backend="mujoco")
def removed_joints_hold(patch: MonkeyPatch) -> None:
    """It tells of a removed joint no more, and lets it hold."""

    def keep(entities: Entities, joint: Joint) -> None:
        with MonkeyPatch.context() as inner:
            inner.setattr(entities.simulation, "remove_joint", lambda number: None)
            cut(entities, joint)

    cut = Entities.cut
    patch.setattr(Entities, "cut", keep)


@defect("13.42", backend="pymunk")
def planes_with_depth(patch: MonkeyPatch) -> None:
    """It tells a depth in a plane."""
    for name in ("cube_state", "cube_info"):
        tell = getattr(readings, name)

        def deep(entities: Entities, cube: Cube, tell: Any = tell) -> JsonObject:
            reading: JsonObject = tell(entities, cube)
            x, y, _ = reading["position"]
            return {**reading, "position": (x, y, 0.25)}

        patch.setattr(readings, name, deep)


@defect("13.43")
def quaternions_that_grow(patch: MonkeyPatch) -> None:
    """It tells quaternions that are not of unit length."""
    state = readings.cube_state

    def long(entities: Entities, cube: Cube) -> JsonObject:
        reading = state(entities, cube)
        return {**reading, "quaternion": tuple(1.1 * x for x in reading["quaternion"])}

    patch.setattr(readings, "cube_state", long)


@defect("13.44")
def nothing_jumps(patch: MonkeyPatch) -> None:
    """It knows no restitution."""

    patch.setattr(entities_module, "BodySpec", lambda **fields: BodySpec(**{**fields, "restitution": 0.0}))


@defect("13.44")
def everything_jumps(patch: MonkeyPatch) -> None:
    """It lets all cubes jump off the ground, whatever they are told to be."""

    patch.setattr(entities_module, "BodySpec", lambda **fields: BodySpec(**{**fields, "restitution": 0.8}))


@defect("13.36", backend="mujoco")
def motors_that_never_stop(patch: MonkeyPatch) -> None:
    """It drives joints whose motors are switched off."""

    def drive(params: JointParams) -> JointParams:
        return replace(params, motor="velocity", max_effort=max(params.max_effort, 100.0))

    _motors(patch, drive)


@defect("13.40", backend="mujoco")
def joints_read_backwards(patch: MonkeyPatch) -> None:
    """It tells a joint's position with the wrong sign."""
    info = readings.joint_info

    def mirror(entities: Entities, joint: Joint) -> JsonObject:
        reading = info(entities, joint)
        return {**reading, "position": -reading["position"]}

    patch.setattr(readings, "joint_info", mirror)


@defect("13.24", "13.25", "13.28", backend="mujoco")
def joints_that_do_not_hold(patch: MonkeyPatch) -> None:
    """It tells of joints, and lets the cubes fly apart."""
    connect = Entities.connect

    def pretend(entities: Entities, *arguments: Any) -> str:
        name = connect(entities, *arguments)
        entities.simulation.remove_joint(entities.joint(name).number)
        return name

    patch.setattr(Entities, "connect", pretend)


@defect("13.22", backend="mujoco")
def nothing_touches(patch: MonkeyPatch) -> None:
    """It tells no contacts."""
    patch.setattr(readings, "contact_list", lambda *arguments: [])


# -- determinism ------------------------------------------------------------------------------------------------------

_chance = itertools.count(1)


@defect("14.3", "14.1:0")
def names_by_chance(patch: MonkeyPatch) -> None:
    """It makes names up that the seed does not determine."""
    patch.setattr(
        Entities, "draw", lambda entities, prefix, count: f"{prefix}_{count}_{next(_chance) * 2654435761 % 2**32:08x}"
    )


@defect("14.3")
def names_without_the_seed(patch: MonkeyPatch) -> None:
    """It makes the same names up whatever the seed."""
    draw = Entities.draw

    def constant(entities: Entities, prefix: str, count: int) -> str:
        seed, entities.seed = entities.seed, 7
        try:
            return draw(entities, prefix, count)
        finally:
            entities.seed = seed

    patch.setattr(Entities, "draw", constant)


@defect("14.1:0", "14.1:1")
def a_little_noise(patch: MonkeyPatch) -> None:
    """It pushes cubes a little, each time otherwise."""
    _pushes(
        patch,
        lambda entities, cube, command: {
            key: [x * (1 + 1e-12 * next(_chance)) for x in value] if key in ("force", "impulse") else value
            for key, value in command.items()
        },
    )


@defect("14.4")
def a_reset_keeps_the_frame(patch: MonkeyPatch) -> None:
    """It goes on counting frames after a reset."""

    def keep(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        frame = world.frame
        reply = answer(world, client, command)
        world.frame = frame
        return reply

    around(patch, "reset", keep)


@defect("14.3", "14.1:0")
def a_reset_keeps_the_names(patch: MonkeyPatch) -> None:
    """It goes on counting names after a reset."""

    def keep(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        spawned = world.entities._spawned
        reply = answer(world, client, command)
        world.entities._spawned = spawned
        return reply

    around(patch, "reset", keep)


@defect("14.6")
def a_reset_ends_subscriptions(patch: MonkeyPatch) -> None:
    """It forgets subscriptions in a reset."""

    def forget(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        for other in world._clients.values():
            other.subscription = None
        return answer(world, client, command)

    around(patch, "reset", forget)


@defect("14.5")
def owners_after_a_reset(patch: MonkeyPatch) -> None:
    """It lets a connection own a cube of before the reset, when there is one of that name again."""

    def keep(answer: Answer, world: World, client: Client, command: JsonObject) -> JsonObject:
        owned = {other.number: other.owned for other in world._clients.values()}
        reply = answer(world, client, command)
        for number, name in owned.items():
            world._clients[number].owned = name
        return reply

    around(patch, "reset", keep)


@defect("14.7")
def looking_changes_it(patch: MonkeyPatch) -> None:
    """It moves a cube a little whenever somebody looks at it."""
    info = readings.cube_info

    def nudge(entities: Entities, cube: Cube) -> JsonObject:
        reading = info(entities, cube)
        state = entities.simulation.body_state(cube.body)
        x, y, z = state.position
        entities.simulation.set_body_state(cube.body, replace(state, position=(x + 1e-9, y, z)))
        return reading

    patch.setattr(readings, "cube_info", nudge)
