"""The interface of physics engines, how one is found, and what an engine's author needs besides.

A Backend is an installed engine adapter: a name, a version, capabilities and a factory of Simulations. A Simulation
is one running scene: bodies and joints known by the integers that the World chose, in SI units, Y up, quaternions
`(x, y, z, w)`. It knows no names, clients, frames or JSON: those are the World's, so that an adapter is small and
engines cannot differ in meaning. `nmes.backend.rotation` has quaternions; `nmes.backend.contract` puts every promise of
an engine to the test.
"""

from __future__ import annotations

from nmes.backend.registry import ENTRY_POINT_GROUP, Backend, entry_points_by_name, load_backend
from nmes.backend.rows import Places, Row, Rows, RowsTrack
from nmes.backend.simulation import Simulation, Track
from nmes.backend.specs import (
    CAPABILITIES,
    Arena,
    Array,
    BodySpec,
    BodyState,
    CameraSpec,
    Contact,
    Heightfield,
    Hit,
    Image,
    JointParams,
    JointSpec,
    JointState,
    Medium,
    Planet,
    Quaternion,
    SceneSpec,
    StaticBox,
    Vector,
)

__all__ = [
    "CAPABILITIES",
    "ENTRY_POINT_GROUP",
    "Arena",
    "Array",
    "Backend",
    "BodySpec",
    "BodyState",
    "CameraSpec",
    "Contact",
    "Heightfield",
    "Hit",
    "Image",
    "JointParams",
    "JointSpec",
    "JointState",
    "Medium",
    "Places",
    "Planet",
    "Quaternion",
    "Row",
    "Rows",
    "RowsTrack",
    "SceneSpec",
    "Simulation",
    "StaticBox",
    "Track",
    "Vector",
    "entry_points_by_name",
    "load_backend",
]
