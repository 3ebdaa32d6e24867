# SPDX-License-Identifier: Apache-2.0
"""Hits of camera rays: the nearest of the listed shapes, of a tree of static shapes, and of a height field.

Distances to primitives are Newton's, and so are the normals of those that have no short formula. A normal is computed
once for each pixel, for the shape that it shows, rather than for each shape that its ray meets.

``hit_functions`` makes the functions for the kinds of shapes that a scene has: a kernel with the code of all of them
needs twice as many registers, so that a GPU has half as many rays in flight.
"""

# ruff: noqa: SIM102  # a static condition leaves code out only if it stands alone
import functools
from typing import NamedTuple

import newton
import warp as wp
from newton._src.geometry.raycast import (  # private: there is no public function for a single ray
    ray_intersect_box,
    ray_intersect_capsule,
    ray_intersect_cone,
    ray_intersect_cylinder,
    ray_intersect_ellipsoid,
    ray_intersect_plane,
    ray_intersect_sphere,
)

from ..box_normals import box_normal
from .camera_shapes import BOX, CAPSULE, CONE, CYLINDER, ELLIPSOID, PLANE, SPHERE, MeshLevel, SeenShapes
from .ray_shapes import RayTargets

__all__ = ["HitFunctions", "PixelHit", "hit_functions"]

_NONE = wp.constant(-1)
_INACTIVE = wp.constant(wp.uint32(0xFFFFFFFF))


@wp.struct
class PixelHit:
    """Where the ray of a pixel ends."""

    distance: float
    """Length of the ray [m]."""
    slot: int
    """Slot of a listed shape, or -1."""
    shape: int
    """Shape of the tree of static ones, or -1."""
    face: int
    """Face of a mesh, with barycentric coordinates ``u`` and ``v``."""
    u: float
    v: float


class HitFunctions(NamedTuple):
    """Functions for some kinds of shapes.

    Attributes:
        listed_hit: ``(env, row, col, start, direction, near, seen, hit)``: the nearer of ``hit`` and the listed shapes,
            for a ray in the frame of the camera.
        tree_hit: ``(start, direction, skip, statics, hit)``: the nearer of ``hit`` and the static shapes of a tree, but
            for shape ``skip``, for a ray in the world.
        listed_normal: ``(hit, camera, start, direction, seen, meshes)``: unit normal in the world of the
            listed shape that is hit, for a ray in the frame of the camera.
        tree_normal: ``(hit, otherwise, start, direction, statics, smooth, meshes)``: unit normal in the world of the
            static shape that is hit, else ``otherwise``.
        is_shadowed: ``(env, start, direction, seen)``: whether a shape of the environment is between a point and the
            sun, both in the frame of the camera.
    """

    listed_hit: wp.Function
    tree_hit: wp.Function
    listed_normal: wp.Function
    tree_normal: wp.Function
    is_shadowed: wp.Function


@wp.func
def _local_ray(pose: wp.transform, scale: wp.vec3, is_mesh: bool, start: wp.vec3, direction: wp.vec3):
    """A ray of the world in the frame of a shape, divided by the scale of a mesh."""
    back = wp.transform_inverse(pose)
    local, along = wp.transform_point(back, start), wp.transform_vector(back, direction)
    if is_mesh:
        over = wp.vec3(1.0 / scale[0], 1.0 / scale[1], 1.0 / scale[2])
        local, along = wp.cw_mul(over, local), wp.cw_mul(over, along)
    return local, along


@wp.func
def _mesh_normal(mesh: wp.uint64, level: int, meshes: wp.array[MeshLevel], hit: PixelHit) -> wp.vec3:
    """Normal of a mesh in its own frame, before it is scaled: of its vertices, or of the face."""
    if level >= 0 and meshes[level].normals.shape[0] > 0:
        normals = meshes[level].normals
        n0 = normals[wp.mesh_get_index(mesh, 3 * hit.face)]
        n1 = normals[wp.mesh_get_index(mesh, 3 * hit.face + 1)]
        n2 = normals[wp.mesh_get_index(mesh, 3 * hit.face + 2)]
        return n0 * hit.u + n1 * hit.v + n2 * (1.0 - hit.u - hit.v)
    return wp.mesh_eval_face_normal(mesh, hit.face)


@wp.func
def _mesh_hit(mesh: wp.uint64, slot: int, shape: int, start: wp.vec3, direction: wp.vec3, hit: PixelHit) -> PixelHit:
    """The nearer of ``hit`` and a mesh, for a ray in its frame."""
    found = wp.mesh_query_ray(mesh, start, direction, hit.distance)
    if found.result and found.t < hit.distance:
        hit.distance = found.t
        hit.slot = slot
        hit.shape = shape
        hit.face = found.face
        hit.u = found.u
        hit.v = found.v
    return hit


# Functions below are made for the kinds of shapes of a scene: ``wp.static`` leaves out the code of others.


