# SPDX-License-Identifier: Apache-2.0
"""Shapes before a camera: where they are in its frame, which part of its picture they cover, and the order in depth.

A picture of a robot shows a few tens of shapes. For each of them one thread computes the pose relative to the camera
and the rectangle of pixels that its box covers. A ray then tests the shapes whose rectangle it is in, nearest first:
no tree of bounds has to follow the bodies, and most shapes cost a ray nothing but two comparisons.
"""

import newton
import warp as wp

__all__ = ["Lens", "MeshLevel", "SeenShapes", "linear_of", "list_shapes", "place_shapes"]

PLANE = wp.constant(int(newton.GeoType.PLANE))
SPHERE = wp.constant(int(newton.GeoType.SPHERE))
CAPSULE = wp.constant(int(newton.GeoType.CAPSULE))
ELLIPSOID = wp.constant(int(newton.GeoType.ELLIPSOID))
CYLINDER = wp.constant(int(newton.GeoType.CYLINDER))
CONE = wp.constant(int(newton.GeoType.CONE))
BOX = wp.constant(int(newton.GeoType.BOX))
FIELD = wp.constant(int(newton.GeoType.HFIELD))

_FAR_AWAY = wp.constant(1.0e30)
_EVERY_PIXEL = wp.constant(1 << 28)


@wp.struct
class Lens:
    """Lens and film of a camera, in pixels."""

    fx: float
    """Focal length over the width of a pixel."""
    fy: float
    """Focal length over the height of a pixel."""
    cx: float
    """Column at which the optical axis meets the film."""
    cy: float
    """Row at which it does."""
    near: float
    """Depth at which rays start [m]."""
    far: float
    """Largest depth [m]."""


@wp.struct
class MeshLevel:
    """A version of a mesh: as it is, or with fewer triangles."""

    mesh: wp.uint64
    """Id of the mesh."""
    error: float
    """Largest distance by which a vertex is not where it was, before the mesh is scaled [m]."""
    normals: wp.array[wp.vec3]
    """Normals of its vertices; empty for those of the faces."""
    part: wp.array[int]
    """Index of the shape that a face is of, less that of the slot; empty if all are of the slot's shape."""


@wp.struct
class SeenShapes:
    """Shapes that cameras may see, by slots: those of an environment in a row, and what all share in each of them."""

    first: wp.array[int]
    """First slot of each environment, and the number of slots, shape ``(num_envs + 1,)``."""
    env: wp.array[int]
    """Environment of a slot, shape ``(slots,)``."""
    shape: wp.array[int]
    """Shape of a slot, an index into the model, shape ``(slots,)``."""
    box: wp.array2d[wp.vec3]
    """Lower and upper corner of the box around a mesh in its own frame, before it is scaled, shape ``(slots, 2)``."""
    turn: wp.array[wp.mat33]
    """Rotation from the camera's frame, which looks along -z, to the shape's, divided by the scale of a mesh."""
    start: wp.array[wp.vec3]
    """Position of the camera in the frame of the shape [m]."""
    size: wp.array[wp.vec3]
    """Size of the shape in the form of ``newton.Model.shape_scale`` [m]."""
    kind: wp.array[int]
    """``newton.GeoType`` of the shape."""
    mesh: wp.array[wp.uint64]
    """Id of the version of its mesh that is drawn; 0 for a primitive."""
    versions: wp.array[wp.vec2i]
    """First and last row of its versions in the table of meshes, the finest first; -1 for a primitive."""
    level: wp.array[int]
    """Row of the version that is drawn; -1 for a primitive."""
    albedo: wp.array[wp.vec3]
    """Colour, linear RGB."""
    nearest: wp.array[float]
    """Least depth of its box [m]."""
    pixels: wp.array[wp.vec4i]
    """First column and row, and last column and row, of the pixels that its box covers; empty if first > last."""
    sphere: wp.array[wp.vec4]
    """Centre in the frame of the camera, and radius, of a sphere around it [m]."""
    listed: wp.array[int]
    """Slots of an environment that are in the picture, nearest first, from ``first`` on, shape ``(slots,)``."""
    count: wp.array[int]
    """Number of them, shape ``(num_envs,)``."""


