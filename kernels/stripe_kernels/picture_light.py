# SPDX-License-Identifier: Apache-2.0
"""Picture light: sky, sun and its shadows, ground pattern, haze and tone of one sample, all in linear RGB."""

import warp as wp

__all__ = ["Look", "shade", "sky_color", "sun_visibility"]

STEEPEST = wp.constant(20.0)
"""Largest slope of a surface towards the sun by which the shadow test follows it."""


@wp.struct
class Look:
    """Camera, light, air and shadow map of a frame: the inputs that all pixels share."""

    width: wp.int32  # pixels
    height: wp.int32
    tan_x: wp.float32  # half the picture's width and height at distance 1
    tan_y: wp.float32
    eye: wp.vec3f  # position of the camera in the world [m]
    right: wp.vec3f  # axes of the camera in the world, unit vectors; it looks along -back
    up: wp.vec3f
    back: wp.vec3f
    to_sun: wp.vec3f  # unit vector
    sun: wp.vec3f  # radiance of the sun, of the sky from above and of the ground from below, linear RGB
    sky: wp.vec3f
    ground: wp.vec3f
    horizon: wp.vec3f  # colours of the sky, linear RGB
    zenith: wp.vec3f
    fog_start: wp.float32  # distance from the camera [m]
    fog_length: wp.float32  # [m], 0: none
    near: wp.float32  # distance from which on scenery other than the ground is shown [m]
    haze: wp.float32  # share of light lost to haze [1/m], 0: none
    air: wp.float32  # brightness of the haze: less below a canopy
    exposure: wp.float32
    tile: wp.float32  # side of a square of the ground pattern [m]
    shadow_size: wp.int32  # side of the shadow map [texels], 0: no shadows
    shadow_half: wp.float32  # half the side of the shadow map [m]
    shadow_start: wp.float32  # distance from the map's centre towards the sun at which its rays begin [m]
    shadow_center: wp.vec3f  # in the world [m]
    shadow_x: wp.vec3f  # axes of the shadow map in the world, unit vectors
    shadow_y: wp.vec3f


@wp.func
def sky_color(look: Look, direction: wp.vec3f):
    """Colour of the sky in a direction: a gradient from horizon to zenith and a glow around the sun."""
    height = wp.clamp(direction[2], 0.0, 1.0)
    blend = 1.0 - (1.0 - height) * (1.0 - height)
    blend = blend * (1.55 - 0.55 * blend)
    color = look.horizon + (look.zenith - look.horizon) * blend
    glow = wp.max(wp.dot(direction, look.to_sun), 0.0)
    glow = glow * glow
    glow = glow * glow
    return color + look.sun * (0.05 * glow * glow)


@wp.func
def checker_integral(x: float):
    """Integral from 0 to ``x`` of the square wave that is +1 on [0, 1) and -1 on [1, 2)."""
    h = 0.5 * x
    return 1.0 - wp.abs(2.0 * (h - wp.floor(h)) - 1.0)


@wp.func
def line_integral(x: float, half: float):
    """Integral up to ``x`` of the comb that is 1 within ``half`` of a whole number and 0 elsewhere."""
    n = wp.floor(x + half)
    return n * 2.0 * half + wp.min(x + half - n, 2.0 * half)


