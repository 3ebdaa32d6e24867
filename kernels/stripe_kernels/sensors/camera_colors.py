# SPDX-License-Identifier: Apache-2.0
"""Camera colours: light and air of the pixels that Newton's camera sensor traces, as videos have them."""

import newton
import warp as wp

from stripe_kernels.picture_colors import pack_color, texture_color
from stripe_kernels.picture_light import Look, shade

__all__ = ["color_pixels"]

_PLANE = wp.constant(int(newton.GeoType.PLANE))
_FIELD = wp.constant(int(newton.GeoType.HFIELD))
_NOTHING = wp.constant(wp.uint32(0xFFFFFFFF))
_SHADED = wp.constant(0.65)
"""Share of the light between that of a point in Newton's shadow, 0.3, and that of one in the sun, 1."""


@wp.func
def linear(c: float):
    """Linear value of an sRGB value, both 0 to 1 (IEC 61966-2-1)."""
    if c <= 0.04045:
        return c / 12.92
    return wp.pow((c + 0.055) / 1.055, 2.4)


@wp.func
def sun_share(look: Look, sunlight: wp.vec3f, albedo: wp.vec3f, normal: wp.vec3f):
    """Share of the sun, 0 or 1, from the light that Newton's sensor found under a white sun alone."""
    expected = wp.max(albedo) * wp.max(wp.dot(normal, look.to_sun), 0.0)
    found = wp.max(sunlight)
    # None at all is found where the sensor had no normal, see box_normals.py.
    return wp.where(found > 0.0 and found < _SHADED * expected, 0.0, 1.0)


@wp.kernel(enable_backward=False)
def color_pixels(
    look: Look,
    due: wp.array[wp.bool],
    camera: wp.array[wp.transform],
    rays: wp.array4d[wp.vec3],
    distance: wp.array3d[float],
    shape: wp.array3d[wp.uint32],
    normal: wp.array3d[wp.vec3],
    texture: wp.array3d[wp.uint32],
    sunlight: wp.array3d[wp.vec3],
    shape_color: wp.array[wp.vec3],
    shape_kind: wp.array[int],
    background: wp.uint32,
    casters: wp.array[float],
    color: wp.array3d[wp.uint32],
):
    """Shade what rays found; one thread a pixel.

    Args:
        look: Light, air, and the size of a pixel.
        due: Whether an environment takes a picture in this step, shape ``(cameras,)``.
        camera: Poses of the cameras in the world, shape ``(cameras,)``.
        rays: Starts and directions of the rays in the frames of the cameras, shape ``(height, width, 1, 2)``.
        distance: Lengths of the rays [m], shape ``(cameras, height, width)``.
        shape: Shapes that they hit, same shape.
        normal: Unit normals in the world, same shape.
        texture: Packed sRGB colours of the surfaces; empty if nothing has a texture.
        sunlight: Light under a white sun of strength 1 alone; empty without shadows.
        shape_color: sRGB of the shapes, shape ``(num_shapes,)``.
        shape_kind: ``newton.GeoType`` of the shapes, shape ``(num_shapes,)``.
        background: Packed colour where there is nothing; 0 for the sky.
        casters: Shadow map, which sensors have not; empty.
        color: Output, packed sRGB, shape ``(cameras, height, width)``.
    """
    c, row, column = wp.tid()
    if not due[c]:
        return
    found = shape[c, row, column]
    hit = found != _NOTHING
    if not hit and background != wp.uint32(0):
        color[c, row, column] = background
        return
    eye = wp.transform_point(camera[c], rays[row, column, 0, 0])
    direction = wp.transform_vector(camera[c], rays[row, column, 0, 1])
    albedo = wp.vec3(0.75, 0.75, 0.75)
    ground = wp.bool(False)
    if found < wp.uint32(shape_color.shape[0]):
        own = shape_color[int(found)]
        albedo = wp.vec3(linear(own[0]), linear(own[1]), linear(own[2]))
        ground = shape_kind[int(found)] == _PLANE or shape_kind[int(found)] == _FIELD
    if texture.shape[0] > 0 and hit:
        albedo = texture_color(texture[c, row, column])
    detail = wp.vec4(0.0, 0.0, 0.0, 1.0)
    if sunlight.shape[0] > 0 and hit:
        detail[3] = sun_share(look, sunlight[c, row, column], albedo, normal[c, row, column])
    length = distance[c, row, column]
    lit = shade(look, eye, direction, length, hit, normal[c, row, column], albedo, ground, casters, detail)
    color[c, row, column] = pack_color(lit)
