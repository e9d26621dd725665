"""A body that a search found: it lives of the momentum that coarse steps of the engine make of nothing."""

from __future__ import annotations

from typing import Any

from nmes.genome import Genome

__all__ = ["lead_shaker"]

Json = dict[str, Any]


def lead_shaker() -> Genome:
    """Returns lumps of up to 12 t/m^3 in a chain, which shake 8 and 16 times a second."""
    lumps = [
        (0.128, 15.6642, [0, 3, 0]),
        (0.1036, 13.75352, [-0.1542, 3.2593, 0.296]),
        (0.0976, 10.15924, [-0.5272, 3.109, 0.6432]),
        (0.1228, 1.14734, [-0.898, 2.7327, 0.2788]),
        (0.2404, 0.91031, [-1.0577, 3.0056, 0.4797]),
        (0.0771, 2.33414, [-0.7673, 3.2065, 0.2165]),
    ]
    hinges = [  # anchor, axis, how far it swings, effort, frequency, phase, offset
        ([-0.028, 3.0471, 0.0538], [0.49859, -0.4751, 0.72505], 2.8718, 382.5885, 7.9428, 1.2272, -0.2844),
        ([-0.1978, 3.2417, 0.3366], [0.29477, 0.70338, 0.64681], 0.078, 10.6423, 7.9428, -1.3235, 0.4134),
        ([-0.5611, 3.0746, 0.61], [0.53216, -0.67697, -0.50845], 2.968, 15.7465, 15.8856, 2.6904, -0.2108),
        ([-0.9294, 2.7864, 0.3183], [0.25535, -0.11401, 0.9601], 0.1459, 18.677, 7.9428, 0.1696, 0.1464),
        ([-0.9626, 3.0714, 0.3935], [0.59829, 0.6531, 0.46423], 2.2445, 17.3365, 15.8856, -0.9802, -0.1777),
    ]
    cubes = [
        {"id": f"c{at}", "size": size, "mass": mass, "position": where} for at, (size, mass, where) in enumerate(lumps)
    ]
    joints: list[Json] = []
    waves: list[Json] = []
    for at, (anchor, axis, swing, effort, frequency, phase, offset) in enumerate(hinges):
        motor = {"mode": "position", "range": [-swing, swing], "max_effort": effort}
        ends = {"cube1": f"c{at}", "cube2": f"c{at + 1}", "type": "hinge", "anchor": anchor, "axis": axis}
        joints.append({"id": f"j{at}", **ends, "motor": motor})
        waves.append({"motor": f"j{at}", "amplitude": 1, "frequency": frequency, "phase": phase, "offset": offset})
    brain = {"kind": "sine", "oscillators": waves}
    body = {"cubes": cubes, "joints": joints}
    return Genome({"format": "nmes-genome/1", "name": "shaker", "body": body, "brain": brain})
