# SPDX-License-Identifier: Apache-2.0
"""Terrain data: the ground that all environments share, a height field and a grid of tiles, with height lookups.

The field is ``nrow`` by ``ncol`` heights, rows along y, columns along x. Each cell is cut into two triangles from its
corner (row + 1, column) to its corner (row, column + 1), as for contacts (``stripe_kernels.heightfield``): lookups find
the surface that robots stand on. Beyond the edge of the field lookups return the height at the edge; there is nothing
to stand on.

An imported world is a triangle mesh instead, with several floors above each other. Lookups by x and y find its highest
surface, and :func:`ground_below` the one below a point.
"""

import warp as wp

__all__ = ["TerrainData", "ground_below", "max_ground_below", "terrain_height", "terrain_max_height", "terrain_normal"]


@wp.struct
class TerrainData:
    """Height field of the ground, its tiles, and the tile of each environment."""

    heights: wp.array2d[float]
    """Heights in the world [m], shape ``(nrow, ncol)``."""
    lower: wp.vec2
    """World x and y of ``heights[0, 0]`` [m]."""
    cell: wp.vec2
    """Spacing in x and y [m]."""
    tile: wp.vec2
    """Size of a tile in x and y [m]."""
    origins: wp.array2d[wp.vec3]
    """Origins of the tiles in the world, at which robots start [m], shape ``(num_levels, num_types)``: levels along x,
    the hardest last."""
    init_pos: wp.array3d[wp.vec3]
    """Flat patches to start on, in the world [m], shape ``(num_levels, num_types, num_patches)``; may be empty."""
    target: wp.array3d[wp.vec3]
    """Flat patches to walk to, in the world [m], shape ``(num_levels, num_types, num_patches)``; may be empty."""
    level: wp.array[int]
    """Level of each environment, shape ``(num_envs,)``."""
    kind: wp.array[int]
    """Type of each environment's tile, a column of the grid of tiles, shape ``(num_envs,)``."""
    env_origin: wp.array[wp.vec3]
    """Origins of the environments in the world [m], shape ``(num_envs,)``; the same memory that assets read."""
    mesh: wp.uint64
    """Id of the mesh of an imported world; 0 for a height field."""
    top: float
    """A height above that mesh [m]."""
    bottom: float
    """A height below that mesh, at which robots have left it [m]."""


@wp.func
def _grid_coordinate(x: float, lower: float, cell: float, count: int) -> float:
    """Grid coordinate of a point among ``count`` vertices [cells], limited to the grid; 0 for NaN."""
    # A comparison with NaN is false: a diverged robot gets the first cell rather than an undefined index.
    u = (x - lower) / cell
    return wp.where(u > 0.0, wp.min(u, float(count - 1)), 0.0)


@wp.func
def _mesh_below(terrain: TerrainData, pos: wp.vec3) -> float:
    """Height of the mesh below a point, or its bottom where there is none or the point is not finite [m]."""
    down = wp.vec3(0.0, 0.0, -1.0)
    length = pos[2] - terrain.bottom
    height = terrain.bottom
    if length > 0.0:  # a comparison with NaN is false
        query = wp.mesh_query_ray(terrain.mesh, pos, down, length)
        if query.result:
            height = pos[2] - query.t
    return height


@wp.func
def terrain_height(terrain: TerrainData, x: float, y: float) -> float:
    """Height of the ground in the world at a point (x, y) of the world [m]."""
    if terrain.mesh != wp.uint64(0):
        return _mesh_below(terrain, wp.vec3(x, y, terrain.top))
    nrow, ncol = terrain.heights.shape[0], terrain.heights.shape[1]
    u = _grid_coordinate(x, terrain.lower[0], terrain.cell[0], ncol)
    v = _grid_coordinate(y, terrain.lower[1], terrain.cell[1], nrow)
    col, row = wp.min(int(u), ncol - 2), wp.min(int(v), nrow - 2)  # the last vertex belongs to the last cell
    fx, fy = u - float(col), v - float(row)
    right, up = terrain.heights[row, col + 1], terrain.heights[row + 1, col]
    if fx + fy <= 1.0:
        corner = terrain.heights[row, col]
        return corner + fx * (right - corner) + fy * (up - corner)
    corner = terrain.heights[row + 1, col + 1]
    return corner + (1.0 - fx) * (up - corner) + (1.0 - fy) * (right - corner)


