"""Bodies that a search found: they live of the momentum that steps of an engine make of nothing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from nmes.genome import Genome

__all__ = ["lead_shaker", "shaker"]

Json = dict[str, Any]


def shaker() -> Genome:
    """Returns lumps of up to 2.5 t/m^3 in a chain, which shake 9 and 18 times a second."""
    lumps = [
        (0.1687, 11.1508, [0, 3, 0]),
        (0.0571, 0.46077, [-0.1412, 3.1469, 0.1439]),
        (0.201, 0.58839, [-0.4665, 3.4853, 0.0927]),
        (0.2998, 9.64382, [-0.1198, 3.6757, 0.4621]),
        (0.1975, 0.58182, [0.2665, 3.9797, 0.7162]),
        (0.0672, 0.69597, [0.0592, 3.8371, 0.9011]),
    ]
    hinges = [
        ([-0.0573, 3.0596, 0.0584], [0.18407, 0.81856, -0.54413], 2.9984, 277.4613, 9.1406, -3.1443, 0.4784),
        ([-0.1648, 3.1714, 0.1402], [-0.51006, -0.61366, -0.60272], 2.9849, 295.3005, 9.1406, -2.7478, -0.4998),
        ([-0.3893, 3.5277, 0.175], [0.58969, 0.3082, 0.74651], 0.3185, 5.9373, 18.2812, -2.9996, -0.4191),
        ([0.0058, 3.7746, 0.5447], [0.60361, 0.59705, -0.52838], 2.5881, 77.1856, 9.1406, -3.1526, -0.0198),
        ([0.1878, 3.9256, 0.7864], [-0.59408, 0.52807, 0.60681], 2.3999, 31.9816, 18.2812, 2.4461, -0.4626),
    ]
    return _chain(lumps, hinges)


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
    hinges = [
        ([-0.028, 3.0471, 0.0538], [0.49859, -0.4751, 0.72505], 2.8718, 382.5885, 7.9428, 1.2272, -0.2844),
        ([-0.1978, 3.2417, 0.3366], [0.29477, 0.70338, 0.64681], 0.078, 10.6423, 7.9428, -1.3235, 0.4134),
        ([-0.5611, 3.0746, 0.61], [0.53216, -0.67697, -0.50845], 2.968, 15.7465, 15.8856, 2.6904, -0.2108),
        ([-0.9294, 2.7864, 0.3183], [0.25535, -0.11401, 0.9601], 0.1459, 18.677, 7.9428, 0.1696, 0.1464),
        ([-0.9626, 3.0714, 0.3935], [0.59829, 0.6531, 0.46423], 2.2445, 17.3365, 15.8856, -0.9802, -0.1777),
    ]
    return _chain(lumps, hinges)


def _chain(lumps: Sequence[tuple[Any, ...]], hinges: Sequence[tuple[Any, ...]]) -> Genome:
    """Makes a genome of cubes in a row.

    Args:
        lumps: Of each its size (m), mass (kg) and place.
        hinges: Of each its anchor and axis, how far it swings (rad), its effort (N m), and the frequency (Hz), phase
            and offset of what drives it.
    """
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
