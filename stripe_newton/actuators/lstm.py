# SPDX-License-Identifier: Apache-2.0
"""LSTM networks of torch as ONNX files that ``newton.actuators.DriveNeuralLSTM`` reads."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

__all__ = ["LSTM_NAMES", "lstm_model", "with_metadata"]

LSTM_NAMES = ("input_name", "hidden_in_name", "cell_in_name"), ("output_name", "hidden_out_name", "cell_out_name")
"""Metadata that say which inputs and outputs are which."""


def with_metadata(model: onnx.ModelProto, metadata: dict[str, Any]) -> onnx.ModelProto:
    """``model`` with its metadata replaced."""
    del model.metadata_props[:]
    helper.set_model_props(model, {"metadata": json.dumps(metadata)})
    return model


def lstm_model(network: Any, path: Path) -> onnx.ModelProto:
    """An LSTM of any number of layers and the linear layer after it, as ONNX.

    Newton's drive knows one memory for hidden states and one for cells: those of the layers stand side by side in it,
    and are taken out and put back by multiplication with parts of the unit matrix.
    """
    weights = {name: value.detach().double().numpy() for name, value in network.state_dict().items()}
    layers: list[list[Any]] = []
    while (names := [n for n in weights if n.endswith(f"weight_ih_l{len(layers)}")]) and len(names) == 1:
        keys = (names[0].replace("weight_ih", part) for part in ("weight_ih", "weight_hh", "bias_ih", "bias_hh"))
        layers.append([weights.pop(key, None) for key in keys])
    matrices = [value for value in weights.values() if value.ndim == 2]
    if not layers or layers[0][0].shape[1] != 2 or len(matrices) != 1 or matrices[0].shape[0] != 1 or len(weights) > 2:
        there = ", ".join(f"{n} {tuple(v.shape)}" for n, v in network.state_dict().items()) or "no weights"
        raise ValueError(
            f"network_file '{path}': must be one LSTM with two inputs (position error, velocity), in one direction, "
            f"followed by one linear layer with one output; it has {there}"
        )
    bias = next((value for value in weights.values() if value.ndim == 1), np.zeros(1))
    model = _lstm_graph(layers, matrices[0], bias)
    _compare(model, network, len(layers), layers[0][1].shape[1], path)
    return model


def _lstm_graph(layers: list[list[Any]], head: np.ndarray, bias: np.ndarray) -> onnx.ModelProto:
    hidden = layers[0][1].shape[1]
    width = hidden * len(layers)
    nodes, constants = [], []

    def constant(name: str, value: np.ndarray) -> str:
        constants.append(numpy_helper.from_array(np.ascontiguousarray(value, dtype=np.float32), name))
        return name

    def add(kind: str, inputs: list[str], outputs: list[str], **attributes: Any) -> str:
        nodes.append(helper.make_node(kind, inputs, outputs, **attributes))
        return outputs[-1]

    value, states = "input", {"h": "", "c": ""}
    for k, (w, r, bw, br) in enumerate(layers):
        gates = [np.concatenate([np.split(x, 4)[i] for i in (0, 3, 1, 2)]) for x in (w, r)]  # i f g o -> i o f g
        both = [np.concatenate([np.split(x if x is not None else np.zeros(4 * hidden), 4)[i] for i in (0, 3, 1, 2)])
                for x in (bw, br)]  # fmt: skip
        part = np.eye(width)[:, k * hidden : (k + 1) * hidden]
        single = len(layers) == 1
        names = [n if single else add("MatMul", [n, constant(f"take_{n}{k}", part)], [f"{n}{k}"]) for n in ("h", "c")]
        arrays = [constant(f"{n}{k}", x[None]) for n, x in zip("wr", gates, strict=True)]
        arrays += [constant(f"b{k}", np.concatenate(both)[None]), ""]
        outputs = ["", *(("h_out", "c_out") if single else (f"h_new{k}", f"c_new{k}"))]
        add("LSTM", [value, *arrays, *names], outputs, hidden_size=hidden)
        value = outputs[1]  # a sequence of one step: its last state is its output
        for n in () if single else ("h", "c"):
            put = add("MatMul", [f"{n}_new{k}", constant(f"put_{n}{k}", part.T)], [f"{n}_put{k}"])
            last = f"{n}_out" if k == len(layers) - 1 else f"{n}_sum{k}"
            states[n] = add("Add", [states[n], put], [last]) if states[n] else put
    flat = add("Squeeze", [value, "axis"], ["flat"])
    add("Gemm", [flat, constant("head", head), constant("head_bias", bias)], ["effort"], transB=1)
    constants.append(numpy_helper.from_array(np.array([0], dtype=np.int64), "axis"))
    float32 = TensorProto.FLOAT

    def tensor(name: str, *shape: Any) -> Any:
        return helper.make_tensor_value_info(name, float32, shape)

    graph = helper.make_graph(
        nodes, "actuator",
        [tensor("input", 1, "n", 2), tensor("h", 1, "n", width), tensor("c", 1, "n", width)],
        [tensor("effort", "n", 1), tensor("h_out", 1, "n", width), tensor("c_out", 1, "n", width)],
        constants,
    )  # fmt: skip
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    own_names = [["input", "h", "c"], ["effort", "h_out", "c_out"]]
    metadata: dict[str, Any] = {"model_type": "lstm", "num_layers": 1, "hidden_size": width}
    for keys, own in zip(LSTM_NAMES, own_names, strict=True):
        metadata |= dict(zip(keys, own, strict=True))
    return with_metadata(model, metadata)


def _compare(model: onnx.ModelProto, network: Any, layers: int, hidden: int, path: Path) -> None:
    """Hold the converted network against the original on random numbers."""
    from onnx.reference import ReferenceEvaluator

    rows, rng = 3, np.random.default_rng(0)
    x = rng.normal(size=(rows, 2)).astype(np.float32)
    h, c = rng.normal(size=(2, layers, rows, hidden)).astype(np.float32)

    def flat(state: np.ndarray) -> np.ndarray:
        return np.concatenate(list(state), axis=1)[None]

    mine = ReferenceEvaluator(model).run(None, {"input": x[None], "h": flat(h), "c": flat(c)})
    problems = []
    for order in ((rows, 1, 2), (1, rows, 2)):  # rows or time first
        try:
            with torch.no_grad():
                effort, (h_new, c_new) = network(
                    torch.from_numpy(x).reshape(order), (torch.from_numpy(h), torch.from_numpy(c))
                )
        except Exception as error:
            problems.append(str(error).strip().rsplit("\n", 1)[-1])
            continue
        theirs = effort.reshape(rows, 1).numpy(), flat(h_new.numpy()), flat(c_new.numpy())
        if all(np.allclose(a, b, rtol=1e-4, atol=1e-5) for a, b in zip(mine, theirs, strict=True)):
            return
        problems.insert(0, "the converted network gives something else")
    raise ValueError(
        f"network_file '{path}': it must be effort, (h, c) = net(input, (h, c)) with an LSTM and a linear layer alone, "
        f"and is not: {problems[0]}"
    )
