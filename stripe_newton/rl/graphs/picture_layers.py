# SPDX-License-Identifier: Apache-2.0
"""Picture layers: the convolutions of a network that sees pictures, in the form that a GPU computes fastest.

A first convolution has three channels, of which tensor cores can make little use. Where its stride divides its kernel,
as in most networks for pictures, it is a convolution without stride over blocks of pixels: 8 by 8 pixels of 3 channels
with stride 4 are 2 by 2 blocks of 48. Memory with the channels last needs no conversion before tensor cores either.
"""

from __future__ import annotations

import os
from typing import NamedTuple

import torch
from rsl_rl.models import CNNModel, MLPModel
from tensordict import TensorDict
from torch import nn
from torch.nn import functional

__all__ = ["PLAIN", "PictureForm", "convolve", "fast_form", "picture_latent"]


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
    if not isinstance(model, CNNModel) or type(model).get_latent is not CNNModel.get_latent:
        return model.get_latent(obs)
    form = fast_form(obs[model.obs_groups_2d[0]].device)
    if form == PLAIN:
        return model.get_latent(obs)
    latents = [convolve(model.cnns[group], obs[group], form) for group in model.obs_groups_2d]
    numbers = [MLPModel.get_latent(model, obs)] if model.obs_groups else []
    return torch.cat([*numbers, *latents], dim=-1)


def convolve(cnn: nn.Sequential, pictures: torch.Tensor, form: PictureForm) -> torch.Tensor:
    """``cnn(pictures)`` in a form.

    Args:
        cnn: Layers, convolutions first.
        pictures: Shape ``(samples, channels, height, width)``; no gradient is computed for them.
        form: The form.
    """
    first, *others = cnn
    if form.blocks and _goes_over_blocks(first, pictures):
        assert isinstance(first, nn.Conv2d)
        edge = first.stride[0]
        x = _in_blocks(pictures, edge, form.channels_last)
        x = functional.conv2d(x, functional.pixel_unshuffle(first.weight, edge), first.bias)
    else:
        x = first(pictures.contiguous(memory_format=torch.channels_last) if form.channels_last else pictures)
    for layer in others:
        # In place: what an ELU returns is enough for its gradient, and the convolution before it needs no result.
        x = functional.elu_(x, layer.alpha) if type(layer) is nn.ELU else layer(x)
    return x


def _goes_over_blocks(layer: nn.Module, pictures: torch.Tensor) -> bool:
    """Whether a convolution is one without stride over blocks of pixels."""
    if type(layer) is not nn.Conv2d or layer.stride[0] != layer.stride[1] or layer.stride[0] == 1:
        return False
    plain = layer.groups == 1 and set(layer.dilation) == {1} and not any(layer.padding)
    sizes = (*layer.kernel_size, *pictures.shape[-2:])
    return plain and all(size % layer.stride[0] == 0 for size in sizes)


def _in_blocks(pictures: torch.Tensor, edge: int, channels_last: bool) -> torch.Tensor:
    """``pixel_unshuffle(pictures, edge)``, in one copy also with channels last."""
    count, channels, height, width = pictures.shape
    if not channels_last:
        return functional.pixel_unshuffle(pictures, edge)
    blocks = pictures.reshape(count, channels, height // edge, edge, width // edge, edge)
    rows = blocks.permute(0, 2, 4, 1, 3, 5).reshape(count, height // edge, width // edge, channels * edge * edge)
    return rows.permute(0, 3, 1, 2)
