# SPDX-License-Identifier: Apache-2.0
"""Picture kernels: pictures of a minibatch, gathered as blocks of pixels for a convolution."""

from typing import Any

import warp as wp

__all__ = ["BLOCK", "gather_blocks"]

BLOCK = 256
"""Threads of a block."""


@wp.kernel(enable_backward=False)
def gather_blocks(
    indices: wp.array[wp.int64],
    pictures: wp.array2d[float],
    channels: int,
    height: int,
    width: int,
    edge: int,
    out: wp.array2d[Any],
):
    """Gather pictures as blocks of pixels, each block's numbers side by side; launch ``(m, pixels // edge)`` threads.

    Args:
        indices: Row of each sample, ``(m,)``.
        pictures: Pictures, ``(n, pixels)``, where pixels is channels by height by width.
        channels: Channels of a picture.
        height: Its height, a multiple of ``edge``.
        width: Its width, a multiple of ``edge``.
        edge: Edge of a block.
        out: Blocks, float32 or bfloat16: rows, columns, channels, and height and width within a block, ``(m, pixels)``.
    """
    # A thread copies one row of a block. Neighbours write next to each other.
    sample, row = wp.tid()
    rows = channels * edge
    block, inside = row // rows, row % rows
    across = width // edge
    channel, y = inside // edge, (block // across) * edge + inside % edge
    source = (channel * height + y) * width + (block % across) * edge
    picture, target = int(indices[sample]), row * edge
    for x in range(edge):
        out[sample, target + x] = out.dtype(pictures[picture, source + x])


for _number in (wp.float32, wp.bfloat16):  # known before the module is compiled, so that it is compiled once
    wp.overload(gather_blocks, {"out": wp.array2d[_number]})
