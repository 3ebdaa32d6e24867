# SPDX-License-Identifier: Apache-2.0
"""Picture kernels: pixels, smooth edges and shadow map of a frame, from what the rays of Newton's camera sensor hit.

The rays give distance, normal and shape; :mod:`.picture_light` gives the colour of a sample, and :mod:`.picture_colors`
its bytes.
"""

import warp as wp

from .picture_colors import encode, pack_color, texture_color
from .picture_light import Look, shade

__all__ = [
    "SAMPLES",
    "Look",
    "gather_bodies",
    "mark_edges",
    "pack_color",
    "resolve_edges",
    "shade",
    "shade_pixels",
    "shadow_casters",
    "texture_color",
]

SAMPLES = 4
"""Rays through a pixel that lies on an edge."""

FAR = wp.constant(1.0e30)
NO_HIT = wp.constant(wp.uint32(0xFFFFFFFF))


@wp.func
def sample_direction(look: Look, x: float, y: float):
    """Unit vector in the world through the point (x, y) of the picture, in pixels from its upper left corner."""
    u = (2.0 * x / float(look.width) - 1.0) * look.tan_x
    v = (1.0 - 2.0 * y / float(look.height)) * look.tan_y
    return wp.normalize(look.right * u + look.up * v - look.back)


@wp.func
def sample_offset(sample: int):
    """Position of a sample in its pixel, from 0 to 1: a rotated grid, whose points share no row and no column."""
    if sample == 0:
        return wp.vec2f(0.375, 0.125)
    if sample == 1:
        return wp.vec2f(0.875, 0.375)
    if sample == 2:
        return wp.vec2f(0.125, 0.625)
    return wp.vec2f(0.625, 0.875)


@wp.func
def shade_sample(
    look: Look,
    direction: wp.vec3f,
    i: int,
    depth: wp.array[wp.float32],
    shape: wp.array[wp.uint32],
    normal: wp.array[wp.vec3f],
    albedo: wp.array[wp.uint32],
    colors: wp.array[wp.vec3f],
    is_ground: wp.array[wp.int32],
    casters: wp.array[wp.float32],
    detail: wp.array[wp.vec4f],
):
    """Shade what ray ``i`` of the frame's camera found, with the colour of its shape or texture.

    ``albedo`` is empty if no shape has a texture, ``detail`` if there is no scenery.
    """
    ground = wp.bool(False)
    color = wp.vec3f(0.75, 0.75, 0.75)
    if shape[i] < wp.uint32(colors.shape[0]):
        color = colors[wp.int32(shape[i])]
        ground = is_ground[wp.int32(shape[i])] != 0
    packed = wp.uint32(0)
    if albedo.shape[0] > 0:
        packed = albedo[i]
    if packed != wp.uint32(0):
        color = texture_color(packed)
    lit = wp.vec4f(0.0, 0.0, 0.0, 1.0)
    if detail.shape[0] > 0:
        lit = detail[i]
    hit = shape[i] != NO_HIT
    return shade(look, look.eye, direction, depth[i], hit, normal[i], color, ground, casters, lit)


@wp.kernel(enable_backward=False)
def gather_bodies(source: wp.array[wp.transformf], index: wp.array[wp.int32], out: wp.array[wp.transformf]):
    """Copy the poses with the indices ``index``: ``out[i] = source[index[i]]``; one thread a pose."""
    i = wp.tid()
    out[i] = source[index[i]]


@wp.kernel(enable_backward=False)
def shade_pixels(
    look: Look,
    depth: wp.array[wp.float32],
    shape: wp.array[wp.uint32],
    normal: wp.array[wp.vec3f],
    albedo: wp.array[wp.uint32],
    colors: wp.array[wp.vec3f],
    is_ground: wp.array[wp.int32],
    casters: wp.array[wp.float32],
    detail: wp.array[wp.vec4f],
    picture: wp.array[wp.uint8],
    pixels: wp.array[wp.int32],
):
    """Shade one ray through the middle of each listed pixel; one thread a listed pixel."""
    pixel = pixels[wp.tid()]
    x = pixel % look.width
    y = pixel // look.width
    direction = sample_direction(look, float(x) + 0.5, float(y) + 0.5)
    color = shade_sample(look, direction, pixel, depth, shape, normal, albedo, colors, is_ground, casters, detail)
    encode(color, pixel, picture)


@wp.func
def is_backdrop(shape: wp.uint32, still: wp.array[wp.int32]):
    """Whether a pixel shows scenery or the sky."""
    if shape == NO_HIT:
        return True
    if shape >= wp.uint32(still.shape[0]):
        return False
    return still[wp.int32(shape)] != 0


@wp.func
def is_edge(i: int, j: int, shape: wp.array[wp.uint32], normal: wp.array[wp.vec3f], still: wp.array[wp.int32]):
    """Whether two pixels show different surfaces: another shape, or normals more than 45 degrees apart.

    Pixels within scenery have no edges: its leaves would be edges everywhere.
    """
    within = wp.bool(False)
    if still.shape[0] > 0:
        within = is_backdrop(shape[i], still)
    if within:
        within = is_backdrop(shape[j], still)
    if within:
        return False
    if shape[i] != shape[j]:
        return True
    if wp.dot(normal[i], normal[j]) < 0.7:
        return shape[i] != NO_HIT  # the sky's normals are undefined
    return False


