"""Brains that swing: sine waves, and central pattern generators of coupled oscillators.

Both share the oscillators of their documents. A sine wave is computed for as many steps at once as one likes. So is a
central pattern generator without links and feedback; with links, only phases go step by step, and amplitudes and
controls are computed afterwards, all at once; with feedback everything goes step by step.

Literature: A. J. Ijspeert, "Central pattern generators for locomotion control in animals and robots: a review",
Neural Networks 21 (2008), and for the amplitudes Ijspeert et al., Science 315 (2007); the phases are those of
Y. Kuramoto, "Chemical Oscillations, Waves, and Turbulence" (1984).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from math import exp, sin, tau

import numpy as np

from nmes.brain.arithmetic import each, on_each, weigh
from nmes.brain.base import LIMIT, Array, Brain, Findings, Indices, JsonObject, Kernel, OpenLoop

__all__ = ["CpgBrain", "SineBrain"]

_NUMBERS = ("frequency", "amplitude", "phase", "step", "offset")
_EDGES = 4096  # links between oscillators at most, once wildcards are resolved
_MOST_STEPS = 2**53  # that a memory may tell of


class _Oscillators:
    """Which oscillator drives which motor, and as which of its motors; `named` if each names motors that there are."""

    def __init__(self, document: JsonObject, outputs: Sequence[str], findings: Findings) -> None:
        entries = [oscillator["motor"] for oscillator in document["oscillators"]]
        pointers = [f"oscillators/{number}/motor" for number in range(len(entries))]
        self.owner = findings.owners(entries, outputs, "motor", pointers)
        self.named = not any(findings.is_unknown(entry, "motor") for entry in entries)
        self.rank = [self.owner[:i].count(owner) for i, owner in enumerate(self.owner)]
        self.driven = [i for i, owner in enumerate(self.owner) if owner >= 0]

    def waves(self, document: JsonObject) -> Array:
        """Returns for each motor the speed (rad/s), amplitude, phase (rad) and offset: shape (4, motors)."""
        table = np.array([[oscillator[name] for name in _NUMBERS] for oscillator in document["oscillators"]])
        frequency, amplitude, phase, step, offset = np.vstack([table, np.zeros(5)])[self.owner].T
        return np.stack([tau * frequency, amplitude, phase - step * np.array(self.rank), offset])


def _times(first: int, count: int, dt: float, like: Array) -> Array:
    """Returns the times of steps, s, with axes of length 1 behind: as many as `like` has."""
    times: Array = np.arange(first, first + count, dtype=np.float64) * dt
    return times.reshape(times.shape + (1,) * like.ndim)


def _kept(controls: Array) -> Array:
    return np.minimum(np.maximum(controls, -1.0), 1.0)


class SineKernel(OpenLoop):
    """control = offset + amplitude sin(speed t + phase)."""

    def __init__(self, waves: Array) -> None:
        self._speed: Array = waves[..., 0, :]
        self._amplitude: Array = waves[..., 1, :]
        self._phase: Array = waves[..., 2, :]
        self._offset: Array = waves[..., 3, :]
        self._lead = self._speed.shape[:-1]

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start."""
        self._dt = dt
        self._steps = 0
        super().reset(seeds, dt)

    def _more(self, count: int) -> Array:
        times = _times(self._steps, count, self._dt, self._speed)
        self._steps += count
        waves = self._speed * times + self._phase
        each(sin, waves)
        return _kept(self._offset + self._amplitude * waves)

    def _moment(self) -> Array:
        return np.full((*self._lead, 1), float(self._steps))

    def _go_to(self, moment: Array) -> None:
        self._steps = _steps_of(moment)


def _steps_of(memory: Array) -> int:
    """Returns the number of steps with which a memory begins; raises ValueError where it is none."""
    steps = float(memory[..., 0].flat[0])
    if not (steps.is_integer() and 0.0 <= steps < _MOST_STEPS):
        raise ValueError("this is no memory of this brain")
    return int(steps)


class SineBrain(Brain):
    """A sine wave for each motor (`schemas/brain-sine.json`)."""

    kind = "sine"

    def _resolve(self, document: JsonObject, findings: Findings) -> None:
        self._oscillators = _Oscillators(document, self.outputs, findings)

    def _arrays(self) -> tuple[Array, ...]:
        return (self._oscillators.waves(self._document),)

    def _run(self, *arrays: Array) -> Kernel:
        return SineKernel(*arrays)


