# SPDX-License-Identifier: Apache-2.0
"""Picture leaves: where foliage has leaves or needles and where one looks through it.

A triangle of foliage stands for a bunch of leaves. It is drawn by a mask that is computed where a ray meets it: leaves
in the cells of a grid in its plane, each with a place, a turn and a shade of its own from a hash. Traced triangles are
larger than the mesh's by a margin, so that leaves reach over its edges and no edge is straight.
"""

import warp as wp

from stripe_kernels.picture_noise import lattice

__all__ = ["LeafStyle", "leaf_at"]

NEEDLE = wp.constant(0.022)
"""Distance from one needle to the next [m]."""


@wp.struct
class LeafStyle:
    """Size and arrangement of the leaves of a mesh, in the mesh's frame."""

    length: wp.float32  # of a leaf or twig [m]; 0: the triangles are drawn whole
    width: wp.float32  # [m]
    rise: wp.float32  # where they point: outwards from the trunk, plus so much of the vertical
    spread: wp.float32  # largest turn from there [rad]
    needles: wp.int32  # 1: a twig with needles, 0: a leaf
    margin: wp.float32  # distance of the traced triangles' edges from those of the mesh [m]


@wp.func
def leaf_at(mesh: wp.uint64, face: int, point: wp.vec3f, style: LeafStyle, footprint: float):
    """Number of the leaf that a triangle has at a point of its plane, or -1 for none.

    Args:
        mesh: Mesh of traced triangles.
        face: The triangle.
        point: In the mesh's frame [m].
        style: Size and arrangement of the leaves.
        footprint: Size of a pixel there [m]: leaves are at least twice as large, or they would flicker.
    """
    tri = wp.mesh_get(mesh)
    a = tri.points[tri.indices[3 * face]]
    b = tri.points[tri.indices[3 * face + 1]]
    c = tri.points[tri.indices[3 * face + 2]]
    normal = wp.cross(b - a, c - a)
    area = wp.max(wp.length(normal), 1.0e-12)
    normal = normal / area
    la = wp.length(c - b)
    lb = wp.length(a - c)
    lc = wp.length(b - a)
    # The middle of the inscribed circle is as far from all edges: moving the edges by the margin keeps it.
    whole = area / (la + lb + lc)
    inner = wp.max(whole - style.margin, whole / 3.0)
    middle = (a * la + b * lb + c * lc) / (la + lb + lc)
    outwards = wp.normalize(wp.vec3f(middle[0], middle[1], 0.0)) + wp.vec3f(0.0, 0.0, style.rise)
    along = outwards - normal * wp.dot(outwards, normal)
    if wp.length(along) < 1.0e-3:
        along = b - a
    along = wp.normalize(along)
    across = wp.cross(normal, along)
    # Unit vectors into the triangle, perpendicular to its edges.
    na = wp.cross(normal, c - b) / la
    nb = wp.cross(normal, a - c) / lb
    nc = wp.cross(normal, b - a) / lc
    x = wp.dot(point - middle, along)
    y = wp.dot(point - middle, across)
    coarse = wp.max(1.0, wp.pow(2.0, wp.ceil(wp.log2(wp.max(2.0 * footprint / style.width, 1.0e-6)))))
    length = style.length * coarse
    width = style.width * coarse
    step_x = 0.6 * length
    step_y = 0.95 * width
    column = int(wp.floor(x / step_x))
    row = int(wp.floor(y / step_y))
    for j in range(-1, 2):
        for i in range(-1, 2):
            place = lattice(column + i, row + j, 3 * face)
            other = lattice(column + i, row + j, 3 * face + 1)
            px = (float(column + i) + 0.15 + 0.7 * place) * step_x
            py = (float(row + j) + 0.15 + 0.7 * other) * step_y
            at = along * px + across * py
            reach = (x - px) * (x - px) + (y - py) * (y - py)
            if (
                4.0 * reach < length * length
                and wp.min(wp.min(wp.dot(na, at), wp.dot(nb, at)), wp.dot(nc, at)) > -inner
            ):
                turn = lattice(column + i, row + j, 3 * face + 2)
                angle = (2.0 * turn - 1.0) * style.spread
                u = wp.cos(angle) * (x - px) + wp.sin(angle) * (y - py)
                v = wp.abs(wp.cos(angle) * (y - py) - wp.sin(angle) * (x - px))
                t = 2.0 * u / length
                half = 0.5 * width * (1.0 - t * t)
                if style.needles == 1:
                    half = 0.5 * width * (1.0 - 0.6 * t * t)
                    if v > 0.12 * width and footprint < 0.7 * NEEDLE:
                        comb = (u - 0.7 * v) / NEEDLE
                        if comb - wp.floor(comb) > 0.6:
                            half = 0.0
                if wp.abs(t) < 1.0 and v < half:
                    return int(65535.0 * lattice(column + i, row + j, face))
    return -1
