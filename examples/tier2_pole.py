"""Swings a pole of four cubes on a frozen base: hinges with motors, steered by the joints' own angles.

Each motor is told a velocity, in proportion to how far its joint is from where a slow sine wants it. The joints bend
the same way together, so that the tip swings from side to side.
"""

from __future__ import annotations

from math import pi, sin

from common import Connect, Figure, main

EDGE = 0.4  # m
SPACING = 0.5  # m: the hinges sit in the gaps
BEND = 0.2  # rad, of each joint at most
PERIOD = 120  # ticks
TICKS = 3 * PERIOD
GAIN = 8.0  # rad/s of motor for each rad of error


def measure(connect: Connect) -> list[Figure]:
    """Runs the example; each call of `connect` is a new connection to the world."""
    with connect() as client:
        client.set_mode("lockstep")
        client.reset()
        base = client.spawn_cube("pole", position=[0, EDGE / 2, 0], size=EDGE, is_base=True)["spawned"]
        below, joints = base, []
        for i in range(1, 5):
            y = EDGE / 2 + i * SPACING
            cube = client.spawn_cube(f"pole_{i}", position=[0, y, 0], size=EDGE, mass=0.5)["spawned"]
            hinge = client.create_joint(
                below, cube, "hinge", position=[0, y - SPACING / 2, 0], axis=[0, 0, 1], motor_max_force=200.0
            )
            joints.append(hinge["joint_name"])
            below = cube
        upright = client.get_cube_state(below)["position"][1]
        left = right = 0.0
        lowest = upright
        angles = [0.0] * len(joints)
        for tick in range(TICKS):
            target = BEND * sin(2 * pi * tick / PERIOD)
            with client.pipeline() as together:
                for joint, angle in zip(joints, angles, strict=True):
                    together.set_joint_param(joint, "motor_target_velocity", GAIN * (target - angle))
                together.step()
                readings = [together.get_joint_info(joint) for joint in joints]
                tip = together.get_cube_state(below)
            angles = [reading.result()["position"] for reading in readings]
            x, y, _ = tip.result()["position"]
            left, right, lowest = min(left, x), max(right, x), min(lowest, y)
        still = client.get_cube_state(base)["position"]
    return [
        Figure("swing to the left", -left, "m", at_least=0.5),
        Figure("swing to the right", right, "m", at_least=0.5),
        Figure("lowest tip, of upright", lowest / upright, "", at_least=0.6),
        Figure("base moved by", max(abs(still[0]), abs(still[1] - EDGE / 2), abs(still[2])), "m", at_most=1e-9),
    ]


if __name__ == "__main__":
    main(measure, __doc__)
