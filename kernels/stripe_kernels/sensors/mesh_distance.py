# SPDX-License-Identifier: Apache-2.0
"""Mesh distance: how far points are from the surface of a mesh."""

import warp as wp

__all__ = ["measure_distances"]

_ANYWHERE = wp.constant(1.0e6)


@wp.kernel(enable_backward=False)
def measure_distances(mesh: wp.uint64, points: wp.array[wp.vec3], distances: wp.array[float]):
    """Measure the distance of each point from a mesh [m], shape ``(points,)``; one thread a point."""
    i = wp.tid()
    found = wp.mesh_query_point_no_sign(mesh, points[i], _ANYWHERE)
    nearest = wp.mesh_eval_position(mesh, found.face, found.u, found.v)
    distances[i] = wp.length(points[i] - nearest)
