# SPDX-License-Identifier: Apache-2.0
"""RecurrentCNNModel: convolutional encoders and a recurrent layer before an MLP, for policies that see pictures."""

from __future__ import annotations

import copy
from types import SimpleNamespace

import torch
from rsl_rl.models import CNNModel, MLPModel, RNNModel
from rsl_rl.modules import RNN, HiddenState
from tensordict import TensorDict
from torch import nn

__all__ = ["RecurrentCNNModel"]


class RecurrentCNNModel(CNNModel):
    """Network of a policy with a memory of what it has seen: rsl_rl's encoders, recurrent layer and MLP in a row.

    Flat observation groups, normalised if asked for, and encoded pictures are joined before the recurrent layer.
    """

    is_recurrent: bool = True

    def __init__(
        self,
        obs: TensorDict,
        obs_groups: dict[str, list[str]],
        obs_set: str,
        output_dim: int,
        hidden_dims: tuple[int, ...] | list[int] = (256, 256, 256),
        activation: str = "elu",
        obs_normalization: bool = False,
        distribution_cfg: dict | None = None,
        cnn_cfg: dict | None = None,
        cnns: nn.ModuleDict | dict[str, nn.Module] | None = None,
        rnn_type: str = "gru",
        rnn_hidden_dim: int = 256,
        rnn_num_layers: int = 1,
    ):
        """Build the network; arguments as of rsl_rl's ``CNNModel`` and ``RNNModel``."""
        self._rnn_width = rnn_hidden_dim
        super().__init__(
            obs, obs_groups, obs_set, output_dim, hidden_dims, activation, obs_normalization, distribution_cfg,
            cnn_cfg, cnns,
        )  # fmt: skip
        self.rnn = RNN(self.obs_dim + self.cnn_latent_dim, rnn_hidden_dim, rnn_num_layers, rnn_type)

    def get_latent(
        self, obs: TensorDict, masks: torch.Tensor | None = None, hidden_state: HiddenState = None
    ) -> torch.Tensor:
        """Output of the recurrent layer, shape ``(num_envs, rnn_hidden_dim)``."""
        return self.rnn(self.encode(obs), masks, hidden_state).squeeze(0)

    def encode(self, obs: TensorDict) -> torch.Tensor:
        """Inputs of the recurrent layer: normalised flat observations and encoded pictures, shape ``(..., inputs)``."""
        parts = [MLPModel.get_latent(self, obs)] if self.obs_groups else []
        for group in self.obs_groups_2d:
            picture = obs[group]
            # In PPO's update pictures are (steps, trajectories, channels, height, width); encoders take one batch.
            encoded = self.cnns[group](picture.flatten(0, -4))
            parts.append(encoded.unflatten(0, picture.shape[:-3]))
        return torch.cat(parts, dim=-1)

    def reset(self, dones: torch.Tensor | None = None, hidden_state: HiddenState = None) -> None:
        """Clear the memory of the environments whose episode ended, or set that of all."""
        self.rnn.reset(dones, hidden_state)

    def get_hidden_state(self) -> HiddenState:
        """The memory of all environments."""
        return self.rnn.hidden_state

    def detach_hidden_state(self, dones: torch.Tensor | None = None) -> None:
        """Cut the gradient through the memory, of all environments or of those whose episode ended."""
        self.rnn.detach_hidden_state(dones)

    def as_jit(self) -> nn.Module:
        """The network for TorchScript, called with flat observations and a list of pictures; it keeps its memory."""
        return _TorchRecurrentCNN(self)

    def as_onnx(self, verbose: bool = False) -> nn.Module:
        """The network for ONNX; its memory is among the inputs and outputs."""
        return _OnnxRecurrentCNN(self, verbose)

    def _get_latent_dim(self) -> int:
        return self._rnn_width


class _Encoder(nn.Module):
    """Normalised flat observations joined with encoded pictures."""

    def __init__(self, model: RecurrentCNNModel):
        super().__init__()
        self.obs_normalizer = copy.deepcopy(model.obs_normalizer)
        self.cnns = nn.ModuleList([copy.deepcopy(model.cnns[g]) for g in model.obs_groups_2d])

    def forward(self, flat: torch.Tensor, pictures: list[torch.Tensor]) -> torch.Tensor:
        parts = [self.obs_normalizer(flat)]
        for i, cnn in enumerate(self.cnns):
            parts.append(cnn(pictures[i]))
        return torch.cat(parts, dim=-1)


def _head(model: RecurrentCNNModel) -> SimpleNamespace:
    """The part after the encoders, in the form of an ``RNNModel`` whose exports rsl_rl makes."""
    return SimpleNamespace(
        obs_normalizer=nn.Identity(),
        obs_dim=model.obs_dim + model.cnn_latent_dim,
        rnn=model.rnn,
        mlp=model.mlp,
        distribution=model.distribution,
    )


class _TorchRecurrentCNN(nn.Module):
    """Network for TorchScript, of one environment."""

    def __init__(self, model: RecurrentCNNModel):
        super().__init__()
        self.encoder, self.head = _Encoder(model), RNNModel.as_jit(_head(model))

    def forward(self, flat: torch.Tensor, pictures: list[torch.Tensor]) -> torch.Tensor:
        return self.head(self.encoder(flat, pictures))

    @torch.jit.export
    def reset(self) -> None:
        """Clear the memory."""
        self.head.reset()


class _OnnxRecurrentCNN(nn.Module):
    """Network for ONNX: flat observations, pictures and memory to actions and memory."""

    def __init__(self, model: RecurrentCNNModel, verbose: bool):
        super().__init__()
        self.encoder, self.head = _Encoder(model), RNNModel.as_onnx(_head(model), verbose)
        self._groups = list(model.obs_groups_2d)
        sizes = zip(model.obs_channels_2d, model.obs_dims_2d, strict=True)
        self._shapes = [(channels, *dims) for channels, dims in sizes]
        self._flat = model.obs_dim

    def forward(self, flat: torch.Tensor, *others: torch.Tensor) -> tuple[torch.Tensor, ...]:
        count = len(self._groups)
        outputs = self.head(self.encoder(flat, list(others[:count])), *others[count:])
        return tuple(x for x in outputs if x is not None)

    def get_dummy_inputs(self) -> tuple[torch.Tensor, ...]:
        """Inputs of zeros for one environment."""
        pictures = [torch.zeros(1, *shape) for shape in self._shapes]
        return torch.zeros(1, self._flat), *pictures, *self.head.get_dummy_inputs()[1:]

    @property
    def input_names(self) -> list[str]:
        return ["obs", *self._groups, *self.head.input_names[1:]]

    @property
    def output_names(self) -> list[str]:
        return list(self.head.output_names)
