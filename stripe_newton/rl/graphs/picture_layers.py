# SPDX-License-Identifier: Apache-2.0
"""Picture layers: the convolutions of a network that sees pictures, in the form that a GPU computes fastest.

A first convolution has three channels, of which tensor cores can make little use. Where its stride divides its kernel,
as in most networks for pictures, it is a convolution without stride over blocks of pixels: 8 by 8 pixels of 3 channels
with stride 4 are 2 by 2 blocks of 48. Memory with the channels last needs no conversion before tensor cores either.
"""

from __future__ import annotations

import os
from typing import NamedTuple, TypeGuard

import torch
import warp as wp
from rsl_rl.models import CNNModel, MLPModel
from tensordict import TensorDict
from torch import nn
from torch.nn import functional

from stripe_kernels.pictures import BLOCK, gather_blocks

from .flat_adam import as_array

__all__ = ["PLAIN", "PictureForm", "convolve", "convolve_rows", "fast_form", "picture_latent", "sampled_latent"]


class PictureForm(NamedTuple):
    """How convolutions are computed. All forms give the same numbers but for rounding."""

    blocks: bool
    """Whether the first convolution goes over blocks of pixels, where it can."""
    channels_last: bool
    """Whether memory has the channels of a pixel next to each other."""


PLAIN = PictureForm(blocks=False, channels_last=False)
"""The form of torch's modules."""


def fast_form(device: torch.device) -> PictureForm:
    """The form for a device. ``STRIPE_NEWTON_PLAIN_CONVOLUTIONS=1`` keeps that of torch's modules."""
    if device.type != "cuda" or os.environ.get("STRIPE_NEWTON_PLAIN_CONVOLUTIONS", "0") != "0":
        return PLAIN
    return PictureForm(blocks=True, channels_last=True)


def picture_latent(model: MLPModel, obs: TensorDict) -> torch.Tensor:
    """``model.get_latent(obs)``, its convolutions in the form of the device."""
    if not _has_convolutions(model) or (form := fast_form(obs[model.obs_groups_2d[0]].device)) == PLAIN:
        return model.get_latent(obs)
    latents = [convolve(model.cnns[group], obs[group], form) for group in model.obs_groups_2d]
    numbers = [MLPModel.get_latent(model, obs)] if model.obs_groups else []
    return torch.cat([*numbers, *latents], dim=-1)


def sampled_latent(model: MLPModel, stored: TensorDict, indices: torch.Tensor, bf16: bool) -> torch.Tensor:
    """``picture_latent(model, stored[indices])``.

    Args:
        model: A network.
        stored: Observations, ``(n,)``.
        indices: Rows of them, int64, ``(samples,)``.
        bf16: Whether convolutions run in bfloat16.
    """
    # rsl_rl keeps pictures apart: they are in none of the groups that other networks have.
    pictures = getattr(model, "obs_groups_2d", ())
    obs = TensorDict({name: stored[name][indices] for name in model.obs_groups}, batch_size=[len(indices)])
    if not _has_convolutions(model) or (form := fast_form(indices.device)) == PLAIN:
        for name in pictures:
            obs[name] = stored[name][indices]
        return model.get_latent(obs)
    latents = [convolve_rows(model.cnns[name], stored[name], indices, form, bf16) for name in pictures]
    numbers = [MLPModel.get_latent(model, obs)] if model.obs_groups else []
    return torch.cat([*numbers, *latents], dim=-1)


def _has_convolutions(model: MLPModel) -> TypeGuard[CNNModel]:
    """Whether a network sees pictures through rsl_rl's own convolutions."""
    return isinstance(model, CNNModel) and type(model).get_latent is CNNModel.get_latent


