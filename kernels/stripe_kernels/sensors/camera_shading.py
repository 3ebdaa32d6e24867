# SPDX-License-Identifier: Apache-2.0
"""Camera pictures: rays, shading, shadows and writing of a pixel in one pass.

A warp of a GPU renders a tile of eight by four pixels: its rays meet the same shapes, and it writes whole sectors of
memory. What no image needs is not in the kernel: ``picture_kernel`` makes one for each set of features.
"""

import functools
from typing import NamedTuple

import newton
import warp as wp

from ..picture_colors import pack_color
from ..picture_light import Look, shade
from .camera_hits import PixelHit, hit_functions
from .camera_shapes import FIELD, PLANE, Lens, MeshLevel, SeenShapes, linear_of
from .ray_blocks import FieldHit, field_normal, march_blocks
from .ray_field import RayField
from .ray_shapes import RayTargets

__all__ = [
    "BLOCKS_PER_SM",
    "BLOCK_THREADS",
    "TILE_HEIGHT",
    "TILE_WIDTH",
    "CameraLight",
    "Features",
    "PictureOutput",
    "picture_kernel",
]

BLOCK_THREADS, BLOCKS_PER_SM = 128, 4
"""Threads of a block, and blocks that a multiprocessor shall have room for: at most 128 registers a thread."""
TILE_WIDTH, TILE_HEIGHT = 8, 4
"""Pixels that a warp of 32 threads renders."""
_LIFT = 1.0e-4
"""Height above a surface at which a ray towards the sun begins [m]."""

_SUN_AWAY = wp.constant(1.0e4)
"""Length of a ray towards the sun [m]."""

NO_SHAPE = wp.constant(wp.uint32(0xFFFFFFFF))


@wp.struct
class CameraLight:
    """Light of each environment; colours are linear RGB, shape ``(num_envs,)`` each."""

    to_sun: wp.array[wp.vec3]
    """Unit vector towards the sun, in the world."""
    sun: wp.array[wp.vec3]
    """Radiance of the sun."""
    sky: wp.array[wp.vec3]
    """Ambient radiance from above."""
    ground: wp.array[wp.vec3]
    """Ambient radiance from below."""


@wp.struct
class PictureOutput:
    """Images that a kernel writes; those that the features leave out may be empty."""

    color: wp.array3d[wp.uint32]
    """Packed ABGR, sRGB, shape ``(num_envs, height, width)``."""
    plane: wp.array3d[float]
    """Depths along the optical axis [m]."""
    length: wp.array3d[float]
    """Distances from the camera [m]."""
    normals: wp.array3d[wp.vec3]
    """Unit normals in the world, zero where there is nothing."""
    shape: wp.array3d[wp.uint32]
    """Shapes, 0xFFFFFFFF for none."""
    background: wp.uint32
    """Colour where there is nothing, packed; 0 for the sky."""
    missing: float
    """Depth where there is nothing [m]."""


class Features(NamedTuple):
    """Features of a kernel: images that it writes and what it looks at."""

    color: bool = False
    plane: bool = False
    length: bool = False
    normals: bool = False
    shape: bool = False
    field: bool = False
    """Whether there is a height field."""
    tree: bool = False
    """Whether there is a tree of static shapes."""
    shadows: bool = False
    kinds: frozenset[int] = frozenset()
    """Kinds of shapes, by ``newton.GeoType``; meshes of all kinds are ``GeoType.MESH``."""

    @property
    def key(self) -> str:
        """A name for the kernel with these features."""
        flags = [name for name, value in zip(self._fields, self, strict=True) if value is True]
        return "_".join([*flags, *map(str, sorted(self.kinds))])


@wp.func
def _light_of(env: int, look: Look, light: CameraLight) -> Look:
    """The look under the light of an environment."""
    look.to_sun = light.to_sun[env]
    look.sun = light.sun[env]
    look.sky = light.sky[env]
    look.ground = light.ground[env]
    return look


@wp.func
def _by_field(shadowed: bool, field: RayField, blocks: wp.array2d[wp.vec2], start: wp.vec3, to_sun: wp.vec3) -> bool:
    """Whether a point that is not shadowed yet is by a height field."""
    if shadowed:
        return True
    return march_blocks(field, blocks, start, to_sun, _SUN_AWAY).distance >= 0.0


