"""What a run's numbers depend on beside its inputs: which nmes, which engine, and what the machine computes.

A fingerprint is a flat dict of strings (`nmes.fingerprint` in schemas/recording_metadata.json). Two runs are comparable
bit for bit when the items in `DECISIVE` and every item of the engine (`engine.*`) are equal. What the machine computes
is told by a probe; the names of its processor and libraries are there for people, and decide nothing.
"""

from __future__ import annotations

import platform
import sys
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from pathlib import Path

from nmes.backend.probe import probe
from nmes.backend.registry import Backend

__all__ = ["DECISIVE", "VERSION", "decisive", "differences", "fingerprint"]

VERSION = version("nmes")
"""Of this package, which does not change while it runs: looking it up takes a millisecond."""

DECISIVE = ("nmes", "backend", "probe")

# The levels of the x86-64 psABI: libraries choose their code paths by these sets, not by single flags.
_X86_LEVELS = (
    ("x86-64-v4", frozenset("avx512f avx512bw avx512cd avx512dq avx512vl".split())),
    ("x86-64-v3", frozenset("avx avx2 bmi1 bmi2 f16c fma movbe".split())),
    ("x86-64-v2", frozenset("cx16 popcnt sse4_1 sse4_2 ssse3".split())),
)
_ARM_FLAGS = ("asimd", "sve", "sve2")
_SIMD_PREFIXES = ("sse", "ssse", "avx", "fma", "f16c", "asimd", "sve", "neon")


def fingerprint(backend: Backend) -> dict[str, str]:
    """Returns this machine's and this installation's fingerprint for one engine."""
    return {
        "nmes": VERSION,
        "backend": backend.name,
        "engine.version": backend.version(),
        **{f"engine.{name}": value for name, value in sorted(backend.fingerprint().items())},
        "probe": probe(backend),
        **_machine(),
    }


def decisive(items: Mapping[str, str]) -> dict[str, str]:
    """Returns the items of a fingerprint that decide whether two runs are comparable."""
    return {name: value for name, value in items.items() if name in DECISIVE or name.startswith("engine.")}


def differences(recorded: Mapping[str, str], here: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Returns the decisive items in which two fingerprints differ, with both values ("" where one lacks it)."""
    names = decisive({**here, **recorded})
    pairs = {name: (recorded.get(name, ""), here.get(name, "")) for name in names}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


@cache
def _machine() -> dict[str, str]:
    model, flags = _processor()
    return {
        "architecture": platform.machine(),
        "simd": _simd_class(flags),
        "libc": " ".join(platform.libc_ver()).strip() or f"of {platform.system()} {platform.release()}",
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "os": platform.platform(),
        "cpu": model or platform.processor() or "unknown",
        "cpu_flags": " ".join(sorted(flag for flag in flags if flag.startswith(_SIMD_PREFIXES))),
    }


def _simd_class(flags: frozenset[str]) -> str:
    if platform.machine().lower() in ("x86_64", "amd64"):
        return next((name for name, needed in _X86_LEVELS if needed <= flags), "x86-64")
    return "+".join([platform.machine(), *(flag for flag in _ARM_FLAGS if flag in flags)])


def _processor() -> tuple[str, frozenset[str]]:
    """Returns the processor's model and feature flags, where the system tells."""
    if not sys.platform.startswith("linux"):
        return "", frozenset()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return "", frozenset()
    fields = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in lines)}
    return fields.get("model name", ""), frozenset(fields.get("flags", fields.get("Features", "")).split())
