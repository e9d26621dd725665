"""The typed face of the protocol: every command as a method.

It hides how a call becomes a message. A command is declared once, in `Commands`: the method's signature lists the
command's fields, and its return type says what the reply holds. Whoever can send messages gets all commands by deriving
from `Commands`: one that blocks, one that is awaited, one that collects. What the fields mean, their units and bounds
stand in the schemas only; a test compares the names here with those there.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import (
    Any,
    Concatenate,
    Generic,
    Literal,
    ParamSpec,
    Protocol,
    Self,
    TypeVar,
    cast,
    overload,
)

from nmes.client.replies import (
    BatchResult,
    BoneCreated,
    CameraImage,
    CreatureSpawned,
    CubeDespawned,
    CubeFrozen,
    CubeInfo,
    CubeList,
    CubeState,
    CubeStateSet,
    Driven,
    JointCreated,
    JointInfo,
    JointList,
    JointParamSet,
    JointRemoved,
    JointType,
    Mode,
    ModeSet,
    ObjectiveSet,
    Paused,
    PhysicsApplied,
    Planets,
    Pong,
    Resumed,
    Reward,
    Senses,
    Stepped,
    Subscribed,
    Unsubscribed,
    WorldInfo,
    WorldReset,
    WorldState,
)
from nmes.errors import CommandFailed

__all__ = ["AsyncCommands", "BlockingCommands", "Commands", "Pending", "Pipeline"]

P = ParamSpec("P")
R = TypeVar("R")


class Array(Protocol):
    """What numpy's arrays and scalars have in common."""

    def tolist(self) -> Any:
        """Returns the plain numbers."""


Vector = Sequence[float] | Array


class Pending(Generic[R]):
    """A command that was sent, and its reply once it has come."""

    def __init__(self, message: dict[str, Any]) -> None:
        self.message = message
        self._reply: dict[str, Any] | None = None
        self._error: Exception | None = None
        self._tell: Callable[[], None] | None = None

    @property
    def done(self) -> bool:
        """Whether the reply has come, or can come no more."""
        return self._reply is not None or self._error is not None

    def result(self) -> R:
        """Returns the reply.

        Raises:
            CommandFailed: The server refused the command.
            Disconnected: The connection was lost before the reply came.
        """
        if self._error is not None:
            raise self._error
        if self._reply is None:
            raise RuntimeError(f"the reply to {self.message.get('type')!r} has not come yet")
        return cast(R, self._reply)

    def settle(self, reply: dict[str, Any]) -> None:
        """Takes the server's reply."""
        if reply.get("type") == "error":
            self.fail(CommandFailed(str(reply.get("code")), str(reply.get("message")), reply.get("field")))
        else:
            self._reply = reply
            if self._tell is not None:
                self._tell()

    def fail(self, error: Exception) -> None:
        """Gives up the reply."""
        self._error = error
        if self._tell is not None:
            self._tell()

    def when_done(self, tell: Callable[[], None]) -> None:
        """Has `tell` called once the reply has come, or can come no more."""
        self._tell = tell
        if self.done:
            tell()


class command(Generic[P, R]):
    """Declares a command: the function's name is its type, the parameters its fields, the return type its reply."""

    def __init__(self, declaration: Callable[Concatenate[Any, P], type[R]]) -> None:
        self._declaration = declaration
        self._type = declaration.__name__
        code = declaration.__code__
        self._positional = code.co_varnames[1 : code.co_argcount]
        self.__doc__ = declaration.__doc__
        self.__wrapped__ = declaration

    @overload
    def __get__(self, client: None, owner: type) -> Self: ...
    @overload
    def __get__(self, client: BlockingCommands, owner: type) -> Callable[P, R]: ...
    @overload
    def __get__(self, client: AsyncCommands, owner: type) -> Callable[P, Coroutine[Any, Any, R]]: ...
    @overload
    def __get__(self, client: Pipeline, owner: type) -> Callable[P, Pending[R]]: ...
    def __get__(self, client: BlockingCommands | AsyncCommands | Pipeline | None, owner: type) -> object:
        if client is None:
            return self

        @functools.wraps(self._declaration)
        def send(*args: P.args, **kwargs: P.kwargs) -> object:
            self._declaration(client, *args, **kwargs)  # says what is wrong with the arguments, as any function would
            message: dict[str, Any] = {"type": self._type}
            for name, value in (*zip(self._positional, args, strict=False), *kwargs.items()):
                if value is not None:
                    message[name] = value.tolist() if hasattr(value, "tolist") else value  # numpy's arrays and scalars
            return client.request(message)

        return send


