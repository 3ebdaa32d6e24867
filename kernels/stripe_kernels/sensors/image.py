# SPDX-License-Identifier: Apache-2.0
"""Image observations: a camera's pixels as floats, row by row from the upper left.

Kernels run one thread a pixel, (environment, row, column), and write to ``out``, shape ``(num_envs, numbers)``, from
``layout.first`` on.
"""

import warp as wp

__all__ = [
    "ImageLayout",
    "write_centred_colors",
    "write_colors",
    "write_depth",
    "write_labels",
    "write_normals",
]


@wp.struct
class ImageLayout:
    """Place and order of a picture's numbers."""

    first: int
    """Column of its first number."""
    pixel: int
    """Columns from a pixel to the next one of its row: the number of channels, or 1 with channels first."""
    channel: int
    """Columns from a channel to the next one of a pixel: 1, or the number of pixels with channels first."""


@wp.func
def _pixel_start(layout: ImageLayout, image_width: int, row: int, col: int) -> int:
    """Column of the first number of a pixel."""
    return layout.first + (row * image_width + col) * layout.pixel


@wp.kernel(enable_backward=False)
def write_colors(image: wp.array4d[wp.uint8], layout: ImageLayout, out: wp.array2d[float]):
    """Write colours from 0 to 255."""
    env, row, col = wp.tid()
    at = _pixel_start(layout, image.shape[2], row, col)
    for k in range(3):
        out[env, at + k * layout.channel] = float(image[env, row, col, k])


@wp.kernel(enable_backward=False)
def write_centred_colors(image: wp.array4d[wp.uint8], layout: ImageLayout, out: wp.array2d[float]):
    """Write ``c / 255 - mean(c / 255)``, the mean of each channel over the picture; one block an environment."""
    # Sums of integers do not depend on the order of the threads, so that pictures are reproducible. A block reads its
    # picture twice, the second time from its cache: no sums go through memory.
    env, lane = wp.tid()
    width, pixels = image.shape[2], image.shape[1] * image.shape[2]
    red, green, blue = wp.int32(0), wp.int32(0), wp.int32(0)
    for i in range(lane, pixels, wp.block_dim()):
        row, col = i // width, i % width
        red += int(image[env, row, col, 0])
        green += int(image[env, row, col, 1])
        blue += int(image[env, row, col, 2])
    total = wp.vec3(
        float(wp.tile_extract(wp.tile_sum(wp.tile(red)), 0)),
        float(wp.tile_extract(wp.tile_sum(wp.tile(green)), 0)),
        float(wp.tile_extract(wp.tile_sum(wp.tile(blue)), 0)),
    )
    mean = total / float(pixels)
    for i in range(lane, pixels, wp.block_dim()):
        row, col = i // width, i % width
        at = _pixel_start(layout, width, row, col)
        for k in range(3):
            out[env, at + k * layout.channel] = (float(image[env, row, col, k]) - mean[k]) / 255.0


@wp.kernel(enable_backward=False)
def write_depth(
    image: wp.array3d[float], normalize: bool, max_depth: float, layout: ImageLayout, out: wp.array2d[float]
):
    """Write depths [m], at most ``max_depth`` where that is positive.

    With ``normalize`` 0 in place of infinity, or, with a ``max_depth``, depths divided by it.
    """
    env, row, col = wp.tid()
    value = image[env, row, col]
    if max_depth > 0.0:
        value = wp.min(value, max_depth)
        if normalize:
            value = value / max_depth
    elif normalize and wp.isinf(value):
        value = 0.0
    out[env, _pixel_start(layout, image.shape[2], row, col)] = value


@wp.kernel(enable_backward=False)
def write_normals(image: wp.array3d[wp.vec3], normalize: bool, layout: ImageLayout, out: wp.array2d[float]):
    """Write unit normals; with ``normalize`` ``(n + 1) / 2``."""
    env, row, col = wp.tid()
    at = _pixel_start(layout, image.shape[2], row, col)
    for k in range(3):
        value = image[env, row, col][k]
        if normalize:
            value = 0.5 * (value + 1.0)
        out[env, at + k * layout.channel] = value


@wp.kernel(enable_backward=False)
def write_labels(image: wp.array3d[int], normalize: bool, layout: ImageLayout, out: wp.array2d[float]):
    """Write labels as floats; ``normalize`` has no effect."""
    env, row, col = wp.tid()
    out[env, _pixel_start(layout, image.shape[2], row, col)] = float(image[env, row, col])
