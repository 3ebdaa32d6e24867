# SPDX-License-Identifier: Apache-2.0
"""LSTM conversion: LSTM networks of torch as ONNX files that ``newton.actuators.DriveNeuralLSTM`` reads."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

__all__ = ["LSTM_NAMES", "lstm_model", "with_metadata"]

LSTM_NAMES = ("input_name", "hidden_in_name", "cell_in_name"), ("output_name", "hidden_out_name", "cell_out_name")
"""Metadata that say which inputs and outputs are which."""

_GATES = (0, 3, 1, 2)
"""ONNX's order of gates (input, output, forget, cell) among torch's (input, forget, cell, output)."""


def with_metadata(model: onnx.ModelProto, metadata: Mapping[str, object]) -> onnx.ModelProto:
    """``model`` with its metadata replaced."""
    del model.metadata_props[:]
    helper.set_model_props(model, {"metadata": json.dumps(dict(metadata))})
    return model


@dataclass
class _Layer:
    """Weights of a layer, the gates one below the other in ONNX's order, shapes ``(4 * hidden, ...)``."""

    inputs: np.ndarray
    hidden: np.ndarray
    input_bias: np.ndarray
    hidden_bias: np.ndarray

    @classmethod
    def from_torch(cls, weights: dict[str, np.ndarray], name: str) -> _Layer:
        """Take a layer out of the weights of a network; ``name`` is that of its ``weight_ih``."""
        matrices = [weights.pop(name), weights.pop(name.replace("weight_ih", "weight_hh"))]
        none = np.zeros(len(matrices[0]))
        biases = [weights.pop(name.replace("weight_ih", bias), none) for bias in ("bias_ih", "bias_hh")]
        return cls(*(np.concatenate([np.split(x, 4)[i] for i in _GATES]) for x in (*matrices, *biases)))


def lstm_model(network: torch.jit.ScriptModule, path: Path) -> onnx.ModelProto:
    """An LSTM of any number of layers and the linear layer after it, as ONNX.

    Newton's drive has one memory for hidden states and one for cells: those of the layers lie side by side in it, and
    are taken out and put back by multiplication with parts of the identity matrix.

    Raises:
        ValueError: if it is another network.
    """
    weights = {name: value.detach().double().numpy() for name, value in network.state_dict().items()}
    layers: list[_Layer] = []
    while (names := [n for n in weights if n.endswith(f"weight_ih_l{len(layers)}")]) and len(names) == 1:
        layers.append(_Layer.from_torch(weights, names[0]))
    matrices = [value for value in weights.values() if value.ndim == 2]
    two_inputs = bool(layers) and layers[0].inputs.shape[1] == 2
    one_output = len(matrices) == 1 and matrices[0].shape[0] == 1 and len(weights) <= 2
    if not (two_inputs and one_output):
        there = ", ".join(f"{n} {tuple(v.shape)}" for n, v in network.state_dict().items()) or "no weights"
        raise ValueError(
            f"network_file '{path}': must be one LSTM with two inputs (position error, velocity), in one direction, "
            f"followed by one linear layer with one output; it has {there}"
        )
    bias = next((value for value in weights.values() if value.ndim == 1), np.zeros(1))
    model = _lstm_graph(layers, matrices[0], bias)
    _compare(model, network, len(layers), layers[0].hidden.shape[1], path)
    return model


class _Graph:
    """Nodes and constants of an ONNX graph under construction."""

    def __init__(self) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.constants: list[onnx.TensorProto] = []

    def constant(self, name: str, value: np.ndarray) -> str:
        """Add a constant; returns its name."""
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value, dtype=np.float32), name))
        return name

    def add(self, kind: str, inputs: list[str], outputs: list[str], **attributes: int) -> str:
        """Add a node; returns the name of its last output."""
        self.nodes.append(helper.make_node(kind, inputs, outputs, **attributes))
        return outputs[-1]


def _add_layer(graph: _Graph, layer: _Layer, k: int, value: str, names: list[str], outputs: list[str]) -> str:
    """Add layer ``k`` from ``value`` and the states ``names`` to the states ``outputs``; returns what it hands on."""
    arrays = [graph.constant(f"{n}{k}", x[None]) for n, x in (("w", layer.inputs), ("r", layer.hidden))]
    biases = np.concatenate([layer.input_bias, layer.hidden_bias])
    arrays += [graph.constant(f"b{k}", biases[None]), ""]
    graph.add("LSTM", [value, *arrays, *names], ["", *outputs], hidden_size=layer.hidden.shape[1])
    return outputs[0]  # a sequence of one step: its last state is its output


