# SPDX-License-Identifier: Apache-2.0
"""The ground that all environments share, as terms read it: a height field, and a grid of tiles with origins.

The field is ``nrow`` by ``ncol`` heights, rows along y, columns along x. Each cell is cut into two triangles from its
corner (row + 1, column) to its corner (row, column + 1), as contacts have it (``stripe_kernels.heightfield``), so that
what is found here is the surface that robots stand on. Beyond its edge the field goes on level, for lookups alone.
"""

import warp as wp

__all__ = ["TerrainData", "terrain_height", "terrain_max_height", "terrain_normal"]


@wp.struct
class TerrainData:
    """The ground, and on which tile of it each environment stands."""

    heights: wp.array2d[float]
    """Heights in the world [m], shape ``(nrow, ncol)``."""
    lower: wp.vec2
    """World x and y of ``heights[0, 0]`` [m]."""
    cell: wp.vec2
    """Spacing in x and y [m]."""
    tile: wp.vec2
    """Size of a tile in x and y [m]."""
    origins: wp.array2d[wp.vec3]
    """Where robots start on a tile [m], shape ``(num_levels, num_types)``: levels along x, the hardest last."""
    init_pos: wp.array3d[wp.vec3]
    """Level patches of ground to start on [m], shape ``(num_levels, num_types, num_patches)``; may have none."""
    target: wp.array3d[wp.vec3]
    """Level patches of ground to go to [m], shape ``(num_levels, num_types, num_patches)``; may have none."""
    level: wp.array[int]
    """Level of each environment, shape ``(num_envs,)``."""
    kind: wp.array[int]
    """Type of each environment, a column of the grid, shape ``(num_envs,)``."""
    env_origin: wp.array[wp.vec3]
    """Origins of the environments [m], shape ``(num_envs,)``; the memory that the assets read, too."""


@wp.func
def _along(x: float, lower: float, cell: float, count: int) -> float:
    """Where a coordinate lies among ``count`` vertices, in cells; 0 for what is not a number."""
    u = (x - lower) / cell
    return wp.where(u > 0.0, wp.min(u, float(count - 1)), 0.0)


@wp.func
def terrain_height(terrain: TerrainData, x: float, y: float) -> float:
    """Height of the ground at a point of the world [m]."""
    nrow, ncol = terrain.heights.shape[0], terrain.heights.shape[1]
    u = _along(x, terrain.lower[0], terrain.cell[0], ncol)
    v = _along(y, terrain.lower[1], terrain.cell[1], nrow)
    col, row = wp.min(int(u), ncol - 2), wp.min(int(v), nrow - 2)
    fx, fy = u - float(col), v - float(row)
    right, up = terrain.heights[row, col + 1], terrain.heights[row + 1, col]
    if fx + fy <= 1.0:
        corner = terrain.heights[row, col]
        return corner + fx * (right - corner) + fy * (up - corner)
    corner = terrain.heights[row + 1, col + 1]
    return corner + (1.0 - fx) * (up - corner) + (1.0 - fy) * (right - corner)


@wp.func
def terrain_normal(terrain: TerrainData, x: float, y: float) -> wp.vec3:
    """Unit normal of the ground at a point of the world, upwards."""
    nrow, ncol = terrain.heights.shape[0], terrain.heights.shape[1]
    u = _along(x, terrain.lower[0], terrain.cell[0], ncol)
    v = _along(y, terrain.lower[1], terrain.cell[1], nrow)
    col, row = wp.min(int(u), ncol - 2), wp.min(int(v), nrow - 2)
    right, up = terrain.heights[row, col + 1], terrain.heights[row + 1, col]
    slope_x, slope_y = wp.float32(0.0), wp.float32(0.0)
    if (u - float(col)) + (v - float(row)) <= 1.0:
        slope_x = (right - terrain.heights[row, col]) / terrain.cell[0]
        slope_y = (up - terrain.heights[row, col]) / terrain.cell[1]
    else:
        slope_x = (terrain.heights[row + 1, col + 1] - up) / terrain.cell[0]
        slope_y = (terrain.heights[row + 1, col + 1] - right) / terrain.cell[1]
    return wp.normalize(wp.vec3(-slope_x, -slope_y, 1.0))


@wp.func
def terrain_max_height(terrain: TerrainData, x: float, y: float, reach: float) -> float:
    """Greatest height of the ground in a square about a point of the world [m].

    Args:
        terrain: The ground.
        x: World x of the middle [m].
        y: World y of the middle [m].
        reach: Half the side of the square [m]; it is widened to whole cells. 0 or less: the height at the point.
    """
    if not reach > 0.0:
        return terrain_height(terrain, x, y)
    nrow, ncol = terrain.heights.shape[0], terrain.heights.shape[1]
    first_col = int(wp.floor(_along(x - reach, terrain.lower[0], terrain.cell[0], ncol)))
    last_col = int(wp.ceil(_along(x + reach, terrain.lower[0], terrain.cell[0], ncol)))
    first_row = int(wp.floor(_along(y - reach, terrain.lower[1], terrain.cell[1], nrow)))
    last_row = int(wp.ceil(_along(y + reach, terrain.lower[1], terrain.cell[1], nrow)))
    top = terrain.heights[first_row, first_col]
    for row in range(first_row, last_row + 1):
        for col in range(first_col, last_col + 1):
            top = wp.max(top, terrain.heights[row, col])
    return top
