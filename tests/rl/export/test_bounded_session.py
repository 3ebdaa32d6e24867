# SPDX-License-Identifier: Apache-2.0
"""BoundedSession: a network that does not end, or needs more memory than there is, is an error."""

from __future__ import annotations

import gc
import threading
import time

import numpy as np
import onnx
import pytest
from onnx import TensorProto, helper, numpy_helper

from stripe_newton.rl import CheckpointError
from stripe_newton.rl.export import bounded_session
from stripe_newton.rl.export.bounded_session import BoundedSession

pytest.importorskip("onnxruntime")


def save(path, nodes, constants) -> None:
    """Write a network from ``obs`` to ``actions``, each (batch, 1)."""
    ends = [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", 1]) for name in ("obs", "actions")]
    values = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    graph = helper.make_graph(nodes, "network", ends[:1], ends[1:], values)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    onnx.checker.check_model(model)
    onnx.save(model, path)


def loop(times: int) -> tuple[list, dict]:
    scalar = helper.make_tensor_value_info
    body = helper.make_graph(
        [helper.make_node("Identity", ["go"], ["go_on"]), helper.make_node("Add", ["x", "x"], ["twice"])],
        "body",
        [scalar("i", TensorProto.INT64, []), scalar("go", TensorProto.BOOL, []), scalar("x", TensorProto.FLOAT, None)],
        [scalar("go_on", TensorProto.BOOL, []), scalar("twice", TensorProto.FLOAT, None)],
    )
    node = helper.make_node("Loop", ["times", "always", "obs"], ["actions"], body=body)
    return [node], {"times": np.int64(times), "always": np.bool_(True)}


def test_a_network_that_ends_is_run(tmp_path):
    save(tmp_path / "a.onnx", *loop(3))
    session = BoundedSession(tmp_path / "a.onnx", "cpu")
    assert session.run(["actions"], {"obs": np.ones((2, 1), dtype=np.float32)})[0].tolist() == [[8.0], [8.0]]
    del session
    gc.collect()
    deadline = time.monotonic() + 20.0
    while "bounded_session" in [t.name for t in threading.enumerate()] and time.monotonic() < deadline:
        time.sleep(0.1)
    assert "bounded_session" not in [t.name for t in threading.enumerate()]


def test_a_loop_without_end_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(bounded_session, "LONGEST_S", 0.2)
    monkeypatch.setattr(bounded_session, "_LOOKS_S", 0.05)
    save(tmp_path / "a.onnx", *loop(10**15))
    session = BoundedSession(tmp_path / "a.onnx", "cpu")
    with pytest.raises(CheckpointError, match=r"a.onnx: its network takes more than 0.2 s for a step"):
        session.run(["actions"], {"obs": np.zeros((2, 1), dtype=np.float32)})


def test_too_much_memory_is_an_error_of_the_file(tmp_path):
    nodes = [
        helper.make_node("ConstantOfShape", ["size"], ["large"]),
        helper.make_node("ReduceSum", ["large"], ["sum"], keepdims=0),
        helper.make_node("Add", ["obs", "sum"], ["actions"]),
    ]
    save(tmp_path / "a.onnx", nodes, {"size": np.array([10**7, 10**7])})
    session = BoundedSession(tmp_path / "a.onnx", "cpu")
    with pytest.raises(CheckpointError, match=r"a.onnx: onnxruntime cannot run it"):
        session.run(["actions"], {"obs": np.zeros((2, 1), dtype=np.float32)})