def _add_layers(graph: _Graph, layers: list[_Layer]) -> str:
    """Add the layers, from ``input``, ``h`` and ``c`` to ``h_out`` and ``c_out``; returns what the last hands on."""
    if len(layers) == 1:
        return _add_layer(graph, layers[0], 0, "input", ["h", "c"], ["h_out", "c_out"])
    hidden = layers[0].hidden.shape[1]
    value, sums = "input", {"h": "", "c": ""}
    for k, layer in enumerate(layers):
        part = np.eye(hidden * len(layers))[:, k * hidden : (k + 1) * hidden]
        names = [graph.add("MatMul", [n, graph.constant(f"take_{n}{k}", part)], [f"{n}{k}"]) for n in ("h", "c")]
        value = _add_layer(graph, layer, k, value, names, [f"h_new{k}", f"c_new{k}"])
        for n in ("h", "c"):
            put = graph.add("MatMul", [f"{n}_new{k}", graph.constant(f"put_{n}{k}", part.T)], [f"{n}_put{k}"])
            last = f"{n}_out" if k == len(layers) - 1 else f"{n}_sum{k}"
            sums[n] = graph.add("Add", [sums[n], put], [last]) if sums[n] else put
    return value


def _lstm_graph(layers: list[_Layer], head: np.ndarray, bias: np.ndarray) -> onnx.ModelProto:
    width = layers[0].hidden.shape[1] * len(layers)
    graph = _Graph()
    value = _add_layers(graph, layers)
    flat = graph.add("Squeeze", [value, "axis"], ["flat"])
    graph.add("Gemm", [flat, graph.constant("head", head), graph.constant("head_bias", bias)], ["effort"], transB=1)
    graph.constants.append(numpy_helper.from_array(np.array([0], dtype=np.int64), "axis"))

    def tensor(name: str, *shape: int | str) -> onnx.ValueInfoProto:
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    made = helper.make_graph(
        graph.nodes, "actuator",
        [tensor("input", 1, "n", 2), tensor("h", 1, "n", width), tensor("c", 1, "n", width)],
        [tensor("effort", "n", 1), tensor("h_out", 1, "n", width), tensor("c_out", 1, "n", width)],
        graph.constants,
    )  # fmt: skip
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    own_names = [["input", "h", "c"], ["effort", "h_out", "c_out"]]
    metadata: dict[str, object] = {"model_type": "lstm", "num_layers": 1, "hidden_size": width}
    for keys, own in zip(LSTM_NAMES, own_names, strict=True):
        metadata |= dict(zip(keys, own, strict=True))
    return with_metadata(model, metadata)


def _compare(model: onnx.ModelProto, network: torch.jit.ScriptModule, layers: int, hidden: int, path: Path) -> None:
    """Compare the converted network with the original on random numbers.

    Raises:
        ValueError: if they differ.
    """
    # A few rows with states: one row at zero would hide gates in a wrong order.
    rows, rng = 3, np.random.default_rng(0)
    x = rng.normal(size=(rows, 2)).astype(np.float32)
    h, c = rng.normal(size=(2, layers, rows, hidden)).astype(np.float32)

    def flat(state: np.ndarray) -> np.ndarray:
        return np.concatenate(list(state), axis=1)[None]

    converted = ReferenceEvaluator(model).run(None, {"input": x[None], "h": flat(h), "c": flat(c)})
    problems = []
    for order in ((rows, 1, 2), (1, rows, 2)):  # rows or time first
        try:
            with torch.no_grad():
                effort, (h_new, c_new) = network(
                    torch.from_numpy(x).reshape(order), (torch.from_numpy(h), torch.from_numpy(c))
                )
        except Exception as error:  # whatever TorchScript raises for a shape that the network does not take
            problems.append(str(error).strip().rsplit("\n", 1)[-1])
            continue
        original = effort.reshape(rows, 1).numpy(), flat(h_new.numpy()), flat(c_new.numpy())
        if all(np.allclose(a, b, rtol=1e-4, atol=1e-5) for a, b in zip(converted, original, strict=True)):
            return
        problems.insert(0, "the converted network gives something else")
    raise ValueError(
        f"network_file '{path}': it must be effort, (h, c) = net(input, (h, c)) with an LSTM and a linear layer alone, "
        f"and is not: {problems[0]}"
    )
