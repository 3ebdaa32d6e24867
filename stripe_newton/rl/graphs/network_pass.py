# SPDX-License-Identifier: Apache-2.0
"""Network pass: forward and backward pass of a network in an update, in few passes over its activations."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping

import torch
import warp as wp
from rsl_rl.models import MLPModel
from rsl_rl.modules import EmpiricalNormalization
from tensordict import TensorDict

from stripe_kernels.ppo import BLOCK, gather_inputs

from .flat_adam import as_array
from .layer_kernels import layer_kernels
from .picture_layers import picture_latent, sampled_latent

__all__ = [
    "EluPass",
    "NetworkPass",
    "TorchPass",
    "network_output",
    "network_pass",
]


def network_output(model: MLPModel, obs: TensorDict) -> torch.Tensor:
    """The output of ``model.mlp(model.get_latent(obs))``, without gradients, ``(samples, outputs)``."""
    x = _latent(model, obs)
    layers = linear_layers(model.mlp)
    if not layers:
        return model.mlp(x)
    for layer in layers[:-1]:
        x = torch.nn.functional.elu_(layer(x))
    return layers[-1](x)


def _latent(model: MLPModel, obs: TensorDict) -> torch.Tensor:
    """``model.get_latent(obs)``, which copies also a single group."""
    if type(model).get_latent is MLPModel.get_latent and len(model.obs_groups) == 1:
        return model.obs_normalizer(obs[model.obs_groups[0]])
    return picture_latent(model, obs)


class NetworkPass(ABC):
    """Forward and backward pass of a network."""

    @abstractmethod
    def forward(self, stored: TensorDict, indices: torch.Tensor) -> torch.Tensor:
        """The output of the network for the observations ``stored[indices]``.

        Args:
            stored: Observations, ``(n,)``.
            indices: Rows of them, int64, ``(samples,)``.

        Returns:
            Outputs, float32, ``(samples, outputs)``.
        """

    @abstractmethod
    def backward(self, gradient: torch.Tensor) -> None:
        """Compute gradients of the network's parameters into their ``grad``, which is 0 before.

        Args:
            gradient: Gradient by the output of the last :meth:`forward`.
        """


def network_pass(model: MLPModel, copies: Mapping[torch.Tensor, torch.Tensor] | None = None) -> NetworkPass:
    """The pass for a network.

    Args:
        model: A network whose forward pass is ``model.mlp(model.get_latent(obs))``.
        copies: Copies of its parameters in bfloat16, in which its layers then run; None for float32.
    """
    if type(model).get_latent is MLPModel.get_latent and linear_layers(model.mlp):
        return EluPass(model, copies)
    return TorchPass(model, copies is not None)


def linear_layers(mlp: torch.nn.Sequential) -> list[torch.nn.Linear]:
    """The layers of a network that is linear layers with ELU between them; none for any other."""
    layers = list(mlp)
    linear = [m for m in layers[0::2] if type(m) is torch.nn.Linear and m.bias is not None]
    elus = [m for m in layers[1::2] if type(m) is torch.nn.ELU and m.alpha == 1.0]
    return linear if len(linear) == len(elus) + 1 and len(linear) + len(elus) == len(layers) else []


def _gradient_of(parameter: torch.Tensor) -> torch.Tensor:
    """The memory of a parameter's gradient, in which it stays."""
    assert parameter.grad is not None  # FlatAdam has made it
    return parameter.grad


class TorchPass(NetworkPass):
    """Pass of any network, by torch's autograd."""

    def __init__(self, model: MLPModel, bf16: bool):
        self._model, self._bf16 = model, bf16

    def forward(self, stored: TensorDict, indices: torch.Tensor) -> torch.Tensor:
        model = self._model
        # torch's cache of weights in bfloat16 must be off where a graph is recorded.
        with torch.enable_grad(), torch.autocast(indices.device.type, torch.bfloat16, self._bf16, cache_enabled=False):
            self._output = model.mlp(sampled_latent(model, stored, indices, self._bf16)).float()
        return self._output.detach()

    def backward(self, gradient: torch.Tensor) -> None:
        self._output.backward(gradient)


class EluPass(NetworkPass):
    """Pass of linear layers with ELU between them.

    Activations overwrite what they are computed from, and the gradient before an ELU the one behind it. So a layer's
    activations are read and written as seldom as is possible beside matrix products of a library.
    """

    def __init__(self, model: MLPModel, copies: Mapping[torch.Tensor, torch.Tensor] | None = None):
        self._model, self._layers = model, linear_layers(model.mlp)
        self._kind = torch.float32 if copies is None else torch.bfloat16
        pairs = [(layer.weight, layer.bias) for layer in self._layers]
        self._parameters = [tuple(p.detach() if copies is None else copies[p] for p in pair) for pair in pairs]
        self._gradients = [tuple(_gradient_of(p) for p in pair) for pair in pairs]
        self._inputs: list[torch.Tensor] = []
        self._kernels = layer_kernels(pairs[0][0].device, self._kind)

    @torch.no_grad()
    def forward(self, stored: TensorDict, indices: torch.Tensor) -> torch.Tensor:
        x = self._gather(stored, indices)
        self._inputs = [x]
        *hidden, (last_weight, last_bias) = self._parameters
        for weight, bias in hidden:
            x = self._kernels.layer(x, weight, bias)
            self._inputs.append(x)
        return torch.addmm(last_bias, x, last_weight.t()).float()

    def _gather(self, stored: TensorDict, indices: torch.Tensor) -> torch.Tensor:
        """The latent of ``stored[indices]``."""
        model, first = self._model, 0
        out = torch.empty(len(indices), model.obs_dim, dtype=self._kind, device=indices.device)
        normalizer = model.obs_normalizer
        statistics = (None, None, 0.0)
        if isinstance(normalizer, EmpiricalNormalization):
            statistics = (as_array(normalizer._mean), as_array(normalizer._std), normalizer.eps)
        rows, target = as_array(indices), as_array(out)
        for group in model.obs_groups:
            values = as_array(stored[group].float())
            inputs = [rows, values, first, *statistics, target]
            dim = (len(indices), values.shape[1])
            wp.launch(gather_inputs, dim=dim, inputs=inputs, device=rows.device, block_dim=BLOCK)
            first += values.shape[1]
        return out

    @torch.no_grad()
    def backward(self, gradient: torch.Tensor) -> None:
        grad_output = gradient.to(self._kind)
        torch.sum(gradient, dim=0, out=self._gradients[-1][1])
        widths = [x.shape[1] for x in self._inputs[1:]]
        # Sums of all layers' gradients over blocks of samples, side by side, so that one kernel adds them up.
        parts = gradient.new_empty(-(-len(gradient) // self._kernels.rows), sum(widths))
        sums = parts.split(widths, dim=1)
        for index in reversed(range(len(self._layers))):
            grad_weight, x = self._gradients[index][0], self._inputs[index]
            if self._kind == torch.float32:
                torch.mm(grad_output.t(), x, out=grad_weight)
            else:
                grad_weight.copy_(grad_output.t() @ x)
            if index:
                grad_output = self._kernels.gradient(grad_output, self._parameters[index][0], x, sums[index - 1])
        if widths:
            biases = [grad_bias for _, grad_bias in self._gradients[:-1]]
            torch._foreach_copy_(biases, list(parts.sum(dim=0).split(widths)))
        self._inputs = []
