"""ONNX models as brains: what they compute, and which are refused."""

from __future__ import annotations

import base64
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest

from brain_documents import DT, MOTORS, SENSORS, load
from nmes.brain import Brain, load_brain
from nmes.errors import DocumentError
from onnx_models import DOUBLE, FLOAT, INT64, field, layer, model, node, tensor, value_info

W = np.array([[0.5, -1], [1, 0.25], [2, -0.125]])
B = np.array([0.25, -0.5])


def document(made: bytes, **more: Any) -> dict[str, Any]:
    names = {"inputs": ["hip.*", "root.up.y", "foot.contact"], "outputs": ["tail", "hip_*"]}
    return {"kind": "onnx", "model": base64.b64encode(made).decode(), **names, **more}


def onnx(made: bytes) -> Brain:
    brain = load(document(made))
    brain.reset(0, DT)
    return brain


@pytest.mark.parametrize("kind", [FLOAT, DOUBLE])
@pytest.mark.parametrize("shape", [[1, 3], [3], ["batch", "width"]])
def test_a_model_is_run_with_named_inputs_and_outputs(kind: int, shape: list[int | str]) -> None:
    brain = onnx(layer(W, B, kind=kind, shape=shape))
    values = np.array([0.5, 0.25, 99, -1, 0.125])
    tail, hips = np.tanh(np.array([0.75, -1, 0.125]) @ W + B)
    np.testing.assert_allclose(brain.step(values), [0, hips, hips, 0, tail], atol=1e-6)
    assert not brain.open_loop


@pytest.mark.parametrize("way", ["raw", "packed", "loose"])
def test_the_weights_of_a_model_are_the_parameter_vector(way: str) -> None:
    brain = onnx(layer(W, B, way=way))
    vector = brain.to_vector()
    np.testing.assert_array_equal(vector, [*W.ravel(), *B])
    changed = brain.with_vector(vector * 2 + 1)
    np.testing.assert_array_equal(changed.to_vector(), vector * 2 + 1)
    assert changed.document["model"] == document(layer(W * 2 + 1, B * 2 + 1, way=way))["model"]
    changed.reset(0, DT)
    expected = onnx(layer(W * 2 + 1, B * 2 + 1)).step(np.ones(5))
    np.testing.assert_array_equal(changed.step(np.ones(5)), expected)


@pytest.mark.parametrize("odd", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("kind", [FLOAT, DOUBLE])
def test_tensors_with_what_is_no_finite_number_are_no_parameters(kind: int, odd: float) -> None:
    made = model(
        [node("MatMul", ["x", "w"], ["m"]), node("Min", ["m", "most"], ["y"])],
        [tensor("w", W, kind), tensor("most", [[odd, 0.25]], kind)],
        [value_info("x", kind, [1, 3])],
        [value_info("y", kind, [1, 2])],
    )
    brain = onnx(made)
    assert brain.to_vector().tolist() == W.ravel().tolist()
    same, other = brain.with_vector(brain.to_vector()), brain.with_vector(np.zeros(6))
    assert same.document == brain.document and other.document != brain.document
    assert other.form() == brain.form()


def test_numbers_beyond_the_bounds_of_a_parameter_are_none() -> None:
    brain = onnx(layer(W * 1e300, B, kind=DOUBLE))
    assert brain.to_vector().tolist() == B.tolist()
    assert brain.with_vector(brain.to_vector()).document == brain.document


def test_whole_numbers_of_a_model_are_no_parameters() -> None:
    made = model(
        [node("Reshape", ["x", "shape"], ["y"])],
        [tensor("shape", [2], INT64)],
        [value_info("x", FLOAT, [1, 2])],
        [value_info("y", FLOAT, [2])],
    )
    brain = load(document(made, inputs=["hip.position", "root.up.y"]))
    assert brain.to_vector().shape == (0,)
    brain.reset(0, DT)
    assert brain.step(np.array([0.5, 0, 0, -3, 0])).tolist() == [0, -1, -1, 0, 0.5]


def averaging(*shape: int) -> bytes:
    """Returns a model with one output, the mean of its inputs."""
    inputs, outputs = value_info("x", FLOAT, [*shape]), value_info("y", FLOAT, [1, 1])
    return model([node("ReduceMean", ["x"], ["y"])], [], [inputs], [outputs])


def test_outputs_that_are_nan_become_0_and_large_ones_are_clipped() -> None:
    made = model([node("Log", ["x"], ["y"])], [], [value_info("x", FLOAT, [1, 2])], [value_info("y", FLOAT, [1, 2])])
    brain = load(document(made, inputs=["hip.position", "root.up.y"]))
    brain.reset(0, DT)
    assert brain.step(np.array([-1.0, 0, 0, 0, 0])).tolist() == [0, -1, -1, 0, 0]


RANDOM = model(
    [node("RandomNormalLike", ["x"], ["y"])], [], [value_info("x", FLOAT, [1, 3])], [value_info("y", FLOAT, [1, 2])]
)
# The same, in the body of a function of the model's.
HIDDEN = model([], [], [], []) + field(25, field(1, "f") + field(7, node("Bernoulli", ["x"], ["y"])))
NESTED = node("If", ["x"], ["y"], field(5, field(1, "then_branch") + field(6, field(1, node("Multinomial", [], [])))))
TRAINING = node("Dropout", ["x", "", "training"], ["y"])
# The number of the field with the operator's name has 33 bits, which onnxruntime cuts off after 32.
OVERLONG = field(1, "x") + field(2, "y") + b"\xa2\x80\x80\x80\x10" + field(4, "RandomNormalLike")[1:]


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (b"junk", "is no ONNX model"),
        (b"", "onnxruntime refuses it"),
        (layer(W, B)[:-20], "is no ONNX model: a field is longer than what holds it"),
        (b"\xff" * 20, "is no ONNX model: a number has no end"),
        (b"\x0b", "is no ONNX model: there is no wire type 3"),
        (field(7, b"")[:1] + b"\x00" + layer(W, B), None),
        (RANDOM, "draws random numbers (RandomNormalLike)"),
        (HIDDEN, "draws random numbers (Bernoulli)"),
        (model([NESTED], [], [], []), "draws random numbers (Multinomial)"),
        (model([node("Sampling", [], [])], [], [], []), "draws random numbers (Sampling)"),
        (model([TRAINING], [], [], []), "draws random numbers (Dropout)"),
        (model([OVERLONG], [], [], []), "is no ONNX model: there is no field 536870916"),
        (layer(W, B, way="external"), "keeps numbers in other files"),
        (averaging(1, 10**12), "has 1000000000000 inputs, and there must be 3, one for each entry of inputs"),
        (averaging(10**8, 10**12), "has 100000000000000000000 inputs, and there must be 3"),
        (layer(W[:2], B), "has 2 inputs, and there must be 3, one for each entry of inputs"),
        (layer(W[:, :1], B[:1]), "has 1 outputs, and there must be 2, one for each entry of outputs"),
        (
            model([node("Identity", ["x"], ["y"])], [], [value_info("x", INT64, [3])], [value_info("y", INT64, [3])]),
            "must have one tensor of floats or doubles for its inputs, has x: tensor(int64)",
        ),
        (
            model(
                [node("Reshape", ["x", "shape"], ["y"])],
                [tensor("shape", [7], INT64)],
                [value_info("x", FLOAT, ["some", 3])],
                [value_info("y", FLOAT, ["any"])],
            ),
            "fails on inputs of 0",
        ),
    ],
)
def test_an_unsuitable_model_is_refused(made: bytes, words: str | None, capfd: pytest.CaptureFixture[str]) -> None:
    if words is None:  # a message may come in parts
        load(document(made))
        return
    with pytest.raises(DocumentError) as caught:
        load(document(made))
    assert any(path == "brain/model" and words in message for path, message in caught.value.problems), (
        caught.value.problems
    )
    assert capfd.readouterr() == ("", "")


