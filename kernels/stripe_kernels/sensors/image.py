# SPDX-License-Identifier: Apache-2.0
"""Image observations: a camera's pixels as floats, row by row from the upper left, channels last.

Kernels run one thread a pixel, (environment, row, column), and write to ``out``, shape ``(num_envs, numbers)``, from
column ``first`` on.
"""

import warp as wp

__all__ = ["sum_colors", "write_colors", "write_depth", "write_labels", "write_normals"]


@wp.func
def _pixel_start(image_width: int, channels: int, row: int, col: int) -> int:
    """Index of the first number of a pixel."""
    return (row * image_width + col) * channels


@wp.kernel(enable_backward=False)
def sum_colors(image: wp.array4d[wp.uint8], sums: wp.array2d[wp.uint32]):
    """Sum the colours of each picture; ``sums`` has shape ``(num_envs, 3)``."""
    env, row, col = wp.tid()
    # Sums of integers do not depend on the order of the threads, so that normalised pictures are reproducible.
    for k in range(3):
        wp.atomic_add(sums, env, k, wp.uint32(image[env, row, col, k]))


@wp.kernel(enable_backward=False)
def write_colors(
    image: wp.array4d[wp.uint8], normalize: bool, sums: wp.array2d[wp.uint32], first: int, out: wp.array2d[float]
):
    """Write colours from 0 to 255; with ``normalize`` ``c / 255 - mean(c / 255)``, the mean of each channel."""
    env, row, col = wp.tid()
    at = first + _pixel_start(image.shape[2], 3, row, col)
    for k in range(3):
        value = float(image[env, row, col, k])
        if normalize:
            value = (value - float(sums[env, k]) / float(image.shape[1] * image.shape[2])) / 255.0
        out[env, at + k] = value


@wp.kernel(enable_backward=False)
def write_depth(image: wp.array3d[float], normalize: bool, first: int, out: wp.array2d[float]):
    """Write depths [m]; with ``normalize`` 0 in place of infinity."""
    env, row, col = wp.tid()
    value = image[env, row, col]
    if normalize and wp.isinf(value):
        value = 0.0
    out[env, first + _pixel_start(image.shape[2], 1, row, col)] = value


@wp.kernel(enable_backward=False)
def write_normals(image: wp.array3d[wp.vec3], normalize: bool, first: int, out: wp.array2d[float]):
    """Write unit normals; with ``normalize`` ``(n + 1) / 2``."""
    env, row, col = wp.tid()
    at = first + _pixel_start(image.shape[2], 3, row, col)
    for k in range(3):
        value = image[env, row, col][k]
        if normalize:
            value = 0.5 * (value + 1.0)
        out[env, at + k] = value


@wp.kernel(enable_backward=False)
def write_labels(image: wp.array3d[int], normalize: bool, first: int, out: wp.array2d[float]):
    """Write labels as floats; ``normalize`` has no effect."""
    env, row, col = wp.tid()
    out[env, first + _pixel_start(image.shape[2], 1, row, col)] = float(image[env, row, col])
