# SPDX-License-Identifier: Apache-2.0
"""Scenery in pictures: rays against thousands of static meshes, and their light and shadow.

Meshes are instances under one bounding volume hierarchy. A ray queries it in stretches of growing length, nearest
first: among trees most rays end a few metres away, and meshes behind that are never tested.
"""

import warp as wp

from stripe_kernels.picture_leaves import LeafStyle, leaf_at
from stripe_kernels.picture_light import Look, sky_color, sun_visibility
from stripe_kernels.picture_noise import ground_albedo, lattice, value_noise

__all__ = ["FOLIAGE", "GROUND", "PLAIN", "SMOOTH", "SOLID", "SceneryMeshes", "scenery_distances", "trace_scenery"]

SOLID = 0
"""Opaque surface with grain: wood, rock."""
FOLIAGE = 1
"""Leaves, seen from both sides, which let light through."""
GROUND = 2
"""The height field."""
SMOOTH = 3
"""Surface that mirrors the sky, as water does."""
PLAIN = 4
"""Opaque surface of one colour: what is made, not grown."""

STRETCH = wp.constant(16.0)
"""Length of the first stretch of a ray [m]; the next ones are each twice as long as the one before."""
NO_HIT = wp.constant(wp.uint32(0xFFFFFFFF))
LAYERS = wp.constant(12)
"""Largest number of a crown's triangles that a ray passes between leaves."""


@wp.struct
class SceneryMeshes:
    """Scenery: instances of meshes in the world, the colours of the ground, and the canopy above it."""

    bvh: wp.uint64  # hierarchy over the boxes of the instances, in the world
    far: wp.float32  # longest ray [m]
    mesh: wp.array[wp.uint64]  # ids of the instances' meshes
    pose: wp.array[wp.transformf]  # poses of the instances in the world [m]
    scale: wp.array[wp.vec3f]
    shape: wp.array[wp.int32]  # indices of the model's shapes
    kind: wp.array[wp.int32]  # SOLID, FOLIAGE, GROUND, SMOOTH or PLAIN
    foliage: wp.array[wp.int32]  # styles of the instances' leaves
    leaf: wp.array[LeafStyle]  # the styles; the first draws triangles whole
    color: wp.array[wp.vec3f]  # linear RGB
    middle: wp.array[wp.vec3f]  # centres of the meshes' boxes, in the meshes' frames [m]
    half: wp.array[wp.vec3f]  # half extents of those boxes [m]
    ground_color: wp.array2d[wp.vec3f]  # linear RGB on the grid of the height field; empty: its shape's colour
    ground_mean: wp.vec3f  # mean of those colours, for the ground around
    ground_lower: wp.vec2f  # world x, y of the grid's first point [m]
    ground_cell: wp.vec2f  # spacing of the grid in x and y [m]
    canopy: wp.array2d[wp.vec2f]  # cover in [0, 1] and height of its top [m], on a grid of its own
    canopy_lower: wp.vec2f  # world x, y of that grid's corner [m]
    canopy_cell: wp.float32  # side of its cells [m]


@wp.struct
class SceneryHit:
    """Nearest hit of a ray with scenery."""

    distance: wp.float32  # [m]
    index: wp.int32  # instance, -1 for none
    face: wp.int32  # triangle of its mesh
    leaf: wp.int32  # number of the leaf of its triangle
    normal: wp.vec3f  # unit vector in the world


@wp.func
def to_local_vector(s: SceneryMeshes, i: int, vector: wp.vec3f):
    """Vector of the world in the frame of instance ``i``; its length changes with the scale."""
    # Not normalised, so that distances along a ray are the same numbers in both frames.
    return wp.cw_div(wp.quat_rotate_inv(wp.transform_get_rotation(s.pose[i]), vector), s.scale[i])


@wp.func
def to_local(s: SceneryMeshes, i: int, point: wp.vec3f):
    """Point of the world in the frame of instance ``i`` [m]."""
    return to_local_vector(s, i, point - wp.transform_get_translation(s.pose[i]))