class CpgKernel(Kernel):
    """Coupled phase oscillators, by Euler's method: one step of it is one control step.

    With s_e = sin(phase_from - phase_to - lag) for each edge e, the next phases are
    phase + dt (speed + sum weight s + sum rate x). Both sums are products of a matrix with what stands in one row,
    [phases, 1, inputs, s], so that a step is a few calls of numpy.
    """

    def __init__(
        self, edges: Indices, convergence: float, jitter: float, waves: Array, ties: Array, rates: Array, offsets: Array
    ) -> None:
        """Takes edges (2, edges: from, to), ties (*lead, 2, edges: weight, lag), rates and offsets (*lead, n, m)."""
        self._source, self._target = edges
        self._convergence = convergence
        self._jitter = jitter
        self._ties, self._rates, self._shifts = ties, rates, offsets
        self._speed: Array = waves[..., 0, :]
        self._amplitude: Array = waves[..., 1, :]
        self._phase: Array = waves[..., 2, :]
        self._offset: Array = waves[..., 3, :]
        self._lead = self._speed.shape[:-1]
        self._n, self._edges, self._m = self._speed.shape[-1], edges.shape[1], rates.shape[-1]
        # Columns of the row.
        self._one = self._n
        self._x = slice(self._n + 1, self._n + 1 + self._m)
        self._s = slice(self._n + 1 + self._m, self._n + 1 + self._m + self._edges)
        self._apart = self._differences()
        self._onward = np.zeros((*self._lead, self._n, self._s.stop))
        self._row = np.zeros((*self._lead, self._s.stop))
        self._row[..., self._one] = 1.0
        self._phases, self._before = self._row[..., : self._n], self._row[..., : self._n + 1]
        self._after, self._pulls = np.empty((*self._lead, self._n)), np.empty((*self._lead, self._edges))
        self._pull = on_each(sin, self._pulls, self._row[..., self._s])

    def _differences(self) -> Array:
        """Returns the matrix that gives phase_from - phase_to - lag for each edge."""
        apart = np.zeros((*self._lead, self._edges, self._n + 1))
        each = np.arange(self._edges)
        apart[..., each, self._source] = 1.0
        apart[..., each, self._target] = -1.0
        apart[..., each, self._one] = -self._ties[..., 1, :]
        return apart

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start."""
        self._dt = dt
        self._steps = 0
        each = np.arange(self._n)
        self._onward[..., each, each] = 1.0
        self._onward[..., self._one] = dt * self._speed
        self._onward[..., self._x] = dt * self._rates
        self._onward[..., self._target, np.arange(self._s.start, self._s.stop)] = dt * self._ties[..., 0, :]
        self._phases[...] = self._phase
        if self._jitter > 0:
            for row, seed in zip(self._phases.reshape(-1, self._n), seeds, strict=True):
                # A generator whose numbers numpy promises to keep.
                draw = np.random.RandomState(np.random.MT19937(np.random.SeedSequence(seed)))
                row += self._jitter * (2.0 * draw.random_sample(self._n) - 1.0)

    def _advance(self) -> None:
        """Goes from the row's phases and inputs to the next phases."""
        weigh(self._apart, self._before, self._pulls)
        self._pull()
        weigh(self._onward, self._row, self._after)
        self._phases[...] = self._after

    def _moment(self) -> Array:
        return np.concatenate([np.full((*self._lead, 1), float(self._steps)), self._phases], axis=-1)

    def _go_to(self, moment: Array) -> None:
        self._steps = _steps_of(moment)
        self._phases[...] = moment[..., 1:]

    def _grown(self, times: Array) -> Array:
        """Returns how far the amplitudes have grown at some times: 1 - (1 + z) exp(-z), z = convergence t / 2.

        That solves r'' = a (a/4 (R - r) - r') from rest at r = 0, for R = 1.
        """
        z = 0.5 * self._convergence * times
        rest = -z
        each(exp, rest)
        grown: Array = 1.0 - (1.0 + z) * rest
        return grown