class Commands:
    """Every command of the protocol, as methods. Optional fields that are None are left to the server's default."""

    @command
    def spawn_cube(
        self,
        cube_name: str | None = None,
        *,
        position: Vector | None = None,
        rotation: Vector | None = None,
        size: float | Vector | None = None,
        mass: float | None = None,
        friction: float | None = None,
        restitution: float | None = None,
        color: Vector | None = None,
        is_base: bool | None = None,
        linear_velocity: Vector | None = None,
        angular_velocity: Vector | None = None,
        list: bool | None = None,
    ) -> type[CubeList]:
        """Spawns a cube; the reply's `spawned` is its name. `list=False` spares the names of all the others."""
        return CubeList

    @command
    def despawn_cube(self, cube_name: str) -> type[CubeDespawned]:
        """Removes a cube and the joints that it carries."""
        return CubeDespawned

    @command
    def create_joint(
        self,
        cube1: str,
        cube2: str,
        joint_type: JointType,
        *,
        position: Vector | None = None,
        axis: Vector | None = None,
        limits: Vector | None = None,
        motor_target_velocity: float | None = None,
        motor_max_impulse: float | None = None,
        motor_max_force: float | None = None,
        motor_enabled: bool | None = None,
        target_position: float | None = None,
        stiffness: float | None = None,
        damping: float | None = None,
        limit_lower: float | None = None,
        limit_upper: float | None = None,
        limit_enabled: bool | None = None,
    ) -> type[JointCreated]:
        """Joins two cubes, at a world anchor and about (or along) a world axis."""
        return JointCreated

    @command
    def create_bone(self, cube1: str, cube2: str, *, snake_id: str | None = None) -> type[BoneCreated]:
        """Joins two cubes by a cone-twist joint that belongs to the skeleton `snake_id`."""
        return BoneCreated

    @command
    def remove_joint(self, joint_name: str) -> type[JointRemoved]:
        """Cuts a joint."""
        return JointRemoved

    @command
    def set_joint_param(self, joint_name: str, param_name: str, value: float | bool) -> type[JointParamSet]:
        """Sets one parameter of a joint: motor, servo, spring or limits."""
        return JointParamSet

    @command
    def get_joint_list(self) -> type[JointList]:
        """Lists the joints, in order of creation."""
        return JointList

    @command
    def get_joint_info(self, joint_name: str) -> type[JointInfo]:
        """Reads a joint: where it is, how it moves, what its motor does."""
        return JointInfo

    @command
    def apply_physics(
        self,
        cube_name: str | None = None,
        *,
        force: Vector | None = None,
        torque: Vector | None = None,
        impulse: Vector | None = None,
        angular_impulse: Vector | None = None,
        at: Vector | None = None,
    ) -> type[PhysicsApplied]:
        """Acts on a cube during the next tick (N, N m) or at its beginning (N s, N m s)."""
        return PhysicsApplied

    @command
    def apply_force(
        self, cube_name: str | None = None, *, force: Vector, at: Vector | None = None
    ) -> type[PhysicsApplied]:
        """Pushes a cube with a force (N) during the next tick."""
        return PhysicsApplied

    @command
    def set_cube_state(
        self,
        cube_name: str,
        *,
        position: Vector | None = None,
        rotation: Vector | None = None,
        linear_velocity: Vector | None = None,
        angular_velocity: Vector | None = None,
    ) -> type[CubeStateSet]:
        """Puts a cube, with all that is jointed to it, somewhere."""
        return CubeStateSet

    @command
    def freeze_cube(self, cube_name: str, freeze: bool) -> type[CubeFrozen]:
        """Makes a cube immovable, or movable again."""
        return CubeFrozen

    @command
    def get_cube_list(self) -> type[CubeList]:
        """Lists the cubes, in order of creation."""
        return CubeList

    @command
    def get_cube_info(
        self,
        cube_name: str,
        *,
        sensors: bool | None = None,
        rays: Sequence[Vector] | Array | None = None,
        max_range: float | None = None,
    ) -> type[CubeInfo]:
        """Reads all about a cube: motion, shape, surface, joints, contacts; its inertial sensors and range finder."""
        return CubeInfo

    @command
    def get_camera(
        self,
        cube_name: str | None = None,
        *,
        width: int | None = None,
        height: int | None = None,
        fov: float | None = None,
        position: Vector | None = None,
        rotation: Vector | None = None,
    ) -> type[CameraImage]:
        """Takes a picture from a cube, a PNG in base64."""
        return CameraImage

    @command
    def get_cube_state(self, cube_name: str | None = None) -> type[CubeState]:
        """Reads where a cube is and how it moves."""
        return CubeState

    @command
    def spawn_creature(
        self,
        genome: Mapping[str, Any],
        *,
        position: Vector | None = None,
        name: str | None = None,
        target: Vector | str | None = None,
    ) -> type[CreatureSpawned]:
        """Makes the body of a genome (its document) live; its brain stays outside.

        Sensors of a target are about `target`: a point, or the name of a cube.
        """
        return CreatureSpawned

    @command
    def drive(self, creature: str, controls: Vector) -> type[Driven]:
        """Sets what a creature's motors aim at: one number from -1 to 1 a motor, in their order."""
        return Driven

    @command
    def sense(self, creature: str) -> type[Senses]:
        """Reads a creature's sensors, in their order."""
        return Senses

    @command
    def get_world_state(self, *, cubes: Sequence[str] | None = None, sensors: bool | None = None) -> type[WorldState]:
        """Reads the motion of all cubes, or of those named, at one frame; with `sensors`, what they feel too."""
        return WorldState

    @command
    def get_world_info(self) -> type[WorldInfo]:
        """Reads what the world is: engine, versions, seed, config, mode, counts, limits, capabilities."""
        return WorldInfo

    @command
    def get_planets(self) -> type[Planets]:
        """Lists the planets; there are none unless the scene has them."""
        return Planets

    @command
    def reset(self, *, seed: int | None = None) -> type[WorldReset]:
        """Puts the world back to its beginning."""
        return WorldReset

    @command
    def step(self, ticks: int | None = None) -> type[Stepped]:
        """Advances a world that is in lockstep, or paused."""
        return Stepped

    @command
    def pause(self) -> type[Paused]:
        """Stops the world's clock."""
        return Paused

    @command
    def resume(self) -> type[Resumed]:
        """Lets the world's clock go on."""
        return Resumed

    @command
    def set_mode(
        self,
        mode: Mode,
        *,
        rate: float | None = None,
        barrier: bool | None = None,
        agents: int | None = None,
        timeout: float | None = None,
    ) -> type[ModeSet]:
        """Chooses what makes the world tick; `rate` is how many times faster than real time `realtime` runs."""
        return ModeSet

    @command
    def subscribe(
        self,
        *,
        events: Sequence[Literal["tick", "state"]] | None = None,
        every: int | None = None,
        position_threshold: float | None = None,
        rotation_threshold: float | None = None,
    ) -> type[Subscribed]:
        """Asks for events; see `Client.events`."""
        return Subscribed

    @command
    def unsubscribe(self) -> type[Unsubscribed]:
        """Asks for events no more."""
        return Unsubscribed

    @command
    def set_objective(
        self,
        expression: str,
        *,
        name: str | None = None,
        cubes: Sequence[str] | None = None,
        creature: str | None = None,
        target: Vector | None = None,
    ) -> type[ObjectiveSet]:
        """Sets an objective: an expression over what cubes do from now on (docs/objectives.md)."""
        return ObjectiveSet

    @command
    def compute_reward(
        self,
        *,
        objective: str | None = None,
        metric: Literal["distance", "displacement", "height", "speed", "uprightness", "energy"] | None = None,
        cube: str | None = None,
        target: Vector | None = None,
        axis: Vector | None = None,
    ) -> type[Reward]:
        """Asks what an objective is worth now, or a metric of a cube."""
        return Reward

    @command
    def batch(self, commands: Sequence[Mapping[str, Any]]) -> type[BatchResult]:
        """Has commands (as dicts) executed with nothing in between; the results may be errors."""
        return BatchResult

    @command
    def ping(self) -> type[Pong]:
        """Asks for a sign of life, and keeps the connection open."""
        return Pong


class BlockingCommands(Commands):
    """Commands whose methods return the reply."""

    def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command given as a dict, and returns its reply."""
        raise NotImplementedError


class AsyncCommands(Commands):
    """Commands whose methods return an awaitable of the reply."""

    async def request(self, message: Mapping[str, Any]) -> Any:
        """Sends a command given as a dict, and returns its reply."""
        raise NotImplementedError


class Pipeline(Commands):
    """Commands that are sent together, in one write, when the block of `Client.pipeline` ends.

    Its methods return a `Pending`, whose `result` is there from then on.
    """

    def __init__(self) -> None:
        self.calls: list[Pending[Any]] = []

    def request(self, message: Mapping[str, Any]) -> Pending[Any]:
        """Adds a command given as a dict."""
        pending: Pending[Any] = Pending(dict(message))
        self.calls.append(pending)
        return pending