@wp.struct
class LeafHit:
    """First leaf of a mesh along a ray."""

    distance: wp.float32  # [m], negative for none
    face: wp.int32
    leaf: wp.int32
    normal: wp.vec3f  # in the mesh's frame


@wp.func
def first_leaf(mesh: wp.uint64, style: LeafStyle, origin: wp.vec3f, direction: wp.vec3f, limit: float, pixel: wp.vec2f):
    """Find the first leaf of a mesh along a ray, both in the mesh's frame, within ``limit`` [m].

    ``pixel`` is the footprint of a pixel at the ray's start and its growth along the ray.
    """
    hit = LeafHit()
    hit.distance = -1.0
    travelled = wp.float32(0.0)
    for _ in range(LAYERS):
        found = wp.mesh_query_ray(mesh, origin + direction * travelled, direction, limit - travelled)
        if not found.result:
            return hit
        travelled += found.t
        leaf = leaf_at(mesh, found.face, origin + direction * travelled, style, pixel[0] + pixel[1] * travelled)
        if leaf >= 0:
            hit.distance = travelled
            hit.face = found.face
            hit.leaf = leaf
            hit.normal = found.normal
            return hit
        travelled += 2.0e-4 + 1.0e-5 * travelled  # past this triangle
        if travelled >= limit:
            return hit
    return hit


@wp.func
def closest_of_scenery(
    s: SceneryMeshes, origin: wp.vec3f, direction: wp.vec3f, near: float, limit: float, pixel: float
):
    """Find the nearest hit within ``limit`` [m] along a unit direction; all but the ground counts from ``near`` [m].

    ``pixel`` is the size of a pixel at distance 1; leaves are no smaller than that.
    """
    hit = SceneryHit()
    hit.distance = limit
    hit.index = -1
    start = wp.float32(0.0)
    length = wp.float32(STRETCH)
    i = wp.int32(0)
    # The search ends with the stretch that holds the nearest hit. A mesh whose box reaches over several stretches is
    # tested in each of them, but only up to the nearest hit so far.
    while start < hit.distance:
        query = wp.bvh_query_ray(s.bvh, origin + direction * start, direction)
        while wp.bvh_query_next(query, i, wp.min(length, hit.distance - start)):
            skip = wp.where(s.kind[i] == GROUND, 0.0, near)
            local = to_local(s, i, origin + direction * skip)
            along = to_local_vector(s, i, direction)
            if s.leaf[s.foliage[i]].length > 0.0:
                seen = wp.vec2f(pixel * skip, pixel)
                leaf = first_leaf(s.mesh[i], s.leaf[s.foliage[i]], local, along, hit.distance - skip, seen)
                if leaf.distance >= 0.0:
                    hit.distance = leaf.distance + skip
                    hit.index = i
                    hit.face = leaf.face
                    hit.leaf = leaf.leaf
                    hit.normal = leaf.normal
            else:
                found = wp.mesh_query_ray(s.mesh[i], local, along, hit.distance - skip)
                if found.result:
                    hit.distance = found.t + skip
                    hit.index = i
                    hit.face = found.face
                    hit.leaf = found.face / 2
                    hit.normal = found.normal
        start += length
        length *= 2.0
    if hit.index >= 0:
        # A normal transforms by the inverse of the scale, a vector by the scale.
        normal = wp.cw_div(hit.normal, s.scale[hit.index])
        hit.normal = wp.normalize(wp.quat_rotate(wp.transform_get_rotation(s.pose[hit.index]), normal))
    return hit