@wp.kernel(enable_backward=False)
def mark_edges(
    look: Look,
    shape: wp.array[wp.uint32],
    normal: wp.array[wp.vec3f],
    still: wp.array[wp.int32],
    pixels: wp.array[wp.int32],
    capacity: wp.int32,
    count: wp.array[wp.int32],
    edges: wp.array[wp.int32],
    rays: wp.array2d[wp.vec3f],
):
    """List those of the listed pixels whose neighbours show another surface, with rays (camera frame) for each.

    ``count`` may exceed ``capacity``; pixels beyond it are not listed and keep the one sample they have.
    """
    pixel = pixels[wp.tid()]
    x = pixel % look.width
    y = pixel // look.width
    edge = wp.bool(False)
    if x > 0:
        edge = edge or is_edge(pixel, pixel - 1, shape, normal, still)
    if x + 1 < look.width and not edge:
        edge = is_edge(pixel, pixel + 1, shape, normal, still)
    if y > 0 and not edge:
        edge = is_edge(pixel, pixel - look.width, shape, normal, still)
    if y + 1 < look.height and not edge:
        edge = is_edge(pixel, pixel + look.width, shape, normal, still)
    if not edge:
        return
    # The order of the list differs from run to run, the picture does not: each pixel is resolved on its own.
    slot = wp.atomic_add(count, 0, 1)
    if slot >= capacity:
        return
    edges[slot] = pixel
    for sample in range(wp.static(SAMPLES)):
        offset = sample_offset(sample)
        u = (2.0 * (float(x) + offset[0]) / float(look.width) - 1.0) * look.tan_x
        v = (1.0 - 2.0 * (float(y) + offset[1]) / float(look.height)) * look.tan_y
        rays[slot * wp.static(SAMPLES) + sample, 0] = wp.vec3f(0.0)
        rays[slot * wp.static(SAMPLES) + sample, 1] = wp.normalize(wp.vec3f(u, v, -1.0))


@wp.kernel(enable_backward=False)
def resolve_edges(
    look: Look,
    pixels: wp.array[wp.int32],
    depth: wp.array[wp.float32],
    shape: wp.array[wp.uint32],
    normal: wp.array[wp.vec3f],
    albedo: wp.array[wp.uint32],
    colors: wp.array[wp.vec3f],
    is_ground: wp.array[wp.int32],
    casters: wp.array[wp.float32],
    detail: wp.array[wp.vec4f],
    picture: wp.array[wp.uint8],
):
    """Shade the samples of each listed pixel and write their mean; one thread a listed pixel."""
    slot = wp.tid()
    pixel = pixels[slot]
    x = pixel % look.width
    y = pixel // look.width
    total = wp.vec3f(0.0)
    for sample in range(wp.static(SAMPLES)):
        i = slot * wp.static(SAMPLES) + sample
        offset = sample_offset(sample)
        direction = sample_direction(look, float(x) + offset[0], float(y) + offset[1])
        total += shade_sample(look, direction, i, depth, shape, normal, albedo, colors, is_ground, casters, detail)
    encode(total / float(wp.static(SAMPLES)), pixel, picture)


@wp.func
def caster_distance(i: int, depth: wp.array[wp.float32], shape: wp.array[wp.uint32], is_ground: wp.array[wp.int32]):
    """Distance along the sun's ray of texel ``i`` to the first shape, ``FAR`` if that is a ground or nothing [m]."""
    s = shape[i]
    if s == NO_HIT:
        return FAR
    if s < wp.uint32(is_ground.shape[0]) and is_ground[wp.int32(s)] != 0:
        return FAR
    return depth[i]


@wp.kernel(enable_backward=False)
def shadow_casters(
    size: wp.int32,
    depth: wp.array[wp.float32],
    shape: wp.array[wp.uint32],
    is_ground: wp.array[wp.int32],
    casters: wp.array[wp.float32],
):
    """Write the shadow map: distance along each ray of the sun to what casts a shadow; one thread a texel.

    Grounds receive shadows and cast none. A ray that hits nothing takes the nearest caster of its neighbours, so that
    shapes thinner than a texel leave no gaps.
    """
    i = wp.tid()
    x = i % size
    y = i // size
    distance = caster_distance(i, depth, shape, is_ground)
    if distance == FAR and x > 0 and y > 0 and x < size - 1 and y < size - 1:
        distance = wp.min(
            wp.min(caster_distance(i - 1, depth, shape, is_ground), caster_distance(i + 1, depth, shape, is_ground)),
            wp.min(
                caster_distance(i - size, depth, shape, is_ground),
                caster_distance(i + size, depth, shape, is_ground),
            ),
        )
    casters[i] = distance