def convolve(cnn: nn.Sequential, pictures: torch.Tensor, form: PictureForm) -> torch.Tensor:
    """``cnn(pictures)`` in a form.

    Args:
        cnn: Layers, convolutions first.
        pictures: Shape ``(samples, channels, height, width)``; no gradient is computed for them.
        form: The form.
    """
    first = _layer_over_blocks(cnn, pictures) if form.blocks else None
    if first is not None:
        return _convolve_blocks(cnn, first, _in_blocks(pictures, first.stride[0], form.channels_last))
    x = cnn[0](pictures.contiguous(memory_format=torch.channels_last) if form.channels_last else pictures)
    return _other_layers(cnn, x)


def convolve_rows(
    cnn: nn.Sequential, stored: torch.Tensor, indices: torch.Tensor, form: PictureForm, bf16: bool
) -> torch.Tensor:
    """``cnn(stored[indices])`` in a form. Pictures are read once, and not copied before they are blocks.

    Args:
        cnn: Layers, convolutions first.
        stored: Pictures, ``(n, channels, height, width)``; no gradient is computed for them.
        indices: Rows of them, int64, ``(samples,)``.
        form: The form.
        bf16: Whether convolutions run in bfloat16.
    """
    first = _layer_over_blocks(cnn, stored) if form.blocks and form.channels_last else None
    if first is None or stored.dtype != torch.float32 or not stored.is_contiguous():
        return convolve(cnn, stored[indices], form)
    (_, channels, height, width), edge, count = stored.shape, first.stride[0], len(indices)
    shape = count, height // edge, width // edge, channels * edge * edge
    blocks = torch.empty(shape, dtype=torch.bfloat16 if bf16 else torch.float32, device=stored.device)
    rows, target = as_array(indices), as_array(blocks.view(count, -1))
    inputs = [rows, as_array(stored.flatten(1)), channels, height, width, edge, target]
    dim = (count, channels * height * width // edge)
    wp.launch(gather_blocks, dim=dim, inputs=inputs, device=rows.device, block_dim=BLOCK)
    return _convolve_blocks(cnn, first, blocks.permute(0, 3, 1, 2))


def _convolve_blocks(cnn: nn.Sequential, first: nn.Conv2d, blocks: torch.Tensor) -> torch.Tensor:
    """The layers, of which the first takes blocks of pixels, ``(samples, channels * edge * edge, rows, columns)``."""
    x = functional.conv2d(blocks, functional.pixel_unshuffle(first.weight, first.stride[0]), first.bias)
    return _other_layers(cnn, x)


def _other_layers(cnn: nn.Sequential, x: torch.Tensor) -> torch.Tensor:
    """All layers but the first."""
    _, *others = cnn  # a slice would be a new CNN
    for layer in others:
        # In place: what an ELU returns is enough for its gradient, and the convolution before it needs no result.
        x = functional.elu_(x, layer.alpha) if type(layer) is nn.ELU else layer(x)
    return x


def _layer_over_blocks(cnn: nn.Sequential, pictures: torch.Tensor) -> nn.Conv2d | None:
    """The first layer, if it is a convolution without stride over blocks of pixels."""
    layer = cnn[0]
    if type(layer) is not nn.Conv2d or layer.stride[0] != layer.stride[1] or layer.stride[0] == 1:
        return None
    plain = layer.groups == 1 and set(layer.dilation) == {1} and not any(layer.padding)
    sizes = (*layer.kernel_size, *pictures.shape[-2:])
    return layer if plain and all(size % layer.stride[0] == 0 for size in sizes) else None


def _in_blocks(pictures: torch.Tensor, edge: int, channels_last: bool) -> torch.Tensor:
    """``pixel_unshuffle(pictures, edge)``, in one copy also with channels last."""
    count, channels, height, width = pictures.shape
    if not channels_last:
        return functional.pixel_unshuffle(pictures, edge)
    blocks = pictures.reshape(count, channels, height // edge, edge, width // edge, edge)
    rows = blocks.permute(0, 2, 4, 1, 3, 5).reshape(count, height // edge, width // edge, channels * edge * edge)
    return rows.permute(0, 3, 1, 2)