@wp.func
def scenery_blocks(s: SceneryMeshes, origin: wp.vec3f, direction: wp.vec3f, pixel: float):
    """Whether scenery stands between a point and the sun; ``pixel`` is the size of a pixel at the point [m]."""
    start = wp.float32(0.0)
    length = wp.float32(STRETCH)
    i = wp.int32(0)
    while start < s.far:
        query = wp.bvh_query_ray(s.bvh, origin + direction * start, direction)
        while wp.bvh_query_next(query, i, length):
            local = to_local(s, i, origin)
            along = to_local_vector(s, i, direction)
            if s.leaf[s.foliage[i]].length > 0.0:
                # Sun comes through one bunch of leaves, hardly through two: the second counts whole, which is cheap.
                found = wp.mesh_query_ray(s.mesh[i], local, along, s.far)
                if found.result:
                    at = local + along * found.t
                    if leaf_at(s.mesh[i], found.face, at, s.leaf[s.foliage[i]], wp.max(pixel, 0.01)) >= 0:
                        return True
                    if wp.mesh_query_ray_anyhit(s.mesh[i], at + along * 0.001, along, s.far):
                        return True
            elif wp.mesh_query_ray_anyhit(s.mesh[i], local, along, s.far):
                return True
        start += length
        length *= 2.0
    return False


@wp.func
def grid_color(s: SceneryMeshes, point: wp.vec3f):
    """Colour of the height field at a point of the world, bilinear, linear RGB."""
    rows = s.ground_color.shape[0]
    columns = s.ground_color.shape[1]
    # The bound of 1.001 leaves a point to the right and above, c + 1 and r + 1, at the edge of the grid too.
    u = wp.clamp((point[0] - s.ground_lower[0]) / s.ground_cell[0], 0.0, float(columns) - 1.001)
    v = wp.clamp((point[1] - s.ground_lower[1]) / s.ground_cell[1], 0.0, float(rows) - 1.001)
    c = int(u)
    r = int(v)
    fu = u - float(c)
    near = s.ground_color[r, c] * (1.0 - fu) + s.ground_color[r, c + 1] * fu
    far = s.ground_color[r + 1, c] * (1.0 - fu) + s.ground_color[r + 1, c + 1] * fu
    color = near + (far - near) * (v - float(r))
    # Outside of the grid its edge would go on in stripes: the mean of all takes over.
    away_x = wp.abs((point[0] - s.ground_lower[0]) / s.ground_cell[0] - u)
    away_y = wp.abs((point[1] - s.ground_lower[1]) / s.ground_cell[1] - v)
    share = wp.clamp(wp.max(away_x / float(columns), away_y / float(rows)) * 12.0 - 0.01, 0.0, 1.0)
    return color + (s.ground_mean - color) * share


@wp.func
def open_sky(s: SceneryMeshes, point: wp.vec3f):
    """Share of the sky's light that comes through the canopy above a point of the world."""
    rows = s.canopy.shape[0]
    columns = s.canopy.shape[1]
    x = (point[0] - s.canopy_lower[0]) / s.canopy_cell - 0.5
    y = (point[1] - s.canopy_lower[1]) / s.canopy_cell - 0.5
    u = wp.clamp(x, 0.0, float(columns) - 1.001)
    v = wp.clamp(y, 0.0, float(rows) - 1.001)
    away = wp.clamp(1.0 - 0.25 * (wp.abs(x - u) + wp.abs(y - v)), 0.0, 1.0)  # no canopy outside of the map
    c = int(u)
    r = int(v)
    fu = u - float(c)
    near = s.canopy[r, c] * (1.0 - fu) + s.canopy[r, c + 1] * fu
    far = s.canopy[r + 1, c] * (1.0 - fu) + s.canopy[r + 1, c + 1] * fu
    at = near + (far - near) * (v - float(r))
    # Full shade from 8 m below the top of the canopy on, none above it.
    below = wp.clamp((at[1] - point[2]) / 8.0, 0.0, 1.0)
    return 1.0 - 0.6 * at[0] * below * away


