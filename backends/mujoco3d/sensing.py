"""Sensors of a running model: contacts, proper acceleration, distances along rays.

It hides what MuJoCo keeps of a step and what it drops. Readings are those of the last engine step. A sleeping tree
has none, since the engine passes over it and drops its contacts; so they are computed when somebody asks, in a second
`MjData` in which that tree's island alone is awake. They are then a function of the island's own coordinates, and are
kept for as long as those stay: no query changes another's answer, or the simulation. Where planets attract, nothing
sleeps.

A `Senses` belongs to one compiled model and its data; both are replaced together.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence

import mujoco
import numpy as np

from nmes.backend import Array, Contact, Hit, Vector
from nmes.backend.rotation import total
from nmes.backends.mujoco3d.model import CompiledModel, kept_masks
from nmes.backends.mujoco3d.scenery import Scenery
from nmes.backends.mujoco3d.sleep import AWAKE, count_awake

__all__ = ["STATE", "Senses"]

STATE = int(mujoco.mjtState.mjSTATE_INTEGRATION)
_BODY = int(mujoco.mjtObj.mjOBJ_BODY)
_CORNERS = 4  # contacts of a cube that lies on a face
_SORTED = 10  # contacts that are sorted by body in the time in which one is told


class _Contacts:
    """The contacts of one MjData at one moment, by body."""

    def __init__(self, owners: Sequence[int], data: mujoco.MjData, edges: int) -> None:
        # One list each is faster than an array's element for each contact.
        contact = data.contact
        # The first axis of a contact's frame points from the first geom to the second.
        self._points, self._axes = contact.pos.tolist(), contact.frame[:, :3].tolist()
        self._force, self._edges = data.efc_force.tolist(), edges
        self._rows: dict[int, list[tuple[int, int, int, bool]]] = {}
        for i, ((one, other), at) in enumerate(zip(contact.geom.tolist(), contact.efc_address.tolist(), strict=True)):
            if at < 0:
                continue  # near, but not in force
            first, second = owners[one], owners[other]
            self._rows.setdefault(first, []).append((i, second, at, False))
            self._rows.setdefault(second, []).append((i, first, at, True))

    def of(self, index: int, numbers: dict[int, int], others: Container[int] | None = None) -> list[Contact]:
        """Returns the contacts of a body, or only those with some others."""
        result, edges = [], self._edges
        for i, other, at, second in self._rows.get(index, ()):
            if others is None or other in others:
                x, y, z = self._axes[i]
                normal = (x, y, z) if second else (-x, -y, -z)
                force = self._force[at] if edges == 1 else total(self._force[at : at + edges])
                result.append(Contact(numbers.get(other), tuple(self._points[i]), normal, force))
        return result


class Senses:
    """The sensors of one model."""

    def __init__(self, compiled: CompiledModel, data: mujoco.MjData, scenery: Scenery) -> None:
        self._numbers, self._model, self._data, self._scenery = compiled.body_number, compiled.model, data, scenery
        self._owners: list[int] = compiled.model.geom_bodyid.tolist()
        self._trees: list[int] = compiled.model.body_treeid.tolist()
        self._now_asleep = memoryview(data.tree_asleep)
        self._asleep = data.tree_asleep.copy()  # as of the last step: an edit may wake a tree before the next one
        self._kept_asleep = memoryview(self._asleep)
        # The normal force is the first of an elliptic cone's constraint forces, and the sum of a pyramid's four edges'.
        self._edges = 1 if compiled.model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC else 4
        self._step_contacts: _Contacts | None = None
        self._accelerated = False
        self._scratch: mujoco.MjData | None = None
        self._resting: dict[int, tuple[bytes, _Contacts]] = {}  # by sleeping tree: the coordinates that it is for
        self._checked: set[int] = set()  # the trees of which that is known to be up to date

    def forget(self) -> None:
        """Forgets the readings, since the engine stepped or a state was installed."""
        self._kept_asleep[:] = self._now_asleep
        self._step_contacts = None
        self._accelerated = False
        self._checked.clear()

    # -- contacts -----------------------------------------------------------------------------------------------

    def contacts(self, index: int) -> list[Contact]:
        """Returns the contacts of a body of the model."""
        tree = self._trees[index]
        if tree >= 0 and self._asleep[tree] >= 0:
            self._compute_missing([tree])
            return self._resting[tree][1].of(index, self._numbers)
        if self._step_contacts is None:
            self._step_contacts = _Contacts(self._owners, self._data, self._edges)
        if tree >= 0:
            return self._step_contacts.of(index, self._numbers)
        # Whatever sleeps on an immovable body touches it still.
        near = self._sleepers_near(index)
        if not near:
            return self._step_contacts.of(index, self._numbers)
        self._compute_missing(near)
        awake = {i for i, tree in enumerate(self._trees) if tree < 0 or self._asleep[tree] < 0}
        contacts = self._step_contacts.of(index, self._numbers, awake)
        for tree in near:
            first = int(self._model.tree_bodyadr[tree])
            bodies = range(first, first + int(self._model.tree_bodynum[tree]))
            contacts += self._resting[tree][1].of(index, self._numbers, bodies)
        return contacts

    def guess_contacts(self, index: int) -> int:
        """Returns about how many contacts `contacts` has to look at for a body, by their cost."""
        tree, contact = self._trees[index], self._data.contact
        if self.resting if tree < 0 else self._asleep[tree] >= 0 and not self._known(tree):
            return int(self._model.ngeom) * _CORNERS  # of what sleeps they may have to be computed, which takes a step
        own = np.count_nonzero(self._model.geom_bodyid[contact.geom] == index)
        return int(own) + (0 if self._step_contacts is not None else len(contact.dist) // _SORTED)

    @property
    def resting(self) -> bool:
        """Whether anything sleeps."""
        return bool((self._asleep >= 0).any())

    def touching(self, indices: list[int]) -> Array:
        """Returns a new array (n,): 1 for each of these bodies that has contacts, else 0. Only where nothing sleeps."""
        contact, touched = self._data.contact, np.zeros(self._model.nbody)
        touched[self._model.geom_bodyid[contact.geom[contact.efc_address >= 0]]] = 1.0
        return np.asarray(touched[indices])

    def _sleepers_near(self, index: int) -> list[int]:
        """Returns the sleeping trees that may touch a body: a bounding sphere of theirs meets one of the body's."""
        model, data = self._model, self._data
        if not (self._asleep >= 0).any():
            return []
        near: set[int] = set()
        first = int(model.body_geomadr[index])
        for geom in range(first, first + int(model.body_geomnum[index])):
            arm = data.geom_xpos - data.geom_xpos[geom]
            reach = model.geom_rbound + model.geom_rbound[geom]
            close = model.geom_bodyid[(arm * arm).sum(axis=1) <= reach * reach]
            near.update(model.body_treeid[close].tolist())
        return sorted(tree for tree in near if tree >= 0 and self._asleep[tree] >= 0)

    def _compute_missing(self, trees: Iterable[int]) -> None:
        """Computes the contacts of sleeping trees where they are not known."""
        missing = [tree for tree in trees if not self._known(tree)]
        if missing:
            if self._checked:
                # Somebody asks for one after the other: all at once costs a fraction of each for itself.
                missing = [tree for tree in np.flatnonzero(self._asleep >= 0).tolist() if not self._known(tree)]
            self._compute(missing)

    def _known(self, tree: int) -> bool:
        if tree in self._checked:
            return True
        entry = self._resting.get(tree)
        if entry is None:
            return False
        island = self._island(tree)
        if entry[0] != self._coordinates(island):
            return False
        self._checked.update(island)
        return True

    def _island(self, tree: int) -> list[int]:
        island, following = [tree], int(self._asleep[tree])
        while following != tree:
            island.append(following)
            following = int(self._asleep[following])
        return sorted(island)

    def _coordinates(self, island: Iterable[int]) -> bytes:
        model, qpos = self._model, self._data.qpos
        parts = []
        for tree in island:
            dofs = model.tree_dofadr[tree], model.tree_dofadr[tree] + model.tree_dofnum[tree] - 1
            first, last = (int(model.dof_jntid[dof]) for dof in dofs)
            end = int(model.jnt_qposadr[last + 1]) if last + 1 < model.njnt else model.nq
            parts.append(qpos[int(model.jnt_qposadr[first]) : end].tobytes())
        return b"".join(parts)

    def _compute(self, trees: Iterable[int]) -> None:
        """Computes the contacts of the islands of sleeping trees, apart from the simulation."""
        islands: list[list[int]] = []
        awake: set[int] = set()
        for tree in trees:
            if tree not in awake:
                islands.append(self._island(tree))
                awake.update(islands[-1])
        model, data = self._model, self._data
        if self._scratch is None:
            self._scratch = mujoco.MjData(model)
        scratch = self._scratch
        state = np.empty(mujoco.mj_stateSize(model, STATE))
        mujoco.mj_getState(model, data, state, STATE)
        mujoco.mj_setState(model, scratch, state, STATE)  # which wakes all, so that all poses are computed once
        scratch.qacc_warmstart[:] = 0.0
        mujoco.mj_kinematics(model, scratch)
        mujoco.mj_comPos(model, scratch)
        scratch.tree_asleep[:] = [AWAKE if tree in awake else tree for tree in range(model.ntree)]
        count_awake(model, scratch)
        if self._scenery.attracts:
            self._scenery.pull(model, scratch)
            scratch.xfrc_applied[[tree not in awake for tree in self._trees]] = 0.0  # a force would wake the others
        others = (model.body_treeid >= 0) & ~np.isin(model.body_treeid, list(awake))
        with kept_masks(model) as masks:
            for mask, theirs in zip(masks, (others[model.geom_bodyid],) * 2 + (others,) * 2, strict=True):
                mask[theirs] = 0  # what is not of the islands may be within them: it glides, or has just been put there
            mujoco.mj_forward(model, scratch)
        computed = _Contacts(self._owners, scratch, self._edges)
        for island in islands:
            entry = self._coordinates(island), computed
            self._resting.update((tree, entry) for tree in island)
        self._checked |= awake

    # -- acceleration and distance ------------------------------------------------------------------------------

    def proper_acceleration(self, index: int, position: Vector) -> Vector:
        """Returns the acceleration of a body's centre less that of free fall there, in world coordinates.

        Poses and velocities must be those of the coordinates.
        """
        tree = self._trees[index]
        gx, gy, gz = self._scenery.free_fall(position)
        if tree < 0 or self._asleep[tree] >= 0:
            return (-gx, -gy, -gz)
        if not self._accelerated:
            mujoco.mj_rnePostConstraint(self._model, self._data)
            self._accelerated = True
        both = np.empty(6)
        mujoco.mj_objectAcceleration(self._model, self._data, _BODY, index, both, 0)
        _, _, _, x, y, z = both.tolist()
        # MuJoCo takes its own gravity off, but knows nothing of the planets'.
        return (x - gx, y - gy, z - gz) if self._scenery.attracts else (x, y, z)

    def hits(self, exclude: int, origin: Vector, directions: Array, limit: float) -> list[Hit | None]:
        """Returns the first surfaces of other bodies along rays; poses must be those of the coordinates."""
        # One ray at a time: MuJoCo 3.17's `mj_multiRay` loses the ground's plane far from the origin.
        model, data, start = self._model, self._data, np.array(origin)
        geom = np.empty(1, np.int32)
        hits: list[Hit | None] = []
        for way in directions:
            reach = mujoco.mj_ray(model, data, start, way, None, True, exclude, geom)
            near = 0.0 <= reach <= limit
            hits.append(Hit(reach, self._numbers.get(self._owners[int(geom[0])])) if near else None)
        return hits