@wp.func
def _shape_of_face(shape: int, level: int, face: int, meshes: wp.array[MeshLevel]) -> int:
    """Shape that a slot shows: its own, or that of the part of its mesh which is hit."""
    if level >= 0 and meshes[level].part.shape[0] > 0:
        return shape + meshes[level].part[face]
    return shape


@functools.cache
def picture_kernel(features: Features) -> wp.Kernel:
    """The kernel with some features; threads count tile by tile, picture by picture.

    Arguments: ``due``, ``tiles`` (in a row, in a picture), ``width``, ``height``, ``camera`` (poses, looking along -z),
    ``lens``, ``seen``, ``field``, ``blocks``, ``field_shape``, ``statics``, ``colors`` of shapes (sRGB), ``kinds`` of
    shapes, ``smooth`` (of shapes in the tree: rows of ``meshes``, or -1), ``meshes``, ``look``, ``light``, ``casters``
    (an empty shadow map), ``out``.
    """
    shaded = features.color or features.normals
    named = shaded or features.shape
    listed_hit, tree_hit, listed_normal, tree_normal, is_shadowed = hit_functions(features.kinds)

    @wp.func
    def by_tree(shadowed: bool, skip: int, statics: RayTargets, start: wp.vec3, to_sun: wp.vec3) -> bool:
        """Whether a point that is not shadowed yet is by a static shape."""
        if shadowed:
            return True
        beam = PixelHit()
        beam.distance = _SUN_AWAY
        beam.slot = -1
        beam.shape = -1
        return tree_hit(start, to_sun, skip, statics, beam).shape >= 0

    # A module of its own, named by everything that is baked in: Warp's hash does not see static values of functions.
    module = wp.get_module(f"{__name__}.{features.key}")
    module.options |= {"enable_backward": False, "fast_math": True}

    @wp.kernel(
        enable_backward=False, module=module, launch_bounds=(BLOCK_THREADS, BLOCKS_PER_SM),
        grid_stride=False,
    )  # fmt: skip
    def render_pictures(
        due: wp.array[wp.bool],
        tiles: wp.vec2i,
        width: int,
        height: int,
        camera: wp.array[wp.transform],
        lens: Lens,
        seen: SeenShapes,
        field: RayField,
        blocks: wp.array2d[wp.vec2],
        field_shape: int,
        statics: RayTargets,
        colors: wp.array[wp.vec3],
        kinds: wp.array[int],
        smooth: wp.array[int],
        meshes: wp.array[MeshLevel],
        look: Look,
        light: CameraLight,
        casters: wp.array[float],
        out: PictureOutput,
    ):
        # The pixel of this thread: a warp computes a tile, whose rays meet the same shapes.
        tid = wp.tid()
        lane, tile = tid % 32, tid // 32
        env = tile // tiles[1]
        tile = tile % tiles[1]
        row = (tile // tiles[0]) * wp.static(TILE_HEIGHT) + lane // wp.static(TILE_WIDTH)
        col = (tile % tiles[0]) * wp.static(TILE_WIDTH) + lane % wp.static(TILE_WIDTH)
        if row >= height or col >= width or not due[env]:
            return
        # Its ray, in the frame of the camera and in the world, from the near plane to the far one.
        through = wp.vec3((float(col) + 0.5 - lens.cx) / lens.fx, (lens.cy - float(row) - 0.5) / lens.fy, -1.0)
        slant = 1.0 / wp.length(through)
        start, direction = through * lens.near, through * slant
        hit = PixelHit()
        hit.distance = (lens.far - lens.near) / slant
        hit.slot = -1
        hit.shape = -1
        hit.face = -1
        pose = camera[env]
        turn = wp.transform_get_rotation(pose)
        start_w, direction_w = start, direction
        if wp.static(features.field or features.tree):
            start_w, direction_w = wp.transform_point(pose, start), wp.quat_rotate(turn, direction)
        # What it hits first: the height field, shapes of the environment, the tree of static shapes.
        ground = FieldHit()
        ground.distance = -1.0
        if wp.static(features.field):
            ground = march_blocks(field, blocks, start_w, direction_w, hit.distance)
            if ground.distance >= 0.0:
                hit.distance = ground.distance
        hit = listed_hit(env, row, col, start, direction, lens.near, seen, hit)
        if wp.static(features.tree):
            hit = tree_hit(start_w, direction_w, field_shape, statics, hit)

        # The shape's index in the model, -1 for none.
        shape = hit.shape
        if hit.slot >= 0:
            shape = seen.shape[hit.slot]
            if wp.static(named and int(newton.GeoType.MESH) in features.kinds):
                shape = _shape_of_face(shape, seen.level[hit.slot], hit.face, meshes)
        elif shape < 0 and ground.distance >= 0.0:
            shape = field_shape
        if shape < 0:
            if wp.static(features.color):
                color = out.background
                if color == wp.uint32(0):
                    above = wp.quat_rotate(turn, direction)
                    nothing, sun = wp.vec3(0.0), wp.vec4(0.0, 0.0, 0.0, 1.0)
                    lit = _light_of(env, look, light)
                    color = pack_color(shade(lit, nothing, above, 0.0, False, nothing, nothing, False, casters, sun))
                out.color[env, row, col] = color
            if wp.static(features.plane):
                out.plane[env, row, col] = out.missing
            if wp.static(features.length):
                out.length[env, row, col] = out.missing
            if wp.static(features.normals):
                out.normals[env, row, col] = wp.vec3(0.0)
            if wp.static(features.shape):
                out.shape[env, row, col] = NO_SHAPE
            return
        if wp.static(features.plane):
            out.plane[env, row, col] = lens.near + hit.distance * slant
        if wp.static(features.length):
            length = lens.near / slant + hit.distance
            out.length[env, row, col] = wp.where(length <= lens.far, length, out.missing)
        if wp.static(features.shape):
            out.shape[env, row, col] = wp.uint32(shape)
        if wp.static(shaded):
            normal = wp.vec3(0.0, 0.0, 1.0)
            if wp.static(features.field):
                normal = field_normal(field, ground)
            if wp.static(features.tree):
                normal = tree_normal(hit, normal, start_w, direction_w, statics, smooth, meshes)
            if hit.slot >= 0:
                normal = listed_normal(hit, turn, start, direction, seen, meshes)
            if wp.static(features.normals):
                out.normals[env, row, col] = normal
            if wp.static(features.color):
                albedo = wp.vec3(0.0)
                own = hit.slot >= 0
                if own:
                    own = shape == seen.shape[hit.slot]
                if own:
                    albedo = seen.albedo[hit.slot]
                else:
                    rgb = colors[shape]
                    albedo = wp.vec3(linear_of(rgb[0]), linear_of(rgb[1]), linear_of(rgb[2]))
                lit = _light_of(env, look, light)
                detail = wp.vec4(0.0, 0.0, 0.0, 1.0)
                eye, ahead = wp.transform_point(pose, start), wp.quat_rotate(turn, direction)
                # Shadow rays start a little above the surface, and only where it faces the sun.
                if wp.static(features.shadows):
                    facing = normal
                    if wp.dot(normal, ahead) > 0.0:
                        facing = -normal
                    if wp.dot(facing, lit.to_sun) > 0.0:
                        lifted_w = eye + ahead * hit.distance + facing * wp.static(_LIFT)
                        lifted = wp.transform_point(wp.transform_inverse(pose), lifted_w)
                        shadowed = is_shadowed(env, lifted, wp.quat_rotate_inv(turn, lit.to_sun), seen)
                        if wp.static(features.field):
                            shadowed = _by_field(shadowed, field, blocks, lifted_w, lit.to_sun)
                        if wp.static(features.tree):
                            shadowed = by_tree(shadowed, field_shape, statics, lifted_w, lit.to_sun)
                        if shadowed:
                            detail[3] = 0.0
                squares = kinds[shape] == PLANE or kinds[shape] == FIELD
                out.color[env, row, col] = pack_color(
                    shade(lit, eye, ahead, hit.distance, True, normal, albedo, squares, casters, detail)
                )

    return render_pictures