@wp.func
def terrain_normal(terrain: TerrainData, x: float, y: float) -> wp.vec3:
    """Upward unit normal of the ground in the world at a point (x, y) of the world [m]."""
    if terrain.mesh != wp.uint64(0):
        query = wp.mesh_query_ray(
            terrain.mesh, wp.vec3(x, y, terrain.top), wp.vec3(0.0, 0.0, -1.0), terrain.top - terrain.bottom
        )
        normal = wp.vec3(0.0, 0.0, 1.0)
        if query.result:
            normal = query.normal * wp.where(query.normal[2] < 0.0, -1.0, 1.0)  # both sides of a triangle are walked on
        return normal
    nrow, ncol = terrain.heights.shape[0], terrain.heights.shape[1]
    u = _grid_coordinate(x, terrain.lower[0], terrain.cell[0], ncol)
    v = _grid_coordinate(y, terrain.lower[1], terrain.cell[1], nrow)
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
def _max_mesh_below(terrain: TerrainData, pos: wp.vec3, reach: float) -> float:
    """Greatest height of the mesh below 9 by 9 points of a square about a point [m]."""
    top = terrain.bottom
    for i in range(9):
        for j in range(9):
            x, y = 0.25 * float(i - 4) * reach, 0.25 * float(j - 4) * reach
            top = wp.max(top, _mesh_below(terrain, pos + wp.vec3(x, y, 0.0)))
    return top


@wp.func
def terrain_max_height(terrain: TerrainData, x: float, y: float, reach: float) -> float:
    """Greatest height of the ground in a square about a point of the world [m].

    Args:
        terrain: The ground.
        x: World x of the middle [m].
        y: World y of the middle [m].
        reach: Half the side of the square [m], which is widened to whole cells; for 0 or less the height at the point
            is returned.
    """
    if not reach > 0.0:
        return terrain_height(terrain, x, y)
    if terrain.mesh != wp.uint64(0):
        return _max_mesh_below(terrain, wp.vec3(x, y, terrain.top), reach)
    nrow, ncol = terrain.heights.shape[0], terrain.heights.shape[1]
    first_col = int(wp.floor(_grid_coordinate(x - reach, terrain.lower[0], terrain.cell[0], ncol)))
    last_col = int(wp.ceil(_grid_coordinate(x + reach, terrain.lower[0], terrain.cell[0], ncol)))
    first_row = int(wp.floor(_grid_coordinate(y - reach, terrain.lower[1], terrain.cell[1], nrow)))
    last_row = int(wp.ceil(_grid_coordinate(y + reach, terrain.lower[1], terrain.cell[1], nrow)))
    # The ground is linear on each triangle, so its maximum over whole cells is at a vertex.
    top = terrain.heights[first_row, first_col]
    for row in range(first_row, last_row + 1):
        for col in range(first_col, last_col + 1):
            top = wp.max(top, terrain.heights[row, col])
    return top


@wp.func
def ground_below(terrain: TerrainData, pos: wp.vec3) -> float:
    """Height of the ground below a point of the world, on its own storey of an imported world [m].

    A height field has one height at x and y. Where nothing is below, it is the ``bottom`` of the world.
    """
    if terrain.mesh != wp.uint64(0):
        return _mesh_below(terrain, pos)
    return terrain_height(terrain, pos[0], pos[1])


@wp.func
def max_ground_below(terrain: TerrainData, pos: wp.vec3, reach: float) -> float:
    """Greatest height of the ground below a square about a point of the world [m].

    Args:
        terrain: The ground.
        pos: Middle of the square, above which nothing counts [m].
        reach: Half the side of the square [m]. On a mesh 9 by 9 points are looked at.
    """
    if terrain.mesh != wp.uint64(0):
        return _max_mesh_below(terrain, pos, wp.max(reach, 0.0))
    return terrain_max_height(terrain, pos[0], pos[1], reach)
