"""Policies of Stable-Baselines3 as brains, from files that are not trusted (`tools/policies.py` made the good ones)."""

from __future__ import annotations

import io
import json
import os
import pickle
import random
import subprocess
import sys
import zipfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from creatures import snake
from layout import ROOT
from nmes.brain import load_brain
from nmes.cli import main
from nmes.errors import DocumentError
from nmes.evaluation import Task, evaluate
from nmes.genome import Genome
from nmes.learning.stable_baselines import read_policy

POLICIES = ROOT / "tests/learning/policies"
NAMES = ("a2c", "ddpg", "ppo", "ppo-normalised", "ppo-relu", "ppo-squashed", "sac", "sac-sde", "td3")
CREATURE = Genome(
    {
        **snake(None),
        "sensors": [{"type": kind, "joint": "*"} for kind in ("position", "velocity")]
        + [{"type": "height", "cube": f"c{index}"} for index in range(2)],
    }
)


@cache
def expected() -> dict[str, Any]:
    found: dict[str, Any] = json.loads((POLICIES / "expected.json").read_text())
    return found


def run(*arguments: str | Path) -> tuple[int, str]:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, result.output


@pytest.fixture
def creature(tmp_path: Path) -> Path:
    path = tmp_path / "creature.json"
    path.write_text(json.dumps(CREATURE.document))
    return path


def controls(genome: Genome, observations: Any) -> Any:
    brain = genome.brain()
    brain.reset(0, 1 / 60)
    return np.array([brain.step(np.array(observation)).copy() for observation in observations])


@pytest.mark.parametrize("name", NAMES)
def test_a_brain_does_what_the_policy_does(name: str, creature: Path, tmp_path: Path) -> None:
    normalised: list[str | Path] = (
        ["--vec-normalize", POLICIES / f"{name}.pkl"] if (POLICIES / f"{name}.pkl").exists() else []
    )
    arguments: list[str | Path] = [
        POLICIES / f"{name}.zip",
        "--genome",
        creature,
        *normalised,
        "-o",
        tmp_path / "trained.json",
    ]
    code, output = run("genome", "from-sb3", *arguments)
    assert code == 0 and output.startswith(f"wrote {tmp_path / 'trained.json'}: snake with the policy of "), output
    trained = Genome.load(tmp_path / "trained.json")
    assert trained.document["parents"] == [CREATURE.hash] and trained.body == CREATURE.body
    wanted = np.array(expected()[name]["actions"])
    assert np.abs(controls(trained, expected()[name]["observations"]) - wanted).max() < 1e-6
    assert np.ptp(wanted, axis=0).min() > 0.4  # else any brain would do
    assert evaluate(trained, Task.load("walk"), seeds=[1]).score is not None


def test_statistics_of_observations_count(creature: Path) -> None:
    code, output = run("genome", "from-sb3", POLICIES / "ppo-normalised.zip", "--genome", creature)
    assert code == 0
    given = expected()["ppo-normalised"]
    assert np.abs(controls(Genome(json.loads(output)), given["observations"]) - given["actions"]).max() > 0.1


def test_no_torch_is_needed() -> None:
    program = "import sys; from nmes.learning.stable_baselines import read_policy\n"
    program += "sys.modules.update(torch=None, stable_baselines3=None, gymnasium=None, cloudpickle=None)\n"
    program += "read_policy(sys.argv[1], sys.argv[2])"
    files = [str(POLICIES / f"ppo-normalised.{ending}") for ending in ("zip", "pkl")]
    assert subprocess.run([sys.executable, "-c", program, *files]).returncode == 0


# -- what is no policy, or none for that creature ---------------------------------------------------------------------


def entries(name: str) -> dict[str, bytes]:
    with zipfile.ZipFile(POLICIES / f"{name}.zip") as archive:
        return {entry: archive.read(entry) for entry in archive.namelist()}


def zipped(parts: dict[str, bytes], packed: int = zipfile.ZIP_STORED) -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", packed) as archive:
        for name, data in parts.items():
            archive.writestr(name, data)
    return out.getvalue()