@wp.func
def ground_pattern(look: Look, point: wp.vec3f, direction: wp.vec3f, normal: wp.vec3f, distance: float):
    """Brightness factor of the ground: squares and their joints, averaged over the pixel's footprint."""
    # A box filter in closed form: the difference of the pattern's integrals at both ends of the footprint, over its
    # width. A pattern sampled at a point would flicker far away, where many squares fall into a pixel.
    pixel = 2.0 * look.tan_y / float(look.height) * distance
    slope = wp.max(wp.abs(wp.dot(direction, normal)), 1.0e-3)
    flat = wp.vec2f(direction[0], direction[1])
    flat_length = wp.max(wp.length(flat), 1.0e-6)
    along_x = wp.abs(flat[0]) / flat_length
    along_y = wp.abs(flat[1]) / flat_length
    stretch = pixel / slope
    wx = (along_x * stretch + along_y * pixel) / look.tile + 1.0e-4
    wy = (along_y * stretch + along_x * pixel) / look.tile + 1.0e-4
    x = point[0] / look.tile
    y = point[1] / look.tile
    cx = (checker_integral(x + 0.5 * wx) - checker_integral(x - 0.5 * wx)) / wx
    cy = (checker_integral(y + 0.5 * wy) - checker_integral(y - 0.5 * wy)) / wy
    half = 0.009
    lx = (line_integral(x + 0.5 * wx, half) - line_integral(x - 0.5 * wx, half)) / wx
    ly = (line_integral(y + 0.5 * wy, half) - line_integral(y - 0.5 * wy, half)) / wy
    line = lx + ly - lx * ly
    return (1.0 + 0.075 * cx * cy) * (1.0 + 0.38 * line)


@wp.func
def shadow_tap(casters: wp.array[wp.float32], size: int, ix: int, iy: int, depth: float):
    """Shadow test: 1 if the caster of texel (ix, iy) is nearer to the sun than ``depth`` [m], else 0; 0 off the map."""
    if ix < 0 or iy < 0 or ix >= size or iy >= size:
        return 0.0
    if casters[iy * size + ix] < depth:
        return 1.0
    return 0.0


@wp.func
def sun_visibility(look: Look, casters: wp.array[wp.float32], point: wp.vec3f, normal: wp.vec3f):
    """Share of the sun that reaches ``point``: the shadow-map texels around it, weighted by a smooth bump."""
    size = look.shadow_size
    texel = 2.0 * look.shadow_half / float(size)
    # Two texels along the normal here, and 1.5 towards the sun below: a texel holds one depth for all of its area, and
    # without both a slanted surface would cast shadows on itself.
    p = point + normal * (2.0 * texel) - look.shadow_center
    x = (wp.dot(p, look.shadow_x) / look.shadow_half * 0.5 + 0.5) * float(size)
    y = (0.5 - wp.dot(p, look.shadow_y) / look.shadow_half * 0.5) * float(size)
    if x < -3.0 or y < -3.0 or x > float(size) + 3.0 or y > float(size) + 3.0:
        return 1.0
    depth = look.shadow_start - wp.dot(p, look.to_sun) - 1.5 * texel
    # The surface goes on in its plane: further from the sun on one side of the point, nearer on the other. Without
    # this, low light would find the surface itself in the texels around. Bounded, as no surface goes on for long.
    facing = wp.max(wp.dot(normal, look.to_sun), 1.0e-3)
    du = wp.clamp(wp.dot(normal, look.shadow_x) / facing, -STEEPEST, STEEPEST) * texel
    dv = wp.clamp(-wp.dot(normal, look.shadow_y) / facing, -STEEPEST, STEEPEST) * texel
    ix = int(wp.floor(x))
    iy = int(wp.floor(y))
    depth += du * (float(ix) + 0.5 - x) + dv * (float(iy) + 0.5 - y)
    # Five probes decide for most points, which lie well inside the light or the shadow; only the rest pays for 25.
    probe = (
        shadow_tap(casters, size, ix, iy, depth)
        + shadow_tap(casters, size, ix - 2, iy - 2, depth - 2.0 * (du + dv))
        + shadow_tap(casters, size, ix + 2, iy - 2, depth + 2.0 * (du - dv))
        + shadow_tap(casters, size, ix - 2, iy + 2, depth - 2.0 * (du - dv))
        + shadow_tap(casters, size, ix + 2, iy + 2, depth + 2.0 * (du + dv))
    )
    if probe == 0.0:
        return 1.0
    if probe == 5.0:
        return 0.0
    blocked = 0.0
    total = 0.0
    for j in range(-2, 3):
        fy = (float(iy + j) + 0.5 - y) / 2.6
        weight_y = wp.max(1.0 - fy * fy, 0.0)
        for i in range(-2, 3):
            fx = (float(ix + i) + 0.5 - x) / 2.6
            weight = weight_y * wp.max(1.0 - fx * fx, 0.0)
            total += weight
            blocked += weight * shadow_tap(casters, size, ix + i, iy + j, depth + du * float(i) + dv * float(j))
    return 1.0 - blocked / total