def test_a_dropout_that_knows_no_training_does_nothing() -> None:
    made = model(
        [node("Dropout", ["x", "ratio"], ["y"])],
        [tensor("ratio", 0.5)],
        [value_info("x", FLOAT, [1, 2])],
        [value_info("y", FLOAT, [1, 2])],
    )
    brain = load(document(made, inputs=["hip.position", "root.up.y"]))
    brain.reset(0, DT)
    assert brain.step(np.array([0.5, 0, 0, -0.25, 0])).tolist() == [0, -0.25, -0.25, 0, 0.5]


def test_a_model_in_onnxruntime_s_own_format_is_refused_unread(tmp_path: Path) -> None:
    options = onnxruntime.SessionOptions()
    options.optimized_model_filepath = str(tmp_path / "model.ort")
    options.log_severity_level = 4
    options.add_session_config_entry("session.save_model_format", "ORT")
    sides = [[value_info(name, FLOAT, [1, 3])] for name in "xy"]
    onnxruntime.InferenceSession(model([node("RandomNormalLike", ["x"], ["y"])], [], *sides), options)
    made = as_protobuf((tmp_path / "model.ort").read_bytes())
    onnxruntime.InferenceSession(made)  # which left alone takes it
    with pytest.raises(DocumentError, match="brain/model: onnxruntime refuses it"):
        load(document(made))


def as_protobuf(table: bytes) -> bytes:
    """Returns a model in onnxruntime's own format, a FlatBuffer, as one that is a message of Protobuf too.

    Such a file begins with where its root lies: that is put where its bytes are a field's, and so on to one that is as
    long as all the rest.
    """
    root, room = 0x8018, 0x8100
    (before,) = struct.unpack_from("<I", table)
    (back,) = struct.unpack_from("<i", table, before)
    (end,) = struct.unpack_from("<H", table, before - back)
    made = bytearray(struct.pack("<I", root) + table[4:8] + bytes(room) + table[8:])
    struct.pack_into("<i", made, root, root - (before - back + room))
    for (slot,) in struct.iter_unpack("<H", table[before - back + 4 : before - back + end]):
        if slot:  # else the root leaves that out
            (to,) = struct.unpack_from("<I", table, before + slot)
            struct.pack_into("<I", made, root + slot, before + room + to - root)
    rest = len(made) - 95
    made[91:95] = bytes([2 << 3 | 2, rest & 127 | 128, rest >> 7 & 127 | 128, rest >> 14])
    return bytes(made)


def test_a_deeply_nested_model_is_refused() -> None:
    inner = b""
    for _ in range(2000):
        inner = field(5, field(6, field(1, inner)))
    with pytest.raises(DocumentError, match="nested too deeply"):
        load(document(field(7, field(1, inner))))


def test_a_model_must_be_base64() -> None:
    with pytest.raises(DocumentError, match="brain/model: is not base64"):
        load_brain({"kind": "onnx", "model": "***"}, SENSORS, MOTORS)


def test_without_onnxruntime_the_error_names_the_extra() -> None:
    program = f"""
import sys
sys.modules["onnxruntime"] = None
from nmes.brain import load_brain
from nmes.errors import NmesError
try:
    load_brain({document(layer(W, B))!r}, {SENSORS!r}, {MOTORS!r})
except NmesError as error:
    print(error.code, error)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "missing_package an onnx brain needs onnxruntime: pip install 'nmes[onnx]'\n"