@wp.func
def light_scenery(
    look: Look,
    s: SceneryMeshes,
    hit: SceneryHit,
    origin: wp.vec3f,
    direction: wp.vec3f,
    to_sun: wp.vec3f,
    casters: wp.array[wp.float32],
):
    """Radiance of a hit, linear RGB: light of the sun, of the sky through the canopy, and through leaves."""
    i = hit.index
    point = origin + direction * hit.distance
    normal = hit.normal
    if wp.dot(normal, direction) > 0.0:
        normal = -normal
    footprint = 2.0 * look.tan_y / float(look.height) * hit.distance
    kind = s.kind[i]
    open = open_sky(s, point)
    local = to_local(s, i, point)
    albedo = s.color[i]
    # Of the sun's middle: its disc, from which `to_sun` is drawn, softens shadows alone.
    facing = wp.dot(normal, look.to_sun)
    lit = wp.max(facing, 0.0)
    through = wp.float32(0.0)
    # Off the surface, or the ray to the sun would hit it: by what single precision leaves of a place so far away.
    start = point + normal * (0.002 + 2.0e-5 * (hit.distance + wp.max(wp.abs(point))))
    if kind == GROUND:
        if s.ground_color.shape[0] > 0:  # soil; without colours of its own it is no more than a surface
            albedo = ground_albedo(grid_color(s, point), point, footprint)
    elif kind != PLAIN:
        # Each instance, and each pair of triangles of a leaf, has a shade of its own, drawn by a hash of its index.
        own = lattice(i, 7, 1)
        albedo = wp.cw_mul(albedo * (0.82 + 0.36 * own), wp.vec3f(1.0 + 0.16 * (lattice(i, 3, 5) - 0.5), 1.0, 1.0))
        if kind == FOLIAGE:
            albedo = wp.cw_mul(
                albedo * (0.5 + 0.95 * lattice(hit.leaf, 11, 2)),
                wp.vec3f(0.9 + 0.25 * lattice(hit.leaf, 4, 9), 1.0, 1.0),
            )
            if s.leaf[s.foliage[i]].length > 0.0:  # no leaf lies quite in the plane of its bunch
                tilt = wp.vec3f(lattice(hit.leaf, 5, 3), lattice(hit.leaf, 8, 1), lattice(hit.leaf, 2, 7))
                normal = wp.normalize(normal + (tilt - wp.vec3f(0.5, 0.5, 0.5)) * 1.5)
            # A crown is lit as a rounded whole: leaf normals bend outwards, and light fades towards the inside.
            out = wp.cw_div(local - s.middle[i], s.half[i])
            depth = wp.min(wp.length(out), 1.2)
            outward = wp.quat_rotate(wp.transform_get_rotation(s.pose[i]), wp.cw_mul(out, wp.vec3f(1.0, 1.0, 0.8)))
            normal = wp.normalize(normal * 0.6 + outward)
            facing = wp.dot(normal, look.to_sun)
            lit = wp.clamp(0.25 + 0.75 * facing, 0.0, 1.0)
            through = 0.35 * wp.clamp(0.6 - 0.4 * facing, 0.0, 1.0)
            open = open * (0.4 + 0.6 * depth * depth)
            # The ray to the sun starts further out, or almost every leaf would be in the shade of its neighbours.
            start = point + to_sun * (0.02 + 0.12 * wp.min(s.half[i][2] * s.scale[i][2], 1.0))
        elif kind == SOLID:
            grain = value_noise(wp.cw_mul(local, wp.vec3f(31.0, 31.0, 6.0)))
            fine = value_noise(local * 97.0)
            near = wp.clamp(1.0 - 15.0 * footprint, 0.0, 1.0)
            albedo = albedo * (1.0 + near * (0.7 * (grain - 0.5) + 0.5 * (fine - 0.5)))
            tilt = wp.vec3f(grain - 0.5, value_noise(local * 23.0 + wp.vec3f(9.0, 4.0, 7.0)) - 0.5, fine - 0.5)
            normal = wp.normalize(normal + tilt * (0.9 * near))
            # The tilted normal must not light a surface that faces away from the sun.
            lit = wp.max(wp.dot(normal, look.to_sun), 0.0) * wp.clamp(4.0 * facing, 0.0, 1.0)
    sun = wp.float32(0.0)
    blocked = wp.bool(True)
    if lit + through > 0.0:
        blocked = scenery_blocks(s, start, to_sun, footprint)
    if not blocked:
        sun = 1.0
        if look.shadow_size > 0:
            sun = sun_visibility(look, casters, point, normal)
    upness = 0.5 * normal[2] + 0.5
    under = wp.vec3f(0.20, 0.27, 0.13) * (1.0 - open)  # green light through the leaves above
    light = wp.cw_mul(look.ground + (look.sky - look.ground) * upness, wp.vec3f(open, open, open) + under)
    light = light + look.sun * (sun * lit)
    color = wp.cw_mul(albedo, light)
    if through > 0.0:
        color = color + wp.cw_mul(wp.cw_mul(albedo, wp.vec3f(1.3, 1.45, 0.6)), look.sun) * (
            through * (0.25 + 0.75 * sun) * open
        )
    if kind == SMOOTH:
        mirrored = direction - normal * (2.0 * wp.dot(direction, normal))
        share = 1.0 - wp.clamp(-wp.dot(direction, normal), 0.0, 1.0)
        share = 0.03 + 0.97 * wp.pow(share, 5.0)  # Fresnel reflection of water (Schlick 1994)
        color = color * (1.0 - share) + sky_color(look, mirrored) * (share * open)
    return color


