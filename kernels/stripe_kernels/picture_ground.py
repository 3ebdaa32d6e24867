# SPDX-License-Identifier: Apache-2.0
"""Picture of the ground: the colours of a height field with moss and litter, for viewers that draw textures."""

import warp as wp

from stripe_kernels.picture_noise import ground_albedo

__all__ = ["draw_ground"]


@wp.kernel
def draw_ground(
    colors: wp.array2d[wp.vec3f],
    heights: wp.array2d[wp.float32],
    lower: wp.vec2f,
    size: wp.vec2f,
    picture: wp.array2d[wp.vec3f],
):
    """Draw the ground from above, a thread for each pixel.

    Args:
        colors: Colours on the grid of the height field, rows along y, linear RGB.
        heights: Heights on the same grid, world frame [m].
        lower: Place of the grid's first point, world frame [m].
        size: Extent of the grid along x and y [m].
        picture: Receives linear RGB. The first row is at the largest y, as pictures have it.
    """
    row, column = wp.tid()
    rows, columns = picture.shape[0], picture.shape[1]
    # Middles of pixels, as shares of the extent.
    x = (float(column) + 0.5) / float(columns)
    y = 1.0 - (float(row) + 0.5) / float(rows)
    u = wp.clamp(x * float(colors.shape[1] - 1), 0.0, float(colors.shape[1]) - 1.001)
    v = wp.clamp(y * float(colors.shape[0] - 1), 0.0, float(colors.shape[0]) - 1.001)
    c = int(u)
    r = int(v)
    fu = u - float(c)
    fv = v - float(r)
    near = wp.lerp(colors[r, c], colors[r, c + 1], fu)
    far = wp.lerp(colors[r + 1, c], colors[r + 1, c + 1], fu)
    low = heights[r, c] * (1.0 - fu) + heights[r, c + 1] * fu
    high = heights[r + 1, c] * (1.0 - fu) + heights[r + 1, c + 1] * fu
    point = wp.vec3f(lower[0] + x * size[0], lower[1] + y * size[1], low * (1.0 - fv) + high * fv)
    picture[row, column] = ground_albedo(wp.lerp(near, far, fv), point, size[0] / float(columns))