@wp.func
def _half_extents(kind: int, size: wp.vec3) -> wp.vec3:
    """Half extents of the box around a primitive in its own frame [m]."""
    if kind == SPHERE:
        return wp.vec3(size[0], size[0], size[0])
    if kind == CAPSULE:
        return wp.vec3(size[0], size[0], size[0] + size[1])
    if kind == CYLINDER:
        radius = size[0]
        if size[2] > 0.0:  # a barrel is widest in its middle
            radius += size[1] * size[1] / (size[2] + wp.sqrt(wp.max(size[2] * size[2] - size[1] * size[1], 0.0)))
        return wp.vec3(radius, radius, size[1])
    if kind == CONE:
        return wp.vec3(size[0], size[0], size[1])
    if kind == PLANE:
        return wp.vec3(0.5 * size[0], 0.5 * size[1], 0.0)
    return wp.vec3(wp.abs(size[0]), wp.abs(size[1]), wp.abs(size[2]))


@wp.func
def _corner(half: wp.vec3, index: int) -> wp.vec3:
    """A corner of a box with half extents; each bit of ``index``, 0 to 7, is one axis."""
    return wp.vec3(
        wp.where((index & 1) != 0, half[0], -half[0]),
        wp.where((index & 2) != 0, half[1], -half[1]),
        wp.where((index & 4) != 0, half[2], -half[2]),
    )


@wp.func
def _cover(lens: Lens, point: wp.vec3, first: wp.vec2, last: wp.vec2):
    """Bounds of pixels that also cover a point in the frame of the camera."""
    share = 1.0 / wp.max(-point[2], 1.0e-6)
    column, row = lens.cx + lens.fx * point[0] * share, lens.cy - lens.fy * point[1] * share
    lower = wp.vec2(wp.min(first[0], column), wp.min(first[1], row))
    upper = wp.vec2(wp.max(last[0], column), wp.max(last[1], row))
    return lower, upper


@wp.func
def linear_of(value: float) -> float:
    """Linear value of an sRGB value, 0 to 1 (IEC 61966-2-1)."""
    bounded = wp.max(value, 0.0)
    if bounded <= 0.04045:
        return bounded / 12.92
    return wp.pow((bounded + 0.055) / 1.055, 2.4)