def _distance_function(kinds: frozenset[int]) -> wp.Function:
    has = {name: int(newton.GeoType[name]) in kinds for name in
           ("BOX", "PLANE", "CAPSULE", "CYLINDER", "SPHERE", "CONE", "ELLIPSOID")}  # fmt: skip
    box, plane, capsule, cylinder, sphere, cone, ellipsoid = has.values()

    @wp.func
    def primitive_distance(kind: int, size: wp.vec3, start: wp.vec3, direction: wp.vec3) -> float:
        """Distance to a primitive along a ray in its own frame; negative if it is not met."""
        t = wp.float32(-1.0)
        if wp.static(box):
            if kind == BOX:
                t, _n = ray_intersect_box(start, direction, size)
        if wp.static(plane):
            if kind == PLANE:
                t, _n = ray_intersect_plane(start, direction, size, False)
        if wp.static(capsule):
            if kind == CAPSULE:
                t, _n = ray_intersect_capsule(start, direction, size[0], size[1])
        if wp.static(cylinder):
            if kind == CYLINDER:
                t, _n = ray_intersect_cylinder(start, direction, size[0], size[1], size[2])
        if wp.static(sphere):
            if kind == SPHERE:
                t, _n = ray_intersect_sphere(start, direction, size[0])
        if wp.static(cone):
            if kind == CONE:
                t, _n = ray_intersect_cone(start, direction, size[0], size[1])
        if wp.static(ellipsoid):
            if kind == ELLIPSOID:
                t, _n = ray_intersect_ellipsoid(start, direction, size)
        return t

    return primitive_distance


def _normal_function(kinds: frozenset[int]) -> wp.Function:
    has = {name: int(newton.GeoType[name]) in kinds for name in
           ("BOX", "CAPSULE", "CYLINDER", "SPHERE", "CONE", "ELLIPSOID")}  # fmt: skip
    box, capsule, cylinder, sphere, cone, ellipsoid = has.values()

    @wp.func
    def primitive_normal(kind: int, size: wp.vec3, start: wp.vec3, direction: wp.vec3, distance: float) -> wp.vec3:
        """Normal of a primitive where a ray in its own frame meets it."""
        point = start + distance * direction
        normal = wp.vec3(0.0, 0.0, 1.0)
        if wp.static(box):
            if kind == BOX:
                normal = box_normal(start, direction, size)
        if wp.static(sphere):
            if kind == SPHERE:
                normal = wp.normalize(point)
        if wp.static(capsule):
            if kind == CAPSULE:
                normal = wp.normalize(point - wp.vec3(0.0, 0.0, wp.clamp(point[2], -size[1], size[1])))
        if wp.static(cylinder):
            if kind == CYLINDER:
                _t, normal = ray_intersect_cylinder(start, direction, size[0], size[1], size[2])
        if wp.static(cone):
            if kind == CONE:
                _t, normal = ray_intersect_cone(start, direction, size[0], size[1])
        if wp.static(ellipsoid):
            if kind == ELLIPSOID:
                _t, normal = ray_intersect_ellipsoid(start, direction, size)
        return normal

    return primitive_normal


def _search_functions(
    has_meshes: bool, has_primitives: bool, primitive_distance: wp.Function
) -> tuple[wp.Function, wp.Function]:
    """``listed_hit`` and ``tree_hit``."""

    @wp.func
    def primitive_hit(
        kind: int, size: wp.vec3, slot: int, shape: int, start: wp.vec3, direction: wp.vec3, hit: PixelHit
    ) -> PixelHit:
        """The nearer of ``hit`` and a primitive, for a ray in its frame."""
        t = primitive_distance(kind, size, start, direction)
        if t >= 0.0 and t < hit.distance:
            hit.distance = t
            hit.slot = slot
            hit.shape = shape
        return hit

    @wp.func
    def listed_hit(
        env: int, row: int, col: int, start: wp.vec3, direction: wp.vec3, near: float, seen: SeenShapes, hit: PixelHit
    ) -> PixelHit:
        slant = -direction[2]
        first = seen.first[env]
        for i in range(seen.count[env]):
            slot = seen.listed[first + i]
            # Sorted by their least depth: those that follow are all farther away.
            if seen.nearest[slot] - near > hit.distance * slant:
                break
            pixels = seen.pixels[slot]
            if col < pixels[0] or row < pixels[1] or col > pixels[2] or row > pixels[3]:
                continue
            turn = seen.turn[slot]
            local, along = turn * start + seen.start[slot], turn * direction
            mesh = wp.uint64(0)
            if wp.static(has_meshes):
                mesh = seen.mesh[slot]
                if mesh != wp.uint64(0):
                    hit = _mesh_hit(mesh, slot, _NONE, local, along, hit)
            if wp.static(has_primitives):
                if mesh == wp.uint64(0):
                    hit = primitive_hit(seen.kind[slot], seen.size[slot], slot, _NONE, local, along, hit)
        return hit

    @wp.func
    def tree_hit(start: wp.vec3, direction: wp.vec3, skip: int, statics: RayTargets, hit: PixelHit) -> PixelHit:
        query = wp.bvh_query_ray(statics.tree, start, direction, statics.roots[statics.roots.shape[0] - 1])
        leaf = wp.int32(0)
        while wp.bvh_query_next(query, leaf, hit.distance):
            entry = statics.leaves[leaf]
            if entry == _INACTIVE or int(entry) == skip:
                continue
            shape = int(entry)
            mesh, scale = statics.source[shape], statics.scale[shape]
            local, along = _local_ray(statics.pose[shape], scale, mesh != wp.uint64(0), start, direction)
            if wp.static(has_meshes):
                if mesh != wp.uint64(0):
                    hit = _mesh_hit(mesh, _NONE, shape, local, along, hit)
            if wp.static(has_primitives):
                if mesh == wp.uint64(0):
                    hit = primitive_hit(statics.kind[shape], scale, _NONE, shape, local, along, hit)
        return hit

    return listed_hit, tree_hit


