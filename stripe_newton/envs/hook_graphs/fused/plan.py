# SPDX-License-Identifier: Apache-2.0
"""Plan: what an operation of torch does to one row of its tensors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import torch

from .memory import Access, Indexed
from .rows import Frame, Unsupported
from .source import Source, Value

__all__ = ["Compute", "Operand", "Plan"]

Compute: TypeAlias = "Callable[[Source, list[list[Value]]], list[Value]]"
"""Writes the code of a result, given the values of the inputs."""
Operand: TypeAlias = "torch.Tensor | bool | int | float"
"""An argument of an operation on numbers."""


@dataclass
class Plan:
    """Plan of an operation: its work on one row.

    Attributes:
        frame: Shape of the result, with its rows.
        inputs: Elements that it reads.
        compute: Writes the code: the elements of the result in the order of the frame.
        like: The tensor that it makes, without memory; None if it writes one that there is.
        target: The tensor that it writes.
        expanded: Dimensions that the result lacks and the frame has, such as those that a reduction removes.
        gathered: Elements whose places depend on indices, which are read after the inputs.
        scattered: Elements of the target whose places depend on indices.
    """

    frame: Frame
    inputs: list[Access]
    compute: Compute
    like: torch.Tensor | None
    target: torch.Tensor | None = None
    expanded: tuple[int, ...] = ()
    gathered: Indexed | None = None
    scattered: Indexed | None = None

    def result(self, tensor: torch.Tensor) -> Access:
        """The elements of the result in a tensor."""
        sizes, strides = list(tensor.shape), list(tensor.stride())
        for dim in sorted(self.expanded):
            sizes.insert(dim, 1)
            strides.insert(dim, 0)
        if tuple(sizes) != self.frame.shape:
            raise Unsupported("writes a tensor of another shape")
        return Access(tensor, self.frame.view_of(sizes, strides, tensor), writes=True)
