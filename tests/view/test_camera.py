"""What a film's camera looks at where bodies change: parts that grow, and limbs that are left behind."""

from __future__ import annotations

import numpy as np

from nmes.backend import CameraSpec
from nmes.backend.rotation import rotate
from nmes.backend.shapes import Shape
from nmes.view.camera import cameras
from nmes.view.moments import Moment

FPS = 10.0


def film(*places: dict[str, tuple[float, float, float]]) -> list[Moment]:
    """Returns moments with cubes of 0.4 m at their places."""
    box: Shape = "box"
    look = (0.4, 0.4, 0.4), (0.5, 0.5, 0.5, 1.0), box
    turn = (0.0, 0.1, 0.0, 1.0)
    return [
        Moment(i / FPS, 1, dict.fromkeys(at, look), np.array([(*place, *turn) for place in at.values()]))
        for i, at in enumerate(places)
    ]


def follow(moments: list[Moment]) -> list[CameraSpec]:
    return cameras(moments, "follow", None, FPS, (320, 240))


def distance(camera: CameraSpec, place: tuple[float, float, float]) -> float:
    """Returns how far a place is from the line along which a camera looks, m."""
    eye, ahead = np.array(camera.position), np.array(rotate(camera.quaternion, (0.0, 0.0, -1.0)))
    arm = np.array(place) - eye
    return float(np.linalg.norm(arm - arm @ ahead * ahead))


def test_parts_that_grow_are_looked_at() -> None:
    root = {"root": (0.0, 0.2, 0.0)}
    grown = {**root, **{f"stem{i}": (0.0, 0.2 + 1.0 * i, 0.0) for i in range(1, 5)}}
    before, after = ({**each, "root": (0.03 * i, 0.2, 0.0)} for i, each in enumerate((root, grown)))
    last = follow(film(*[before] * 10, *[after] * 30))[-1]
    assert distance(last, (0.0, 2.2, 0.0)) < 0.3


def test_what_is_beside_what_is_looked_at_is_found_wherever_it_is() -> None:
    """All distances are computed here, and one of two cameras is told whom to look at."""
    draw = np.random.default_rng(7)
    for _ in range(100):
        places = draw.uniform(-4.0, 4.0, (16, 3)) * (1.0, 0.4, 0.4)
        seen = {at for at in range(16) if np.linalg.norm(places[0] - places[at]) < 1.5}
        for at in range(8, 16):  # those that come later, one after the other
            if (np.linalg.norm(places[sorted(seen)] - places[at], axis=1) < 1.5).any():
                seen.add(at)
        names = [f"{'seen' if at in seen else 'other'}{at}" for at in range(16)]
        here = dict(zip(names, map(tuple, places.tolist()), strict=True))
        x, y, z = here[names[0]]
        goes = {**here, names[0]: (x + 0.1, y, z)}
        moments = film({name: here[name] for name in names[:8]}, here, goes)
        assert follow(moments) == cameras(moments, "follow", "seen", FPS, (320, 240))


def test_what_came_to_rest_is_left_behind_by_what_goes_on() -> None:
    places = [{"trunk": (0.2 * i, 0.2, 0.0), "limb": (0.2 * min(i, 10), 0.2, 0.0)} for i in range(60)]
    seen = follow(film(*places))
    assert distance(seen[45], (0.2 * 45, 0.2, 0.0)) < 0.5
    assert distance(seen[15], (0.2 * 12.5, 0.2, 0.0)) < 1.0  # while it is near, both


def test_what_never_moves_beside_what_does_stays_in_view() -> None:
    seen = follow(film(*[{"base": (0.0, 0.2, 0.0), "arm": (1.0 + 0.02 * i, 0.2, 0.0)} for i in range(40)]))
    assert distance(seen[-1], (0.9, 0.2, 0.0)) < 0.3