def _normal_functions(
    has_meshes: bool, has_primitives: bool, primitive_normal: wp.Function
) -> tuple[wp.Function, wp.Function]:
    """``listed_normal`` and ``tree_normal``."""

    @wp.func
    def listed_normal(
        hit: PixelHit,
        camera: wp.quat,
        start: wp.vec3,
        direction: wp.vec3,
        seen: SeenShapes,
        meshes: wp.array[MeshLevel],
    ) -> wp.vec3:
        turn, mesh = seen.turn[hit.slot], seen.mesh[hit.slot]
        normal = wp.vec3(0.0)
        if wp.static(has_meshes):
            if mesh != wp.uint64(0):
                normal = _mesh_normal(mesh, seen.level[hit.slot], meshes, hit)
        if wp.static(has_primitives):
            if mesh == wp.uint64(0):
                local, along = turn * start + seen.start[hit.slot], turn * direction
                normal = primitive_normal(seen.kind[hit.slot], seen.size[hit.slot], local, along, hit.distance)
        # The transpose of the matrix that brings rays to the shape brings normals back, its scale included.
        return wp.normalize(wp.quat_rotate(camera, wp.transpose(turn) * normal))

    @wp.func
    def tree_normal(
        hit: PixelHit,
        otherwise: wp.vec3,
        start: wp.vec3,
        direction: wp.vec3,
        statics: RayTargets,
        smooth: wp.array[int],
        meshes: wp.array[MeshLevel],
    ) -> wp.vec3:
        shape = hit.shape
        if shape < 0:
            return otherwise
        mesh, scale, pose = statics.source[shape], statics.scale[shape], statics.pose[shape]
        normal = wp.vec3(0.0)
        if wp.static(has_meshes):
            if mesh != wp.uint64(0):
                own = _mesh_normal(mesh, smooth[shape], meshes, hit)
                normal = wp.vec3(own[0] / scale[0], own[1] / scale[1], own[2] / scale[2])
        if wp.static(has_primitives):
            if mesh == wp.uint64(0):
                local, along = _local_ray(pose, scale, False, start, direction)
                normal = primitive_normal(statics.kind[shape], scale, local, along, hit.distance)
        return wp.normalize(wp.transform_vector(pose, normal))

    return listed_normal, tree_normal


def _shadow_function(has_meshes: bool, has_primitives: bool, primitive_distance: wp.Function) -> wp.Function:
    """``is_shadowed``."""

    @wp.func
    def is_shadowed(env: int, start: wp.vec3, direction: wp.vec3, seen: SeenShapes) -> bool:
        for slot in range(seen.first[env], seen.first[env + 1]):
            kind = seen.kind[slot]
            sphere = seen.sphere[slot]
            to = wp.vec3(sphere[0], sphere[1], sphere[2]) - start
            along = wp.dot(to, direction)
            apart = wp.length_sq(to) - along * along
            if kind != PLANE and (along < -sphere[3] or apart > sphere[3] * sphere[3]):
                continue
            turn, mesh = seen.turn[slot], seen.mesh[slot]
            local, toward = turn * start + seen.start[slot], turn * direction
            if wp.static(has_meshes):
                if mesh != wp.uint64(0):
                    if wp.mesh_query_ray_anyhit(mesh, local, toward, 1.0e8):
                        return True
            if wp.static(has_primitives):
                if mesh == wp.uint64(0):
                    if primitive_distance(kind, seen.size[slot], local, toward) >= 0.0:
                        return True
        return False

    return is_shadowed


@functools.cache
def hit_functions(kinds: frozenset[int]) -> HitFunctions:
    """The functions for some kinds of shapes, by ``newton.GeoType``; meshes of all kinds are ``GeoType.MESH``."""
    mesh = int(newton.GeoType.MESH)
    has = mesh in kinds, bool(kinds - {mesh})
    distance = _distance_function(kinds)
    return HitFunctions(
        *_search_functions(*has, distance),
        *_normal_functions(*has, _normal_function(kinds)),
        _shadow_function(*has, distance),
    )
