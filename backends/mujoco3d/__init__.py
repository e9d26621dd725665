"""The MuJoCo engine (4.x) as a backend, in 3D.

`layout` turns a set of bodies and joints into a compiled model; `simulation` keeps one such model running and carries
its state over whenever the set changes. Nothing else knows of MuJoCo.
"""

from nmes.backends.mujoco3d.simulation import MujocoBackend, MujocoSimulation

__all__ = ["MujocoBackend", "MujocoSimulation"]
