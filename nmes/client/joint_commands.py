"""Commands about joints: their making, their parameters, their readings.

The docstrings of the methods are written by `make format` from the schemas (tools/client_docs.py).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from nmes.client.declaration import Vector, command
from nmes.client.replies import (
    BoneCreated,
    CubesLinked,
    JointCreated,
    JointInfo,
    JointList,
    JointParamSet,
    JointParamsSet,
    JointRemoved,
    JointsForCube,
    JointType,
)

__all__ = ["JointCommands"]


JointParams = Mapping[str, float | bool]


class JointCommands:
    """Commands about joints."""

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
        joint_name: str | None = None,
        number_if_taken: bool | None = None,
        joint_params: JointParams | None = None,
        notes: Mapping[str, float] | None = None,
    ) -> type[JointCreated]:
        """Joins two cubes as they stand; their relative pose becomes the joint's zero.

        Jointed cubes do not collide with each other.

        Args:
            cube1: The first cube.
            cube2: The second cube: a position is its motion relative to the first.
            joint_type: What the joint leaves free: nothing (fixed), a turn about the axis (hinge), a shift along it
                (slide; slider is another word for it), every rotation (pin), or rotation within a cone (conetwist).
            position: The anchor, a point of the world in m, each number within 1,000,000 m of the origin; the midpoint
                of the two cubes if left out.
            axis: The axis, a direction of the world of any length, each number from -1,000 to 1,000 and one at least
                0.000001 in size; z for a hinge and x for a slide if left out.
            limits: Lowest and highest position, in rad (m for a slide), each from -1,000,000 to 1,000,000: limit_lower
                and limit_upper in one, enabled. Of a conetwist: the largest swing of its axis and the largest twist
                about it.
            motor_target_velocity: Velocity that the motor aims at, in rad/s (m/s for a slide), from -100,000 to
                100,000. Setting it enables the motor.
            motor_max_impulse: What the motor may give in one engine step, in N m s (N s for a slide), from 0 to 1e15.
            motor_max_force: The most that the motor may give, in N m (N for a slide), from 0 to 1e15.
            motor_enabled: Whether the motor acts.
            target_position: Position that the servo aims at, in rad (m for a slide), from -1,000,000 to 1,000,000.
            stiffness: Stiffness of the servo or spring, in N m/rad (N/m for a slide), from 0 to 1e15.
            damping: Damping of the joint, in N m s/rad (N s/m for a slide), from 0 to 1e15.
            limit_lower: Lowest position that the joint may take, in rad (m for a slide), from -1,000,000 to 1,000,000.
                Of a conetwist: the largest swing.
            limit_upper: Highest position that the joint may take, in rad (m for a slide), from -1,000,000 to 1,000,000.
                Of a conetwist: the largest twist.
            limit_enabled: Whether the limits hold.
            joint_name: What to call the joint: a name that no joint has. If left out, a name is drawn.
            number_if_taken: Whether, where a joint has that name, a number is put behind it (hip_2, hip_3) instead of
                refusing. Default: False.
            joint_params: Parameters of the joint by their names: the same as the fields of create_joint, which they
                override.
            notes: Numbers by name to keep with the joint. They have no effect; get_joint_info tells them.

        Returns:
            JointCreated: The joint is there.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `joint_exists`, `limit_reached`,
                `not_allowed`, `self_joint`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return JointCreated

    @command
    def create_bone(
        self,
        cube1: str,
        cube2: str,
        *,
        snake_id: str | None = None,
        joint_name: str | None = None,
        number_if_taken: bool | None = None,
        joint_params: JointParams | None = None,
        notes: Mapping[str, float] | None = None,
    ) -> type[BoneCreated]:
        """Joins two cubes by a conetwist joint that belongs to a named skeleton.

        Args:
            cube1: The first cube.
            cube2: The second cube.
            snake_id: The skeleton: a name, or a whole number from 0 to 9,007,199,254,740,991; "skeleton" if left out.
                Default: 'skeleton'.
            joint_name: What to call the bone: a name that no joint has. If left out, a name is drawn.
            number_if_taken: Whether, where a joint has that name, a number is put behind it (hip_2, hip_3) instead of
                refusing. Default: False.
            joint_params: Parameters of the joint by their names: the same as the fields of create_joint, which they
                override.
            notes: Numbers by name to keep with the joint. They have no effect; get_joint_info tells them.

        Returns:
            BoneCreated: The bone is there.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `joint_exists`, `limit_reached`,
                `not_allowed`, `self_joint`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return BoneCreated

    @command
    def remove_joint(self, joint_name: str) -> type[JointRemoved]:
        """Removes a joint; the cubes keep their motion.

        Args:
            joint_name: The joint.

        Returns:
            JointRemoved: The joint is gone.

        Raises:
            CommandFailed: The server refused it: `invalid`, `joint_not_found`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return JointRemoved

    @command
    def set_joint_param(self, joint_name: str, param_name: str, value: float | bool) -> type[JointParamSet]:
        """Sets one parameter of a joint.

        Args:
            joint_name: The joint.
            param_name: The parameter; what each means, its unit and its bounds stand at create_joint. One of
                'motor_target_velocity', 'motor_max_impulse', 'motor_max_force', 'motor_enabled', 'target_position',
                'stiffness', 'damping', 'limit_lower', 'limit_upper', 'limit_enabled'.
            value: The value, in the parameter's unit and bounds: at most 100,000 in size for motor_target_velocity, at
                most 1,000,000 in size for target_position and the limits, from 0 to 1e15 for the others, and true or
                false for motor_enabled and limit_enabled.

        Returns:
            JointParamSet: The parameter is set.

        Raises:
            CommandFailed: The server refused it: `invalid`, `joint_not_found`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return JointParamSet

    @command
    def get_joint_list(self) -> type[JointList]:
        """Lists the joints of the world, in order of creation.

        Returns:
            JointList: The joints of the world.

        Raises:
            CommandFailed: The server refused it: `not_allowed`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return JointList

    @command
    def get_joint_info(self, joint_name: str) -> type[JointInfo]:
        """Reads one joint.

        Args:
            joint_name: The joint.

        Returns:
            JointInfo: One joint's reading.

        Raises:
            CommandFailed: The server refused it: `invalid`, `joint_not_found`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return JointInfo

    @command
    def set_joint_params(
        self, joint_name: str, params: JointParams, *, notes: Mapping[str, float] | None = None
    ) -> type[JointParamsSet]:
        """Sets several parameters of a joint, all of them or none.

        Args:
            joint_name: The joint.
            params: The parameters by their names, as create_joint has them. They act in the order in which create_joint
                lists them.
            notes: Numbers by name to keep with the joint, beside those that it has, at most 32 in all. They have no
                effect; get_joint_info tells them.

        Returns:
            JointParamsSet: Parameters of a joint were set.

        Raises:
            CommandFailed: The server refused it: `invalid`, `joint_not_found`, `limit_reached`, `not_allowed`,
                `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return JointParamsSet

    @command
    def get_joints_for_cube(self, cube_name: str) -> type[JointsForCube]:
        """Lists the joints of a cube.

        Args:
            cube_name: The cube.

        Returns:
            JointsForCube: The joints of a cube.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `not_allowed`, `unsupported` or
                `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return JointsForCube

    @command
    def link_cube_chains(
        self,
        chains: Sequence[Sequence[str]],
        *,
        joint_type: JointType | None = None,
        joint_params: JointParams | None = None,
        notes: Mapping[str, float] | None = None,
    ) -> type[CubesLinked]:
        """Joins neighbours in chains of cubes, as they stand: all of them or none, at most 1,000.

        A joint is called `joint_<type>_<cube1>_<cube2>`, with a number behind it where that name is taken; where it is
        over 120 characters long, its name is drawn.

        Args:
            chains: The chains: arrays of the names of 2 to 1,001 cubes.
            joint_type: What the joints leave free, as at create_joint; nothing (fixed) if left out. One of 'fixed',
                'hinge', 'slide', 'slider', 'pin', 'conetwist'. Default: 'fixed'.
            joint_params: Parameters of the joint by their names: the same as the fields of create_joint, which they
                override.
            notes: Numbers by name to keep with the joint. They have no effect; get_joint_info tells them.

        Returns:
            CubesLinked: Cubes were joined.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `limit_reached`, `not_allowed`,
                `self_joint`, `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CubesLinked

    @command
    def link_body_cubes(
        self,
        prefix: str,
        *,
        gap: float | None = None,
        joint_type: JointType | None = None,
        joint_params: JointParams | None = None,
        notes: Mapping[str, float] | None = None,
    ) -> type[CubesLinked]:
        """Joins those of the cubes with some prefix that touch or nearly touch with a face.

        Cubes that a joint joins already are left as they are. All of them are joined or none, with at most 1,000 joints
        between 1,000 cubes. The joints are called as by link_cube_chains.

        Args:
            prefix: What the names of the cubes begin with.
            gap: How far apart their faces may be, in m, from 0 to 1,000. Default: 0.15.
            joint_type: What the joints leave free, as at create_joint; nothing (fixed) if left out. One of 'fixed',
                'hinge', 'slide', 'slider', 'pin', 'conetwist'. Default: 'fixed'.
            joint_params: Parameters of the joint by their names: the same as the fields of create_joint, which they
                override.
            notes: Numbers by name to keep with the joint. They have no effect; get_joint_info tells them.

        Returns:
            CubesLinked: Cubes were joined.

        Raises:
            CommandFailed: The server refused it: `cube_not_found`, `invalid`, `limit_reached`, `not_allowed`,
                `unsupported` or `world_faulted`.
            Disconnected: The connection was lost.
            TimeoutError: No reply came in time.
        """
        return CubesLinked
