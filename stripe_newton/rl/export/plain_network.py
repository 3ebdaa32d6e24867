# SPDX-License-Identifier: Apache-2.0
"""Plain networks: writes the ONNX graph of layers one after the other, which needs no compiler.

``torch.onnx.export`` first loads torch's compiler and a library of all operators: two seconds, for a network of a dozen
nodes. Networks that are not plain, with pictures or a memory, are left to it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
import torch
from rsl_rl.models import MLPModel
from rsl_rl.modules import MLP, EmpiricalNormalization, GaussianDistribution
from torch import nn

if TYPE_CHECKING:
    import onnx

__all__ = ["OPSET", "plain_onnx"]

OPSET = 18
"""Version of ONNX's operators, as of the networks that torch exports."""
_IR_VERSION = 10
"""Version of the file format, as of those."""
_ACTIVATIONS: dict[type[nn.Module], str] = {
    nn.ELU: "Elu",
    nn.ReLU: "Relu",
    nn.Sigmoid: "Sigmoid",
    nn.Softplus: "Softplus",
    nn.Tanh: "Tanh",
}
"""Activations and their operators. Elu has a parameter."""


def plain_onnx(policy: MLPModel, network: nn.Module) -> onnx.ModelProto | None:
    """A policy as an ONNX model that takes any number of environments.

    Args:
        policy: The policy.
        network: Its network, as ``policy.as_onnx()`` returns it.

    Returns:
        The model, from ``obs`` to ``actions``; None if the policy is not a normaliser, linear layers and activations
        one after the other.
    """
    # A subclass may compute something else, and another distribution a mean from what the network returns.
    if type(policy) is not MLPModel or type(policy.distribution) not in (GaussianDistribution, type(None)):
        return None
    layers, graph = network.get_submodule("mlp"), _Graph("obs")
    if not isinstance(layers, MLP) or not graph.add_all([network.get_submodule("obs_normalizer"), *layers]):
        return None
    width = [layer for layer in layers if isinstance(layer, nn.Linear)][-1].out_features
    return graph.finish("actions", policy.obs_dim, width)


class _Graph:
    """Nodes of an ONNX graph that is built layer by layer."""

    def __init__(self, source: str):
        self._source = self._last = source
        self._nodes: list[onnx.NodeProto] = []
        self._weights: list[onnx.TensorProto] = []

    def add_all(self, layers: Iterable[nn.Module]) -> bool:
        """Add layers. Returns whether all are known."""
        return all(self._add(layer) for layer in layers)

    def _add(self, layer: nn.Module) -> bool:
        if type(layer) is nn.Linear and layer.bias is not None:
            self._node("Gemm", {"weight": layer.weight, "bias": layer.bias}, transB=1)
        elif type(layer) is EmpiricalNormalization:
            buffers, least = dict(layer.named_buffers()), layer.eps
            assert isinstance(least, float)  # torch's modules do not say what their attributes are
            self._node("Sub", {"mean": buffers["_mean"]})
            self._node("Div", {"scale": buffers["_std"] + least})
        elif type(layer) is nn.Softplus and (layer.beta, layer.threshold) != (1.0, 20.0):
            return False
        elif type(layer) is nn.ELU:
            self._node("Elu", {}, alpha=float(layer.alpha))
        elif type(layer) in _ACTIVATIONS:
            self._node(_ACTIVATIONS[type(layer)], {})
        else:
            return type(layer) is nn.Identity
        return True

    def _node(self, operator: str, weights: dict[str, torch.Tensor], **attributes: float) -> None:
        from onnx import helper, numpy_helper  # here, as they take long to import

        number = len(self._nodes)
        names = [f"{name}_{number}" for name in weights]
        for name, value in zip(names, weights.values(), strict=True):
            array = np.ascontiguousarray(value.detach().cpu().numpy(), dtype=np.float32)
            self._weights.append(numpy_helper.from_array(array, name))
        result = f"layer_{number}"
        node = helper.make_node(operator, [self._last, *names], [result], name=f"{operator}_{number}", **attributes)
        self._nodes.append(node)
        self._last = result

    def finish(self, result: str, inputs: int, outputs: int) -> onnx.ModelProto:
        """The model, whose input and output have ``inputs`` and ``outputs`` numbers for each environment."""
        from onnx import TensorProto, helper

        self._nodes[-1].output[0] = result
        ends = [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, ["batch", width])
            for name, width in ((self._source, inputs), (result, outputs))
        ]
        graph = helper.make_graph(self._nodes, "policy", ends[:1], ends[1:], self._weights)
        opset = helper.make_opsetid("", OPSET)
        model = helper.make_model(graph, opset_imports=[opset], ir_version=_IR_VERSION, producer_name="stripe-newton")
        return model