@wp.kernel(enable_backward=False)
def trace_scenery(
    look: Look,
    s: SceneryMeshes,
    first: wp.int32,
    sun_spread: wp.float32,
    rays: wp.array2d[wp.vec3f],
    casters: wp.array[wp.float32],
    depth: wp.array[wp.float32],
    shape: wp.array[wp.uint32],
    normal: wp.array[wp.vec3f],
    detail: wp.array[wp.vec4f],
):
    """Trace scenery along rays in the camera's frame and overwrite hits that lie behind it; one thread a ray.

    ``detail`` becomes the radiance and -1 where a ray hits scenery; elsewhere zeros and the share of the sun (0 or 1)
    that scenery lets through to the hit in front.
    """
    ray = first + wp.tid()
    d = rays[ray, 1]
    direction = look.right * d[0] + look.up * d[1] + look.back * d[2]
    limit = s.far
    if shape[ray] != NO_HIT:
        limit = wp.min(depth[ray], s.far)
    x = ray % look.width
    y = ray // look.width
    # One point of the sun's disc for each ray. The four rays of a 2 x 2 block share a radius and lie a quarter turn
    # apart; radii of neighbouring blocks are far apart (interleaved gradient noise, Jimenez 2014).
    even = 0.0671 * float(x // 2) + 0.00584 * float(y // 2)
    even = 52.98292 * (even - wp.floor(even))
    even = even - wp.floor(even)
    a = 1.5707963 * (float(x % 2 + 2 * (y % 2)) + lattice(ray, 1, 17))
    r = sun_spread * wp.sqrt(even)
    to_sun = wp.normalize(look.to_sun + look.shadow_x * (r * wp.cos(a)) + look.shadow_y * (r * wp.sin(a)))
    pixel = 2.0 * look.tan_y / float(look.height)
    hit = closest_of_scenery(s, look.eye, direction, look.near, limit, pixel)
    if hit.index >= 0:
        depth[ray] = hit.distance
        shape[ray] = wp.uint32(s.shape[hit.index])
        normal[ray] = hit.normal
        color = light_scenery(look, s, hit, look.eye, direction, to_sun, casters)
        detail[ray] = wp.vec4f(color[0], color[1], color[2], -1.0)
        return
    sun = wp.float32(1.0)
    if shape[ray] != NO_HIT:
        n = normal[ray]
        if wp.dot(n, direction) > 0.0:
            n = -n
        blocked = wp.bool(False)
        if wp.dot(n, to_sun) > 0.0:
            blocked = scenery_blocks(s, look.eye + direction * limit + n * 0.01, to_sun, pixel * limit)
        if blocked:
            sun = 0.0
    detail[ray] = wp.vec4f(0.0, 0.0, 0.0, sun)


@wp.kernel(enable_backward=False)
def scenery_distances(
    s: SceneryMeshes,
    origins: wp.array[wp.vec3f],
    directions: wp.array[wp.vec3f],
    limit: wp.float32,
    out: wp.array[wp.float32],
):
    """Distance to the scenery from each origin along each unit direction, at most ``limit`` [m]."""
    i, j = wp.tid()
    out[i * directions.shape[0] + j] = closest_of_scenery(s, origins[i], directions[j], 0.0, limit, 0.01).distance
