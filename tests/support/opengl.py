"""Pictures in tests: what is to be left out on a machine that has no OpenGL."""

from __future__ import annotations

from ctypes.util import find_library

import pytest

__all__ = ["OPENGL", "with_opengl"]

OPENGL = any(map(find_library, ("EGL", "OSMesa")))
"""Whether this machine has a library that draws without a display: found without the code that is tested, which tests
hold against it, so that nothing is left out because that code is wrong."""

with_opengl = pytest.mark.skipif(not OPENGL, reason="no OpenGL works on this machine without a display")
"""Marks a test that cannot be run where there is none."""
