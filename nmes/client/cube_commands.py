"""Commands about cubes: their making, their motion, the forces on them, their sensors.

The docstrings of the methods are written by `make format` from the schemas (tools/client_docs.py).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from nmes.client.declaration import Array, Vector, command
from nmes.client.replies import (
    CameraImage,
    ColorSet,
    CubeDespawned,
    CubeFrozen,
    CubeInfo,
    CubeList,
    CubeState,
    CubeStateSet,
    Given,
    PhysicsApplied,
)

__all__ = ["CubeCommands"]


class CubeCommands:
    """Commands about cubes."""

    @command
    def spawn_cube(
        self,
        cube_name: str | None = None,
        *,
        position: Vector | None = None,
        rotation: Vector | None = None,
        size: float | Vector | None = None,
        shape: Literal["box", "sphere", "capsule", "cylinder"] | None = None,
        mass: float | None = None,
        friction: float | None = None,
        restitution: float | None = None,
        color: Vector | None = None,
        group: str | None = None,
        is_base: bool | None = None,
        linear_velocity: Vector | None = None,
        angular_velocity: Vector | None = None,
        list: bool | None = None,
    ) -> type[CubeList]:
        """Spawns a cube.

        The connection owns the cube that it spawned last.

        Args:
            cube_name: Name of the cube; the world makes one up if left out. `_BASE` is appended with is_base.
            position: Where its centre is, in m, each within 1,000,000 m of the origin. Default: [0, 1, 0].
            rotation: 3 Euler angles in rad, applied in the order Y, X, Z, or a quaternion [x, y, z, w], which need not
                be normalised but not all of it may be nearer to 0 than 0.000001. Each number is from -1,000 to 1,000.
                Default: [0, 0, 0].
            size: The edge of a cube, or the 3 edges of a box (x, y, z), in m, from 0.001 to 1,000. Default: 1.
            shape: What fills the box that `size` says: all of it (box), or a sphere, which has three equal edges, or a
                capsule or a cylinder, which has two and lies along the third (along y where all three are equal; a
                capsule is longer than it is wide). Default: 'box'.
            mass: Mass in kg, from 0.000001 to 1,000,000,000. Default: 1.
            friction: Coefficient of sliding friction, from 0 to 10; the world's (config) if left out.
            restitution: Coefficient of restitution, from 0 to 1; the world's (config) if left out.
            color: Colour as red, green, blue and, if given, opacity, each from 0 to 1. It has no effect on the physics.
                Default: [0.8, 0.8, 0.8, 1].
            group: Its collision group, one of the world's (config): with whom it collides. If left out it meets
                everything.
            is_base: Whether it starts frozen, `_BASE` appended to its name. Default: False.
            linear_velocity: Velocity of the centre of mass, in m/s, each number from -100,000 to 100,000. Default:
                [0, 0, 0].
            angular_velocity: Angular velocity in world axes, in rad/s, each number from -100,000 to 100,000. Default:
                [0, 0, 0].
            list: Whether the reply lists all cubes of the world. The default is false inside a batch. Default: True.

        Returns:
            CubeList: The cube that was spawned, the cubes of the world, or both.

        Raises:
            CommandFailed: The server refused it: `cube_exists`, `invalid`, `limit_reached`, `not_allowed` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CubeList

    @command
    def despawn_cube(self, cube_name: str) -> type[CubeDespawned]:
        """Removes a cube and the joints that hold it.

        Args:
            cube_name: The cube.

        Returns:
            CubeDespawned: The cube is gone.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CubeDespawned

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
        """Adds to what acts on a cube during the next tick, and then no more.

        It takes at least one of force, torque, impulse and angular_impulse. A frozen cube ignores it.

        Args:
            cube_name: The cube; the one that this connection spawned last if left out.
            force: Force throughout the tick, world axes, in N, each number from -1e15 to 1e15.
            torque: Torque throughout the tick, world axes, in N m, each number from -1e15 to 1e15.
            impulse: Impulse at the tick's start, world axes, in N s, each number from -1e15 to 1e15.
            angular_impulse: Angular impulse at the tick's start, world axes, in N m s, each number from -1e15 to 1e15.
            at: Point of the world at which force and impulse act, in m, each number within 1,000,000 m of the origin;
                the centre of mass if left out.

        Returns:
            PhysicsApplied: What was asked will act in the next tick.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `nothing_owned` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return PhysicsApplied

    @command
    def apply_force(
        self, cube_name: str | None = None, *, force: Vector, at: Vector | None = None
    ) -> type[PhysicsApplied]:
        """Adds a force to what acts on a cube during the next tick.

        Args:
            cube_name: The cube; the one that this connection spawned last if left out.
            force: A force in world axes, in N, each number from -1e15 to 1e15.
            at: Point of the world at which the force acts, in m, each number within 1,000,000 m of the origin; the
                centre of mass if left out.

        Returns:
            PhysicsApplied: What was asked will act in the next tick.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `nothing_owned`,
                `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
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
        """Puts a cube somewhere.

        The cubes that are joined to it move with it, as a rigid whole; what is left out stays as it is.

        Args:
            cube_name: The cube.
            position: A point of the world: x, y (up), z, in m, each within 1,000,000 m of the origin.
            rotation: 3 Euler angles in rad, applied in the order Y, X, Z, or a quaternion [x, y, z, w], which need not
                be normalised but not all of it may be nearer to 0 than 0.000001. Each number is from -1,000 to 1,000.
            linear_velocity: Velocity of the centre of mass, in m/s, each number from -100,000 to 100,000.
            angular_velocity: Angular velocity in world axes, in rad/s, each number from -100,000 to 100,000.

        Returns:
            CubeStateSet: The cube is where it was to be, or on top of the ground there.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CubeStateSet

    @command
    def set_color(self, cube_name: str, color: Vector) -> type[ColorSet]:
        """Gives a cube another colour, which has no effect on the physics.

        Args:
            cube_name: The cube.
            color: Colour as red, green, blue and, if given, opacity, each from 0 to 1. It has no effect on the physics.

        Returns:
            ColorSet: A cube has another colour.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return ColorSet

    @command
    def freeze_cube(self, cube_name: str, freeze: bool) -> type[CubeFrozen]:
        """Makes a cube immovable, or movable again with no velocity.

        Args:
            cube_name: The cube.
            freeze: Whether it is immovable from now on.

        Returns:
            CubeFrozen: The cube is frozen, or free.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CubeFrozen

    @command
    def give(self, player: int, *, cube_name: str | None = None, creature: str | None = None) -> type[Given]:
        """Makes a cube or a creature, with all that joints connect to it, belong to another player.

        Args:
            player: The number of the player, as auth_success tells him, from 1 to 9,007,199,254,740,991.
            cube_name: The cube. Either this or creature.
            creature: The creature. Either this or cube_name.

        Returns:
            Given: The cubes belong to that player.

        Raises:
            CommandFailed: The server refused it: `creature_not_found`, `cube_not_found`, `invalid`, `not_allowed`,
                `player_not_found`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return Given

    @command
    def get_cube_list(self) -> type[CubeList]:
        """Lists the cubes of the world, in order of creation.

        Returns:
            CubeList: The cube that was spawned, the cubes of the world, or both.

        Raises:
            CommandFailed: The server refused it: `not_allowed` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
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
        """Reads all about one cube.

        Args:
            cube_name: The cube.
            sensors: Whether to read the accelerometer and the gyro too. Default: False.
            rays: Directions in the cube's own frame in which to measure distances, from its centre. Their lengths do
                not matter, but each of their numbers is from -1,000 to 1,000, and one at least 0.000001 in size.
            max_range: How far the range finder reaches, in m, from 0.001 to 1,000,000. Default: 100.

        Returns:
            CubeInfo: All about a cube.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CubeInfo

    @command
    def get_cube_state(self, cube_name: str | None = None) -> type[CubeState]:
        """Reads the moving part of one cube's state.

        Args:
            cube_name: The cube; the one that this connection spawned last if left out.

        Returns:
            CubeState: The moving part of a cube's state.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `nothing_owned`,
                `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CubeState

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
        """Takes a picture from a camera that sits on a cube.

        Cubes and scenery are where they were after the last tick.

        Args:
            cube_name: The cube; the one that this connection spawned last if left out.
            width: Pixels in a row, from 1 to 1,024. Default: 320.
            height: Rows of pixels, from 1 to 1,024. Default: 240.
            fov: Vertical field of view, in rad, from 0.01 to 3. Default: 1.
            position: Where on the cube, in its own frame, in m, each number from -1,000,000 to 1,000,000. From within a
                cube one sees out, not its faces. Default: [0, 0, 0].
            rotation: How the camera is turned in the cube's own frame: 3 Euler angles in rad, or a quaternion, each
                number from -1,000 to 1,000 and not all of a quaternion nearer to 0 than 0.000001. Unturned it looks
                along the cube's -z, with +y upwards. Default: [0, 0, 0].

        Returns:
            CameraImage: What a camera on a cube sees. The pixels may differ from machine to machine, so a replay does
                not compare them.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `nothing_owned`,
                `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CameraImage
