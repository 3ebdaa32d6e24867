# SPDX-License-Identifier: Apache-2.0
"""Results of torch hooks: values of each environment from what a hook returned, and copies of its observations."""

from __future__ import annotations

from typing import Any, TypeAlias, TypeVar

import torch
from torch.utils import _pytree as pytree

__all__ = ["ObservationGroup", "copied", "leaves_of", "value_per_env"]

ObservationGroup: TypeAlias = torch.Tensor | dict[str, Any] | tuple[Any, ...]
"""Observations of a group: a tensor, or tensors in dicts and tuples."""
T = TypeVar("T")


def value_per_env(value: object, num_envs: int, device: str, hook: str) -> torch.Tensor:
    """A value of each environment, shape ``(num_envs,)``.

    Args:
        value: What a hook returned: a tensor of that shape, a column ``(num_envs, 1)``, or one value for all.
        num_envs: Number of environments.
        device: Device of the result.
        hook: Name of the hook, for the error.

    Raises:
        ValueError: another shape.
        TypeError: neither a tensor nor a number.
    """
    if isinstance(value, (bool, int, float)):
        value = torch.tensor(value, device=device)
    if not isinstance(value, torch.Tensor):
        raise TypeError(f"{hook} returned {type(value).__name__}, must return a tensor of shape ({num_envs},)")
    if value.dim() == 0:
        return value.expand(num_envs)
    if value.dim() == 2 and value.shape[1] == 1:
        value = value.squeeze(1)
    if tuple(value.shape) != (num_envs,):
        cure = "; sum or combine its last dimensions" if value.shape[:1] == (num_envs,) else ""
        raise ValueError(f"{hook} returned shape {tuple(value.shape)}, must return ({num_envs},){cure}")
    return value


def copied(value: T) -> T:
    """A copy of a tensor, or of the tensors in dicts and tuples."""
    result: T = pytree.tree_map(torch.Tensor.clone, value)
    return result


def leaves_of(value: object) -> list[torch.Tensor]:
    """The tensors of an observation."""
    found: list[torch.Tensor] = pytree.tree_leaves(value)
    return found