class FreeCpgKernel(CpgKernel, OpenLoop):
    """Oscillators that look at nothing."""

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start."""
        CpgKernel.reset(self, seeds, dt)
        OpenLoop.reset(self, seeds, dt)

    def _more(self, count: int) -> Array:
        times = _times(self._steps, count, self._dt, self._speed)
        waves = self._linked(count) if self._edges else self._speed * times + self._phases
        each(sin, waves)
        self._steps += count
        return _kept(self._offset + self._grown(times) * self._amplitude * waves)

    def _linked(self, count: int) -> Array:
        phases = np.empty((count, *self._phases.shape))
        for now in phases:
            now[...] = self._phases
            self._advance()
        return phases


class ListeningCpgKernel(CpgKernel):
    """Oscillators with feedback."""

    _AHEAD = 64  # steps whose amplitudes are computed at once

    def reset(self, seeds: Sequence[int], dt: float) -> None:
        """Goes to the start."""
        super().reset(seeds, dt)
        self._amplitudes = np.empty((self._AHEAD, *self._after.shape))
        self._heard = self._row[..., self._x]
        self._low, self._high = np.full(self._m, -LIMIT), np.full(self._m, LIMIT)
        self._out: Array = np.empty_like(self._after)
        self._swing = on_each(sin, self._after, self._out)
        self._floor, self._ceiling = np.full(self._n, -1.0), np.full(self._n, 1.0)

    def memory(self) -> Array:
        """Returns the number of its steps and the phases."""
        return self._moment()

    def _take_up(self, memory: Array) -> None:
        self._go_to(memory)
        done = self._steps % self._AHEAD
        self._steps -= done
        self._grow()
        self._steps += done

    def _grow(self) -> None:
        """Computes the amplitudes of this step and those that come next."""
        steps = np.arange(self._steps, self._steps + self._AHEAD, dtype=np.float64)
        times = steps.reshape(-1, *(1,) * self._amplitude.ndim) * self._dt
        np.multiply(self._grown(times), self._amplitude, out=self._amplitudes)

    def step(self, inputs: Array) -> Array:
        """Goes one control step on."""
        at = self._steps % self._AHEAD
        if at == 0:
            self._grow()
        out, heard, shift = self._out, self._heard, self._after
        np.maximum(inputs, self._low, out=heard)
        np.minimum(heard, self._high, out=heard)
        shift[...] = self._phases
        self._swing()
        np.multiply(out, self._amplitudes[at], out=out)
        np.add(out, self._offset, out=out)
        weigh(self._shifts, heard, shift)
        np.add(out, shift, out=out)
        np.maximum(out, self._floor, out=out)
        np.minimum(out, self._ceiling, out=out)
        self._advance()
        self._steps += 1
        return out


class CpgBrain(Brain):
    """A central pattern generator (`schemas/brain-cpg.json`)."""

    kind = "cpg"

    def _resolve(self, document: JsonObject, findings: Findings) -> None:
        self._oscillators = _Oscillators(document, self.outputs, findings)
        driven = frozenset(self._oscillators.driven)

        def oscillators(entry: str, pointer: str) -> list[int]:
            motors = findings.match(entry, self.outputs, "motor", pointer)
            swung = [motor for motor in motors if motor in driven]
            if motors and not swung and self._oscillators.named:  # a wrongly named one may be theirs
                which = "the motor" if entry in self.outputs else "no motor that fits"
                findings.add(pointer, f"{which} {entry!r} has {'no' if entry in self.outputs else 'an'} oscillator")
            return swung

        edges: list[tuple[int, int, int, float]] = []  # from, to, which link or chain, sign of its lag
        for number, link in enumerate(document["links"]):
            sources = oscillators(link["from"], f"links/{number}/from")
            targets = oscillators(link["to"], f"links/{number}/to")
            if len(edges) + len(sources) * len(targets) > 2 * _EDGES:  # however many of them are of one with itself
                findings.add(f"links/{number}", f"with it there are over {_EDGES:,} links between two oscillators")
                return
            pairs = [(source, target) for target in targets for source in sources if source != target]
            if sources and targets and not pairs:
                findings.add(f"links/{number}", "links an oscillator with itself")
            edges += [(source, target, number, 1.0) for source, target in pairs]
        for number, chain in enumerate(document["chains"], len(document["links"])):
            row = oscillators(chain["motors"], f"chains/{number - len(document['links'])}/motors")
            for before, after in pairwise(row):
                edges += [(before, after, number, 1.0), (after, before, number, -1.0)]
        if len(edges) > _EDGES:
            findings.add("links", f"makes {len(edges):,} links between two oscillators, at most {_EDGES:,}")
        self._edges = np.array([edge[:2] for edge in edges], np.intp).reshape(-1, 2).T
        self._edge_entries = np.array([edge[2] for edge in edges], np.intp)
        self._edge_signs = np.array([edge[3] for edge in edges])
        self._feedback = [
            (
                findings.match(term["sensor"], self.inputs, "sensor", f"feedback/{number}/sensor"),
                oscillators(term["motor"], f"feedback/{number}/motor"),
            )
            for number, term in enumerate(document["feedback"])
        ]

    def _arrays(self) -> tuple[Array, ...]:
        document = self._document
        entries = [(entry["weight"], entry["lag"]) for entry in (*document["links"], *document["chains"])]
        ties = np.array(entries).reshape(-1, 2)[self._edge_entries].T
        ties[1] *= self._edge_signs
        rates, offsets = np.zeros((2, len(self.outputs), len(self.inputs)))
        for (sensors, motors), term in zip(self._feedback, document["feedback"], strict=True):
            where = np.ix_(motors, sensors)
            rates[where] += term["rate"]
            offsets[where] += term["offset"]
        return self._oscillators.waves(document), ties, rates, offsets

    def _run(self, *arrays: Array) -> Kernel:
        kernel = ListeningCpgKernel if self._feedback else FreeCpgKernel
        return kernel(self._edges, self._document["convergence"], self._document["start_jitter"], *arrays)
