"""Pictures in tests: what is to be left out on a machine that has no OpenGL."""

from __future__ import annotations

import pytest

from nmes.backend import load_backend

__all__ = ["OPENGL", "with_opengl"]

OPENGL = "camera" not in load_backend("mujoco").lacking
"""Whether this machine can draw pictures, as far as can be told without drawing one."""

with_opengl = pytest.mark.skipif(not OPENGL, reason="no OpenGL works on this machine without a display")
"""Marks a test that cannot be run where there is none."""
