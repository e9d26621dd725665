"""Policies of Stable-Baselines3 as brains: what `nmes genome from-sb3` does.

Hides how a model's file is laid out and which of its layers decide what is done; neither torch nor Stable-Baselines3 is
needed. What a brain does is the policy's deterministic action, to a millionth: it computes in 64 bits what the policy
computes in 32.

Source: A. Raffin et al., "Stable-Baselines3: reliable reinforcement learning implementations", Journal of Machine
Learning Research 22 (2021): its files since version 1.0.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np

from nmes.backend import Array
from nmes.errors import DocumentError
from nmes.genome import Genome
from nmes.learning.torch_files import Archive, Thing, array_of, read_pickle, read_tensors
from nmes.schemas.documents import JsonObject

__all__ = ["read_policy", "with_policy"]

_MOST_FILE: Final = 1 << 28  # bytes of a model, with its critics and its optimizers
_MOST_DATA: Final = 1 << 25  # bytes of its settings
_MOST_STATISTICS: Final = 1 << 20
_LONGEST: Final = 200  # characters of a text that is looked at
_ACTIVATIONS: Final = {"Tanh": "tanh", "ReLU": "relu", "Sigmoid": "sigmoid", "Identity": "identity"}
_EXTRACTORS: Final = {"FlattenExtractor"}
_NUMBERED: Final = re.compile(r"([0-9]{1,3})\.(weight|bias)")

Layer = tuple[Array, Array, str]
"""Weights (units, inputs), biases (units,), and the activation."""


def with_policy(
    genome: Genome, model: str | os.PathLike[str], statistics: str | os.PathLike[str] | None = None
) -> Genome:
    """Returns a genome with a policy for its brain.

    Args:
        genome: The creature; all its sensors and motors, in their order, are what the policy saw and did.
        model: The file that `model.save` wrote.
        statistics: As for `read_policy`.

    Raises:
        DocumentError: As by `read_policy`; or the policy does not fit the creature.
    """
    layers = read_policy(model, statistics)
    sees, does = layers[0][0].shape[1], layers[-1][0].shape[0]
    sensors, motors = len(genome.body.sensors), len(genome.body.outputs)
    for number, there, what in ((sees, sensors, "sensors"), (does, motors, "motors")):
        if number != there:
            how = "sees" if what == "sensors" else "does"
            words = f"the policy {how} {number} numbers, and {genome.name} has {there} {what}"
            raise DocumentError([("brain", f"{words}: give the genome that it was trained with")])
    brain = {
        "kind": "mlp",
        "layers": [
            {"weights": weights.tolist(), "biases": biases.tolist(), "activation": activation}
            for weights, biases, activation in layers
        ],
    }
    document: JsonObject = {**genome.document, "brain": brain, "parents": [genome.hash]}
    found = Genome(document)
    found.check_brain()  # that its numbers are within their bounds
    return found


def read_policy(model: str | os.PathLike[str], statistics: str | os.PathLike[str] | None = None) -> list[Layer]:
    """Reads what a policy of PPO, A2C, SAC, TD3 or DDPG does where it draws no numbers.

    Args:
        model: The file that `model.save` wrote.
        statistics: What `VecNormalize.save` wrote, if the policy was trained on observations that were normalised so.

    Returns:
        The layers, from the observations to the actions.

    Raises:
        DocumentError: It is none of these, or has parts that layers of a brain cannot be.
    """
    path = Path(model)
    archive = Archive(_read(path, _MOST_FILE), str(path))
    settings = _settings(archive, str(path))
    weights = read_tensors(archive.read("policy.pth", _MOST_FILE), f"{path}: policy.pth", _decides)
    layers = _layers(weights, settings, str(path))
    for (before, _, _), (after, _, _) in pairwise(layers):
        if before.shape[0] != after.shape[1]:
            words = f"a layer of {before.shape[0]} units, then one of {after.shape[1]} inputs"
            raise DocumentError([("", f"{path}: {words}")])
    return layers if statistics is None else _normalised(Path(statistics), layers)


def _read(path: Path, most: int) -> bytes:
    try:
        if path.stat().st_size > most:
            raise DocumentError([("", f"{path} has {path.stat().st_size:,} bytes, and at most {most:,} are read")])
        return path.read_bytes()
    except OSError as error:
        raise DocumentError([("", f"{path} cannot be read: {error.strerror}")]) from error


# -- settings ---------------------------------------------------------------------------------------------------------


def _settings(archive: Archive, what: str) -> Mapping[str, Any]:
    """Returns a model's own settings; only texts and numbers of them are read.

    Raises:
        DocumentError: It cannot be read, or says that its policy is more than layers.
    """
    try:
        settings = json.loads(archive.read("data", _MOST_DATA))
    except (ValueError, RecursionError) as error:
        raise DocumentError([("", f"{what} does not say what it is: {error}")]) from error
    if not isinstance(settings, dict):
        raise DocumentError([("", f"{what} does not say what it is")])
    home = _part(settings, "policy_class", "__module__")
    if home is not None and not str(home).startswith("stable_baselines3."):
        raise DocumentError(
            [("", f"{what} has a policy of its own, from {str(home)[:_LONGEST]}, which cannot be read")]
        )
    extractor = _name(_part(settings, "policy_kwargs", "features_extractor_class"))
    if extractor is not None and extractor not in _EXTRACTORS:
        raise DocumentError([("", f"{what} looks through {extractor} first, which no brain has")])
    for name, bound in (("low", -1.0), ("high", 1.0)):
        bounds = settings.get("action_space")
        told = bounds.get(name) if isinstance(bounds, dict) else None
        if told is not None and set(str(told).strip("[]").split()) - {"...", f"{bound:g}.", f"{bound:g}", f"{bound}"}:
            words = f"{what} acts within {name} {str(told)[:_LONGEST]}, and motors are driven from -1 to 1"
            raise DocumentError([("", f"{words}: train it on actions of these bounds")])
    return settings


def _part(settings: Mapping[str, Any], name: str, part: str) -> Any:
    """Returns a part of a setting, of a text its beginning; None if it is not told."""
    setting = settings.get(name)
    told = setting.get(part) if isinstance(setting, dict) else None
    return told[:_LONGEST] if isinstance(told, str) else told


def _name(text: Any) -> str | None:
    """Returns the name of a class whose text is `<class 'module.Name'>`; None if there is none."""
    return None if text is None else str(text)[:_LONGEST].removesuffix("'>").rpartition(".")[2]


def _activation(settings: Mapping[str, Any], usual: str, what: str) -> str:
    """Returns the activation of the hidden layers.

    Raises:
        DocumentError: No brain has it.
    """
    name = _name(_part(settings, "policy_kwargs", "activation_fn"))
    if name is None:
        return usual
    if name not in _ACTIVATIONS:
        raise DocumentError([("", f"{what} has the activation {name}; brains have {', '.join(_ACTIVATIONS)}")])
    return _ACTIVATIONS[name]


# -- layers -----------------------------------------------------------------------------------------------------------


def _decides(name: str) -> bool:
    """Whether a tensor of a policy may decide what is done."""
    return name.startswith(("mlp_extractor.policy_net.", "action_net.", "log_std", "actor.")) or "extractor." in name


def _layers(weights: Mapping[str, Array], settings: Mapping[str, Any], what: str) -> list[Layer]:
    """Returns the layers from observations to actions.

    Raises:
        DocumentError: There are none, or something that is none beside them.
    """
    learned = [name for name in weights if "features_extractor" in name or "mlp_extractor.shared" in name]
    if learned:
        raise DocumentError([("", f"{what} has layers that are not of a MlpPolicy: {learned[0]}")])
    sde = settings.get("use_sde") is True
    if "action_net.weight" in weights:
        if "log_std" not in weights:
            raise DocumentError([("", f"{what} chooses among actions; motors are driven with numbers")])
        hidden, last = _numbered(weights, "mlp_extractor.policy_net.", what), _pair(weights, "action_net", what)
        squashed = sde and _part(settings, "policy_kwargs", "squash_output") is True
        return _stack(hidden, last, _activation(settings, "tanh", what), "tanh" if squashed else "identity")
    if "actor.mu.weight" in weights:
        hidden, last = _numbered(weights, "actor.latent_pi.", what), _pair(weights, "actor.mu", what)
        return _stack(hidden, last, _activation(settings, "relu", what), "tanh")
    if any(name.startswith("actor.latent_pi.") for name in weights):  # it explores by its state: the mean is cut off
        hidden, last = _numbered(weights, "actor.latent_pi.", what), _pair(weights, "actor.mu.0", what)
        cut = _part(settings, "policy_kwargs", "clip_mean")
        same = np.eye(len(last[0])), np.zeros(len(last[0])), "tanh"
        inner = [(*each, _activation(settings, "relu", what)) for each in hidden]
        return [*inner, *_cut_off(last, 2.0 if cut is None else _positive(cut, f"{what}: clip_mean"), same)]
    found = _numbered(weights, "actor.mu.", what)
    if not found:
        raise DocumentError([("", f"{what} holds no policy of PPO, A2C, SAC, TD3 or DDPG that drives by numbers")])
    return _stack(found[:-1], found[-1], _activation(settings, "relu", what), "tanh")


def _stack(hidden: list[tuple[Array, Array]], last: tuple[Array, Array], inner: str, outer: str) -> list[Layer]:
    return [*((weights, biases, inner) for weights, biases in hidden), (*last, outer)]


def _numbered(weights: Mapping[str, Array], prefix: str, what: str) -> list[tuple[Array, Array]]:
    """Returns the layers of a sequence, in order; what stands between two of them is their activation.

    Raises:
        DocumentError: Something else is in it, such as a normalisation of layers.
    """
    numbers = set()
    for name in weights:
        if name.startswith(prefix):
            match = _NUMBERED.fullmatch(name.removeprefix(prefix))
            if match is None:
                raise DocumentError([("", f"{what} has {name}, which is no layer that a brain has")])
            numbers.add(int(match[1]))
    if sorted(numbers) != list(range(0, 2 * len(numbers), 2)):
        raise DocumentError([("", f"{what} has other things than layers and activations in {prefix.rstrip('.')}")])
    return [_pair(weights, f"{prefix}{number}", what) for number in sorted(numbers)]


def _pair(weights: Mapping[str, Array], name: str, what: str) -> tuple[Array, Array]:
    """Returns weights and biases of a layer; one without biases has zeros."""
    matrix = weights.get(f"{name}.weight", np.zeros(0))
    biases = weights.get(f"{name}.bias", np.zeros(len(matrix)))
    if matrix.ndim != 2 or biases.shape != (len(matrix),) or not matrix.size:
        raise DocumentError([("", f"{what} has no layer in {name}: {matrix.shape} weights, {biases.shape} biases")])
    if not (np.isfinite(matrix).all() and np.isfinite(biases).all()):
        raise DocumentError([("", f"{what} has numbers in {name} that are not finite: its training has diverged")])
    return matrix, biases


def _cut_off(before: tuple[Array, Array], limit: float, after: Layer) -> list[Layer]:
    """Returns two layers as one whose sums are cut off at -limit and limit goes into another.

    Cut off, a sum s is relu(s + limit) - relu(s - limit) - limit, so that two units stand for it.
    """
    (weights, biases), (outer, rest, activation) = before, after
    first = np.concatenate([weights, weights]), np.concatenate([biases + limit, biases - limit]), "relu"
    rest = rest - limit * np.add.accumulate(outer, axis=1)[:, -1]
    return [first, (np.concatenate([outer, -outer], axis=1), rest, activation)]


def _positive(value: Any, what: str) -> float:
    """Returns a number.

    Raises:
        DocumentError: It is none that is positive and finite.
    """
    if type(value) not in (int, float) or not 0.0 < value < np.inf:
        raise DocumentError([("", f"{what} is no positive number")])
    return float(value)


# -- normalisation ----------------------------------------------------------------------------------------------------


def _normalised(path: Path, layers: list[Layer]) -> list[Layer]:
    """Returns layers that first do to observations what `VecNormalize` did: shift, scale, and cut off.

    Raises:
        DocumentError: The file is none of `VecNormalize`, or of other observations.
    """
    statistics = read_pickle(_read(path, _MOST_STATISTICS), str(path))
    known = isinstance(statistics, Thing) and statistics.name.endswith(".vec_normalize.VecNormalize")
    state = statistics.state if known and isinstance(statistics.state, dict) else None
    if state is None:
        raise DocumentError([("", f"{path} is no file of VecNormalize")])
    if state.get("norm_obs") is False:
        return layers
    moments = getattr(state.get("obs_rms"), "state", None)
    if not isinstance(moments, dict):
        raise DocumentError([("", f"{path} does not say how observations were normalised")])
    mean, variance = (array_of(moments.get(name), f"{path}: {name}") for name in ("mean", "var"))
    inputs = layers[0][0].shape[1]
    if not mean.shape == variance.shape == (inputs,):
        words = f"{path} is about observations of shape {mean.shape}, and the policy sees {inputs} numbers"
        raise DocumentError([("", words)])
    if not (np.isfinite(mean).all() and np.isfinite(variance).all() and (variance >= 0.0).all()):
        raise DocumentError([("", f"{path} holds means and variances that are none")])
    scale = 1.0 / np.sqrt(variance + _positive(state.get("epsilon"), f"{path}: epsilon"))
    limit = _positive(state.get("clip_obs"), f"{path}: clip_obs")
    return [*_cut_off((np.diag(scale), -mean * scale), limit, layers[0]), *layers[1:]]