def settings(name: str = "ppo", **changes: Any) -> bytes:
    """Returns a model's file with other settings."""
    parts = entries(name)
    told = json.loads(parts["data"])
    for key, value in changes.items():
        told[key] = {**told.get(key, {}), **value} if isinstance(value, dict) else value
    return zipped({**parts, "data": json.dumps(told).encode()})


def tensors(pickled: bytes | None = None, name: str = "ppo", parts: dict[str, bytes] | None = None) -> bytes:
    """Returns a model's file with other parts of its tensors; `pickled` is what says what they are."""
    model = entries(name)
    with zipfile.ZipFile(io.BytesIO(model["policy.pth"])) as archive:
        inner = {entry: archive.read(entry) for entry in archive.namelist()}
    (table,) = [entry for entry in inner if entry.endswith("/data.pkl")]
    folder = table.removesuffix("data.pkl")
    inner |= {} if pickled is None else {table: pickled}
    inner |= {folder + entry: data for entry, data in (parts or {}).items()}
    return zipped({**model, "policy.pth": zipped(inner)})


def without(entry: str) -> bytes:
    parts = entries("ppo")
    del parts[entry]
    return zipped(parts)


REFUSED: dict[str, tuple[Callable[[], bytes], str]] = {
    "choices": (lambda: (POLICIES / "choices.zip").read_bytes(), "chooses among actions"),
    "an activation": (lambda: (POLICIES / "ppo-elu.zip").read_bytes(), "has the activation ELU"),
    "a policy of its own": (lambda: settings(policy_class={"__module__": "mine"}), "a policy of its own, from mine"),
    "an extractor": (
        lambda: settings(policy_kwargs={"features_extractor_class": "<class 'mine.Eye'>"}),
        "looks through Eye",
    ),
    "other bounds": (lambda: settings(action_space={"high": "[2. 1. 1.]"}), "acts within high [2. 1. 1.]"),
    "settings that are none": (lambda: zipped({**entries("ppo"), "data": b"{"}), "does not say what it is"),
    "settings that are a list": (lambda: zipped({**entries("ppo"), "data": b"[]"}), "does not say what it is"),
    "deep settings": (lambda: zipped({**entries("ppo"), "data": b"[" * 10**6}), "does not say what it is"),
    "no settings": (lambda: without("data"), "has no data"),
    "no policy": (lambda: without("policy.pth"), "has no policy.pth"),
    "no zip file": (lambda: b"not a zip file", "is no zip file"),
    "nothing": (lambda: b"", "is no zip file"),
    "tensors of the old format": (lambda: zipped({**entries("ppo"), "policy.pth": b"\x80\x02."}), "is no zip file"),
    "a cut clip of the mean": (
        lambda: settings("sac-sde", policy_kwargs={"clip_mean": -1.0}),
        "clip_mean is no positive number",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_no_brain_can_be_is_refused(case: str, creature: Path, tmp_path: Path) -> None:
    make, words = REFUSED[case]
    (tmp_path / "model.zip").write_bytes(make())
    arguments: list[str | Path] = [tmp_path / "model.zip", "--genome", creature, "-o", tmp_path / "out.json"]
    code, output = run("genome", "from-sb3", *arguments)
    assert code == 1 and output.startswith("Error: ") and words in output, output
    assert not (tmp_path / "out.json").exists()


def test_a_policy_of_another_creature_is_refused(tmp_path: Path) -> None:
    code, output = run("genome", "from-sb3", POLICIES / "ppo.zip", "--genome", "walker", "-o", tmp_path / "out.json")
    assert code == 1 and "sees 8 numbers, and walker has 26 sensors" in output
    more = {**CREATURE.document, "body": snake(segments=5)["body"]}
    more["sensors"] = [{"type": "position", "joint": "*"}, {"type": "velocity", "cube": "c0"}]
    more["sensors"].append({"type": "height", "cube": "c0"})
    (tmp_path / "more.json").write_text(json.dumps(more))
    code, output = run("genome", "from-sb3", POLICIES / "ppo.zip", "--genome", tmp_path / "more.json")
    assert code == 1 and "does 3 numbers, and snake has 4 motors" in output, output
    code, output = run("genome", "from-sb3", tmp_path / "none.zip", "--genome", "walker")
    assert code == 2 and "does not exist" in output


# -- files that mean harm ---------------------------------------------------------------------------------------------


def table(name: str = "ppo") -> bytes:
    """Returns the pickle that says what a policy's tensors are."""
    with zipfile.ZipFile(io.BytesIO(entries(name)["policy.pth"])) as archive:
        (entry,) = [entry for entry in archive.namelist() if entry.endswith("/data.pkl")]
        return archive.read(entry)


class Call:
    """What pickles as a call of anything."""

    def __init__(self, function: Callable[..., Any], *arguments: Any) -> None:
        self.call = function, arguments

    def __reduce__(self) -> Any:
        return self.call


def storage(count: bytes = b"K\x30", key: bytes = b"0", kind: bytes = b"FloatStorage") -> bytes:
    """Returns the opcodes of a storage."""
    size, text = bytes([len(key)]), b"X\x07\x00\x00\x00storage"
    return b"(" + text + b"ctorch\n" + kind + b"\nX" + size + b"\0\0\0" + key + b"X\x03\0\0\0cpu" + count + b"tQ"


def tensor(shape: bytes, strides: bytes, offset: bytes = b"K\x00", **of: bytes) -> bytes:
    """Returns a pickle of the policy's last biases alone, as a tensor with the opcodes of its parts."""
    name = b"X\x0f\x00\x00\x00action_net.bias"
    built = b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage(**of) + offset + shape + strides + b"\x89NtR"
    return b"\x80\x02}" + name + built + b"s."


def many(count: int) -> bytes:
    """Returns tensors by many names, each of which is a number of one storage of a megabyte."""
    one = b"ctorch._utils\n_rebuild_tensor_v2\n(" + storage(key=b"0") + b"K\x00K\x01\x85K\x01\x85\x89NtR"
    named = b"".join(b"X\x0a\0\0\0actor.%04d" % index + one + b"s" for index in range(count))
    return zipped({"m/data.pkl": b"\x80\x02}" + named + b".", "m/data/0": bytes(2**20)}, zipfile.ZIP_DEFLATED)


HOSTILE: dict[str, tuple[Callable[[], bytes], str]] = {
    "no pickle": (lambda: tensors(b"what is this"), "is no sound pickle"),
    "an empty pickle": (lambda: tensors(b""), "is no sound pickle"),
    "a list": (lambda: tensors(pickle.dumps([1, 2])), "holds no dictionary of tensors"),
    "numbers for names": (lambda: tensors(pickle.dumps({1: 2})), "holds no dictionary of tensors"),
    "a text for a tensor": (lambda: tensors(pickle.dumps({"log_std": "wide"})), "is no plain tensor"),
    "a storage that is none": (
        lambda: tensors(b"\x80\x02}X\x07\0\0\0log_stdctorch._utils\n_rebuild_tensor_v2\n(K\x00K\x00))tRs."),
        "is no plain tensor",
    ),
    "memory for a billion": (lambda: tensors(b"\x80\x02]r\xff\xff\xff\x7f."), "holds no dictionary"),
    "a text of exabytes": (lambda: tensors(b"\x80\x04\x8d" + b"\xff" * 7 + b"\x0fx."), "is no sound pickle"),
    "a number of a million digits": (lambda: tensors(b"I" + b"9" * 10**6 + b"\n."), "is no sound pickle"),
    "a name by number": (lambda: tensors(b"\x80\x02\x82\x01."), "it names a thing by the number 1"),
    "thousands of names": (
        lambda: tensors(b"".join(b"cm\nn%d\n0" % index for index in range(2000)) + b"N."),
        "names more than 1,000 things",
    ),
    "tuples within tuples": (lambda: tensors(b"\x80\x02})" + b"\x85" * 300_000 + b"Ns."), "neither text nor number"),
    "a set of tuples": (lambda: tensors(b"\x80\x04\x8f()" + b"\x85" * 300_000 + b"\x90."), "it has a set"),
    "a name of thousands": (lambda: tensors(pickle.dumps({"actor." * 1000: 1})), "a name of 6,000 characters"),
    "one storage for thousands": (
        lambda: zipped({**entries("ppo"), "policy.pth": many(2000)}, zipfile.ZIP_DEFLATED),
        "more than",
    ),
    "a locked entry": (
        lambda: tensors().replace(b"PK\x01\x02\x14\x03\x14\0\0", b"PK\x01\x02\x14\x03\x14\0\1"),
        "packed",
    ),
    "a pickle of megabytes": (lambda: tensors(b"]" * 2**21), "more than 1,048,576 bytes"),
    "a tensor of exabytes": (
        lambda: tensors(tensor(b"J\xff\xff\xff\x7fJ\xff\xff\xff\x7f\x86", b"K\1K\1\x86")),
        "is no",
    ),
    "a tensor of fewer": (lambda: tensors(tensor(b"K\xff\x85", b"K\x01\x85")), "and its shape needs"),
    "an offset before its bytes": (
        lambda: tensors(tensor(b"K\3\x85", b"K\1\x85", b"J\xff\xff\xff\xff")),
        "is no tensor",
    ),
    "columns": (lambda: tensors(tensor(b"K\2K\2\x86", b"K\1K\2\x86")), "does not lie row by row"),
    "strides that are none": (lambda: tensors(tensor(b"K\2\x85", b"N")), "does not lie row by row"),
    "a shape that is none": (lambda: tensors(tensor(b"N", b"N")), "is no tensor"),
    "whole numbers": (lambda: tensors(tensor(b"K\2\x85", b"K\1\x85", kind=b"LongStorage")), "is no tensor of floats"),
    "a place elsewhere": (lambda: tensors(tensor(b"K\2\x85", b"K\1\x85", key=b"../../x")), "has no "),
    "numbers that are none": (
        lambda: tensors(parts={f"data/{index}": b"\xff" * 4096 for index in range(20)}),
        "are not finite",
    ),
    "another order of bytes": (lambda: tensors(parts={"byteorder": b"big"}), "the other order of bytes"),
    "many packed megabytes": (
        lambda: zipped({**entries("ppo"), "data": b" " * 2**26}, zipfile.ZIP_DEFLATED),
        "more than",
    ),
    "thousands of entries": (
        lambda: zipped({**entries("ppo"), **{str(index): b"" for index in range(6000)}}),
        "has more than 5,000 entries",
    ),
}


@pytest.mark.parametrize("case", HOSTILE)
def test_a_file_that_means_harm_is_refused(case: str, tmp_path: Path) -> None:
    make, words = HOSTILE[case]
    (tmp_path / "model.zip").write_bytes(make())
    with pytest.raises(DocumentError) as info:
        read_policy(tmp_path / "model.zip")
    assert words in info.value.message and str(tmp_path / "model.zip") in info.value.message


@pytest.mark.parametrize("protocol", range(6))
def test_nothing_that_a_file_names_is_called(protocol: int, tmp_path: Path) -> None:
    trace = tmp_path / "was here"
    for call in (Call(Path.mkdir, trace), Call(os.mkdir, str(trace)), Call(eval, "trace.mkdir()", {"trace": trace})):
        harm = pickle.dumps(call, protocol)
        with pytest.raises(DocumentError, match=r"holds no dictionary of tensors|is no sound pickle"):
            (tmp_path / "model.zip").write_bytes(tensors(harm))
            read_policy(tmp_path / "model.zip")
        (tmp_path / "statistics.pkl").write_bytes(harm)
        with pytest.raises(DocumentError, match=r"is no file of VecNormalize|is no sound pickle"):
            read_policy(POLICIES / "ppo-normalised.zip", tmp_path / "statistics.pkl")
        assert not trace.exists()
        pickle.loads(harm)  # that it would
        assert trace.exists()
        trace.rmdir()


def test_statistics_that_are_none_are_refused(tmp_path: Path) -> None:
    good, path = (POLICIES / "ppo-normalised.pkl").read_bytes(), tmp_path / "statistics.pkl"
    mean = good.index(b"mean")
    for data, words in (
        (b"", "is no sound pickle"),
        (pickle.dumps({"obs_rms": None}), "is no file of VecNormalize"),
        (good.replace(b"obs_rms", b"obs_xyz"), "does not say how"),
        (good.replace(b"\x8c\x04mean", b"\x8c\x04meat"), "mean is no array of plain numbers"),
        (good[:mean] + good[mean:].replace(b"K\x08\x85", b"K\x07\x85"), "is no array of plain numbers"),
        (good.replace(b"\x8c\x02f8\x94", b"]]a\x94N0\x94"), "is no"),
        (good.replace(b"epsilon", b"epsilot"), "epsilon is no positive number"),
        (good.replace(b"clip_obsq", b"clip_obtq").replace(b"clip_obs\x94", b"clip_obt\x94"), "clip_obs is no positive"),
    ):
        assert data != good
        path.write_bytes(data)
        with pytest.raises(DocumentError) as info:
            read_policy(POLICIES / "ppo-normalised.zip", path)
        assert words in info.value.message and str(path) in info.value.message, info.value.message
    with pytest.raises(DocumentError, match=r"of shape \(8,\), and the policy sees 3 numbers"):
        read_policy(narrow(tmp_path), POLICIES / "ppo-normalised.pkl")


def narrow(folder: Path) -> Path:
    """Returns a policy that sees three numbers and does three: one layer."""
    data = tensor(b"K\3\x85", b"K\1\x85").removesuffix(b"s.")
    weights = (
        tensor(b"K\3K\3\x86", b"K\3K\1\x86")
        .removeprefix(b"\x80\x02}")
        .replace(b"X\x0f\x00\x00\x00action_net.bias", b"X\x11\x00\x00\x00action_net.weight")
    )
    spread = weights.replace(b"X\x11\x00\x00\x00action_net.weight", b"X\x07\x00\x00\x00log_std").removesuffix(b".")
    path = folder / "narrow.zip"
    path.write_bytes(tensors(data + b"s" + spread + weights, "a2c", {"data/0": np.ones(48, np.float32).tobytes()}))
    return path


def test_damaged_files_never_do_worse_than_be_refused(tmp_path: Path) -> None:
    """Of bytes that were changed here and there, what is read is a policy of that form, or none."""
    draw, path, refused = random.Random(1), tmp_path / "model.zip", 0
    pickled, shapes = table(), [(each[0].shape, each[2]) for each in read_policy(POLICIES / "ppo.zip")]
    for _ in range(200):
        changed = bytearray(pickled)
        for _ in range(draw.choice((1, 1, 2, 8))):
            changed[draw.randrange(len(changed))] = draw.randrange(256)
        path.write_bytes(tensors(bytes(changed)))
        try:
            layers = read_policy(path)
        except DocumentError:
            refused += 1
            continue
        assert layers[-1][0].shape[0] <= 6 and all(np.isfinite(weights).all() for weights, _, _ in layers)
        assert len(layers) <= len(shapes)
        load_brain(
            {
                "kind": "mlp",
                "layers": [{"weights": w.tolist(), "biases": b.tolist(), "activation": a} for w, b, a in layers],
            },
            [f"s{index}" for index in range(layers[0][0].shape[1])],
            [f"m{index}" for index in range(layers[-1][0].shape[0])],
        )
    assert 50 < refused < 200
    whole = (POLICIES / "ppo-normalised.pkl").read_bytes()
    for _ in range(100):
        changed = bytearray(whole)
        changed[draw.randrange(len(changed))] = draw.randrange(256)
        path.write_bytes(changed)
        try:
            read_policy(POLICIES / "ppo-normalised.zip", path)
        except DocumentError:
            refused += 1