@wp.kernel(enable_backward=False)
def place_shapes(
    due: wp.array[wp.bool],
    camera: wp.array[wp.transform],
    lens: Lens,
    pose: wp.array[wp.transform],
    body: wp.array[int],
    body_pose: wp.array[wp.transform],
    scale: wp.array[wp.vec3],
    color: wp.array[wp.vec3],
    meshes: wp.array[MeshLevel],
    detail: float,
    seen: SeenShapes,
):
    """Compute where shapes are in the frames and pictures of the cameras; one thread a slot.

    Args:
        due: Environments that take a picture, shape ``(num_envs,)``.
        camera: Poses of the cameras in the world, looking along -z [m], shape ``(num_envs,)``.
        lens: The lens.
        pose: Poses of the shapes in the frames of their bodies [m], shape ``(num_shapes,)``.
        body: Bodies of the shapes, -1 for the world, shape ``(num_shapes,)``.
        body_pose: Poses of the bodies in the world [m].
        scale: Sizes of the shapes [m], shape ``(num_shapes,)``.
        color: Colours of the shapes, sRGB, shape ``(num_shapes,)``.
        meshes: Versions of meshes.
        detail: Largest distance by which a surface may move in the picture [px].
        seen: Output, everything but ``listed`` and ``count``.
    """
    slot = wp.tid()
    env, shape = seen.env[slot], seen.shape[slot]
    if not due[env]:
        return
    at = pose[shape]
    if body[shape] >= 0:
        at = body_pose[body[shape]] * at
    relative = wp.transform_inverse(at) * camera[env]
    turn = wp.quat_to_matrix(wp.transform_get_rotation(relative))
    start = wp.transform_get_translation(relative)
    size, kind = scale[shape], seen.kind[slot]
    centre, half = wp.vec3(0.0), _half_extents(kind, size)
    is_mesh = seen.mesh[slot] != wp.uint64(0)
    if is_mesh:
        low, high = wp.cw_mul(seen.box[slot, 0], size), wp.cw_mul(seen.box[slot, 1], size)
        centre = 0.5 * (low + high)
        half = wp.vec3(0.5 * wp.abs(high[0] - low[0]), 0.5 * wp.abs(high[1] - low[1]), 0.5 * wp.abs(high[2] - low[2]))
    back = wp.transpose(turn)
    middle = back * (centre - start)
    seen.sphere[slot] = wp.vec4(middle[0], middle[1], middle[2], wp.length(half))
    seen.size[slot] = size
    rgb = color[shape]
    seen.albedo[slot] = wp.vec3(linear_of(rgb[0]), linear_of(rgb[1]), linear_of(rgb[2]))

    # What is seen of a box is its part beyond the near plane: the corners there, and where edges cross the plane.
    first, last = wp.vec2(_FAR_AWAY, _FAR_AWAY), wp.vec2(-_FAR_AWAY, -_FAR_AWAY)
    nearest, farthest = wp.float32(_FAR_AWAY), wp.float32(-_FAR_AWAY)
    for corner in range(8):
        point = middle + back * _corner(half, corner)
        depth = -point[2]
        nearest, farthest = wp.min(nearest, depth), wp.max(farthest, depth)
        if depth >= lens.near:
            first, last = _cover(lens, point, first, last)
        for axis in range(3):
            if (corner & (1 << axis)) == 0:  # each edge once
                other = middle + back * _corner(half, corner | (1 << axis))
                share = (lens.near - depth) / (-other[2] - depth)
                if (depth >= lens.near) != (-other[2] >= lens.near):
                    first, last = _cover(lens, point + share * (other - point), first, last)
    pixels = wp.vec4i(0, 0, _EVERY_PIXEL, _EVERY_PIXEL)
    if kind == PLANE and (size[0] <= 0.0 or size[1] <= 0.0):
        nearest = 0.0
    elif farthest < lens.near or nearest > lens.far:
        pixels = wp.vec4i(1, 1, 0, 0)
    else:
        # Pixels whose middle, at a half, is within; a little more, for rounding.
        pixels = wp.vec4i(
            int(wp.ceil(wp.clamp(first[0], 0.0, 1.0e6) - 0.51)),
            int(wp.ceil(wp.clamp(first[1], 0.0, 1.0e6) - 0.51)),
            int(wp.floor(wp.clamp(last[0], -1.0, 1.0e6) - 0.49)),
            int(wp.floor(wp.clamp(last[1], -1.0, 1.0e6) - 0.49)),
        )
    seen.pixels[slot] = pixels
    seen.nearest[slot] = nearest
    if is_mesh:  # rays of meshes are scaled rather than their triangles
        over = wp.vec3(1.0 / size[0], 1.0 / size[1], 1.0 / size[2])
        turn = wp.diag(over) * turn
        start = wp.cw_mul(over, start)
        # The coarsest version whose error is too small to be seen from where the box is nearest.
        largest = wp.max(wp.abs(size[0]), wp.max(wp.abs(size[1]), wp.abs(size[2])))
        unseen = detail * wp.max(nearest, lens.near) / (wp.max(lens.fx, lens.fy) * largest)
        versions = seen.versions[slot]
        level = versions[0]
        while level < versions[1] and meshes[level + 1].error <= unseen:
            level += 1
        seen.level[slot] = level
        seen.mesh[slot] = meshes[level].mesh
    seen.turn[slot] = turn
    seen.start[slot] = start


@wp.kernel(enable_backward=False)
def list_shapes(due: wp.array[wp.bool], width: int, height: int, seen: SeenShapes):
    """List the shapes of each picture, nearest first; one thread an environment."""
    # One thread and in order, rather than atomics: where two surfaces coincide, the same one is seen in every run.
    env = wp.tid()
    if not due[env]:
        return
    first, count = seen.first[env], wp.int32(0)
    for slot in range(first, seen.first[env + 1]):
        pixels = seen.pixels[slot]
        if pixels[0] > pixels[2] or pixels[1] > pixels[3] or pixels[0] >= width or pixels[1] >= height:
            continue
        if pixels[2] < 0 or pixels[3] < 0:
            continue
        at = count
        while at > 0 and seen.nearest[seen.listed[first + at - 1]] > seen.nearest[slot]:
            seen.listed[first + at] = seen.listed[first + at - 1]
            at -= 1
        seen.listed[first + at] = slot
        count += 1
    seen.count[env] = count
