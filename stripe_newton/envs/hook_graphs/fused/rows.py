# SPDX-License-Identifier: Apache-2.0
"""Rows: which dimension of an operation counts the environments, and where in memory the elements of a row are.

A thread computes one row. To it, each tensor is a list of addresses that are the same in every row but for a multiple
of the *pitch*, the distance from one row to the next. Views of torch differ in these lists only.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import torch

__all__ = ["Frame", "Unsupported", "View"]

MAX_ELEMENTS, MAX_SHARED = 512, 64
"""Largest number of elements of a row in one operation, as each becomes a statement, and of an operation that is the
same for all rows, as each thread computes it."""


class Unsupported(Exception):
    """An operation cannot be part of a chain; torch runs it."""


@dataclass(frozen=True)
class View:
    """Addresses of a row's elements in the storage of a tensor.

    Attributes:
        pitch: Bytes from one row to the next; 0 if all rows share the elements.
        offsets: Bytes from the begin of the storage to each element of row 0, in the order of the shape.
    """

    pitch: int
    offsets: tuple[int, ...]


@dataclass(frozen=True)
class Frame:
    """Shape of an operation, with the dimension of its rows.

    A dimension that is a multiple of the number of rows, such as that of a batch of several bodies for each
    environment, is split: its slower part counts the rows.

    Attributes:
        shape: Shape that the operation runs over.
        row_dim: Dimension of the rows; None for an operation that is the same for all rows.
        split: Elements of a row along that dimension.
    """

    shape: tuple[int, ...]
    row_dim: int | None
    split: int = 1

    @staticmethod
    def of(shape: Sequence[int], rows: int, without: Collection[int] = ()) -> Frame:
        """The frame of a shape for a number of rows.

        Args:
            shape: The shape.
            rows: Number of rows.
            without: Dimensions along which the operation mixes elements.

        Raises:
            Unsupported: if the operation mixes rows, or rows are too large.
        """
        shape = tuple(shape)
        found = [d for d, size in enumerate(shape) if size == rows] or [
            d for d, size in enumerate(shape) if size and size % rows == 0
        ]
        row_dim = next((d for d in found if d not in without), None)
        if found and row_dim is None:
            raise Unsupported("mixes rows")
        frame = Frame(shape, row_dim, shape[row_dim] // rows if row_dim is not None else 1)
        if not 0 < math.prod(frame.inner) <= (MAX_ELEMENTS if found else MAX_SHARED):
            raise Unsupported(f"has {math.prod(frame.inner)} elements in a row")
        return frame

    @property
    def inner(self) -> tuple[int, ...]:
        """Shape of a row's elements. It has as many dimensions as the whole shape."""
        if self.row_dim is None:
            return self.shape
        return (*self.shape[: self.row_dim], self.split, *self.shape[self.row_dim + 1 :])

    def view(self, tensor: torch.Tensor) -> View:
        """A row of a tensor that broadcasts to the shape."""
        return self.view_of(tuple(tensor.shape), tensor.stride(), tensor)

    def view_of(self, sizes: Sequence[int], strides: Sequence[int], tensor: torch.Tensor) -> View:
        """A row of a tensor, read with other sizes and strides than its own."""
        missing = len(self.shape) - len(sizes)
        if missing < 0:
            raise Unsupported("has more dimensions than its result")
        item = tensor.element_size()
        steps = [0] * missing
        for dim, (size, stride) in enumerate(zip(sizes, strides, strict=True), missing):
            if size not in (1, self.shape[dim]):
                raise Unsupported("does not broadcast")
            steps.append(0 if size == 1 else stride * item)
        pitch = steps[self.row_dim] * self.split if self.row_dim is not None else 0
        start = int(tensor.storage_offset()) * item
        places = itertools.product(*(range(size) for size in self.inner))
        offsets = tuple(start + sum(i * s for i, s in zip(place, steps, strict=True)) for place in places)
        return View(pitch, offsets)