@wp.func
def shade(
    look: Look,
    eye: wp.vec3f,
    direction: wp.vec3f,
    distance: float,
    hit: wp.bool,
    hit_normal: wp.vec3f,
    albedo: wp.vec3f,
    ground: wp.bool,
    casters: wp.array[wp.float32],
    detail: wp.vec4f,
):
    """Colour of one sample after tone mapping: linear RGB, 0 to 1. Videos and camera sensors share it.

    Args:
        look: Light and air; its camera gives the size of a pixel alone.
        eye: Start of the ray in the world [m].
        direction: Unit vector along the ray in the world.
        distance: Length of the ray [m].
        hit: Whether it ends on a surface; otherwise the sample shows the sky.
        hit_normal: Normal of the surface in the world, on either side.
        albedo: Colour of the surface, linear RGB.
        ground: Whether it is a ground plane or height field, which have squares.
        casters: Shadow map.
        detail: Radiance of scenery, which was lit before, and -1; otherwise the last number is the share of the sun
            that other things let through.
    """
    backdrop = sky_color(look, direction)
    color = backdrop
    if not hit:
        # Darker below the horizon, where nothing is: an even colour there would look like fog.
        below = wp.clamp(-1.5 * direction[2], 0.0, 1.0)
        color = backdrop * (1.0 - 0.45 * below)
        if look.haze > 0.0:
            color = color * wp.pow(look.exposure, 0.2)
    elif detail[3] < 0.0:
        color = wp.vec3f(detail[0], detail[1], detail[2])
    else:
        normal = hit_normal
        if wp.dot(normal, direction) > 0.0:
            normal = -normal
        point = eye + direction * distance
        facing = wp.dot(normal, look.to_sun)
        lit = wp.max(facing, 0.0)
        if lit > 0.0 and look.shadow_size > 0:
            lit = lit * sun_visibility(look, casters, point, normal)
        lit = lit * detail[3]
        upness = 0.5 * normal[2] + 0.5
        light = look.ground + (look.sky - look.ground) * upness + look.sun * lit
        if ground:
            color = wp.cw_mul(albedo * ground_pattern(look, point, direction, normal, distance), light)
        else:
            color = wp.cw_mul(albedo, light)
            # Blinn-Phong highlight with exponent 32, by five squarings, and a rim of reflected sky.
            half = wp.max(wp.dot(normal, wp.normalize(look.to_sun - direction)), 0.0)
            gloss = half * half
            gloss = gloss * gloss
            gloss = gloss * gloss
            gloss = gloss * gloss
            gloss = gloss * gloss
            rim = 1.0 - wp.max(-wp.dot(normal, direction), 0.0)
            rim = rim * rim * rim
            color = color + look.sun * (0.16 * gloss * lit) + look.horizon * (0.16 * rim * upness)
    if hit:
        if look.haze > 0.0:
            # Haze has the colour of the sky near the horizon, also where the ray points up or down.
            low = wp.vec3f(direction[0], direction[1], wp.max(0.3 * direction[2], 0.0))
            air = sky_color(look, low)
            color = color * look.exposure
            air = air * (look.air * wp.pow(look.exposure, 0.2))
            color = color + (air - color) * (1.0 - wp.exp(-look.haze * distance))
        elif look.fog_length > 0.0:
            deep = wp.max(distance - look.fog_start, 0.0) / look.fog_length
            fog = 1.0 - wp.exp(-deep * wp.min(deep, 1.0))
            color = color + (look.horizon - color) * fog
    return wp.vec3f(tone(color[0]), tone(color[1]), tone(color[2]))


@wp.func
def tone(c: float):
    """Tone mapping: Reinhard's curve with a white point (Reinhard et al. 2002, eq. 4)."""
    x = 1.75 * wp.max(c, 0.0)
    return wp.min(x * (1.0 + x / 3.2) / (1.0 + x), 1.0)
