"""MuJoCo's sleep: which trees are awake, and what of it outlives an edit.

`tree_asleep` has a number for each tree: negative while it is awake, a count-down; else the next tree of its island,
in a ring. MuJoCo keeps lists of what is awake beside it, which must agree.
"""

from __future__ import annotations

from collections.abc import Collection, Container, Iterable, Mapping

import mujoco
import numpy as np
import numpy.typing as npt

from nmes.backends.mujoco3d.model import CompiledModel

__all__ = ["AWAKE", "count_awake", "restored_sleep", "surviving_sleep", "wake_islands"]

AWAKE = -(1 + mujoco.mjMINAWAKE)
"""`tree_asleep` of a tree that has just woken."""


def count_awake(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Makes MuJoCo's lists of what is awake agree with `tree_asleep`, as its own mj_updateSleep does."""
    tree = data.tree_asleep < 0
    data.tree_awake[:] = tree
    body_tree = model.body_treeid
    body = np.where(body_tree < 0, -1, tree[body_tree] if len(tree) else 0)
    data.body_awake[:] = body
    awake = np.flatnonzero(body)
    data.body_awake_ind[: len(awake)] = awake
    parents = np.flatnonzero(body[model.body_parentid])
    data.parent_awake_ind[: len(parents)] = parents
    dofs: npt.NDArray[np.intp] = np.flatnonzero(tree[model.dof_treeid]) if len(tree) else np.empty(0, np.intp)
    data.dof_awake_ind[: len(dofs)] = dofs
    data.ntree_awake, data.nbody_awake = int(tree.sum()), len(awake)
    data.nparent_awake, data.nv_awake = len(parents), len(dofs)


def wake_islands(asleep: npt.NDArray[np.int32], trees: Iterable[int]) -> bool:
    """Wakes the islands of trees in `tree_asleep`; returns whether any slept, so that `count_awake` is due."""
    woken = False
    for tree in trees:
        while tree >= 0 and (following := int(asleep[tree])) >= 0:
            asleep[tree] = AWAKE
            tree, woken = following, True
    return woken


def surviving_sleep(
    compiled: CompiledModel, asleep: npt.NDArray[np.int32], edited: Container[int], bodies: Collection[int]
) -> dict[int, int]:
    """Returns the part of `tree_asleep` that outlives an edit, with trees named by the keys of their first bodies.

    A negative value is the count-down of a tree that is awake; another is the key of the next tree of a sleeping
    island. An island in which anything was edited, or is not among the `bodies` any more, wakes.
    """
    model, links = compiled.model, asleep.tolist()
    keys = [compiled.stable_key.get(int(index)) for index in model.tree_bodyadr]  # None: parked
    woken = {
        int(model.body_treeid[index])
        for index, body in compiled.body_number.items()
        if (body in edited or body not in bodies) and model.body_treeid[index] >= 0
    }
    for tree in sorted(woken):
        while (following := links[tree]) >= 0:
            links[tree] = AWAKE
            woken.add(tree := following)
    surviving = {}
    for tree, link in enumerate(links):
        key, following_key = keys[tree], keys[link] if link >= 0 else link
        if key is not None and following_key is not None and tree not in woken:
            surviving[key] = following_key
    return surviving


def restored_sleep(compiled: CompiledModel, surviving: Mapping[int, int]) -> npt.NDArray[np.int32]:
    """Returns `tree_asleep` for a model that may have other trees; parked bodies always sleep."""
    model = compiled.model
    tree_of = {compiled.stable_key.get(int(index)): tree for tree, index in enumerate(model.tree_bodyadr)}
    asleep = np.full(model.ntree, AWAKE, np.int32)
    for key, link in surviving.items():
        asleep[tree_of[key]] = link if link < 0 else tree_of[link]
    parked = model.body_treeid[compiled.spares]
    asleep[parked] = parked
    return asleep
