# SPDX-License-Identifier: Apache-2.0
"""Randomisation of shapes: events that change colliders, sites and visible colours.

``shape_ids`` are the shapes of the bodies that a config names, or those of them that match its ``shape_names``;
``operation`` and ``distribution`` are codes of ``randomization.OPERATIONS`` and ``DISTRIBUTIONS``. Quantities whose
range is ``randomization.KEEP`` are not changed and take no draw.
"""

from typing import TYPE_CHECKING

import newton
import warp as wp

from ..model_data import ShapeModelData
from ..removed_tables import forward_tables
from ..term_info import randomizes
from . import random
from .randomization import KEEP, is_kept, operate, randomize, sample

__all__ = [
    "randomize_geom_friction",
    "randomize_geom_pose",
    "randomize_geom_size",
    "randomize_rigid_body_collider_offsets",
    "randomize_rigid_body_material",
    "randomize_site_pose",
    "randomize_visual_color",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, randomizations={"SHAPE_RANDOMIZATIONS": __name__})

_ONE_COEFFICIENT = "Newton has one coefficient of sliding friction, drawn from static_friction_range"
_BY_VALUE = {"operation": "abs", "distribution": "uniform"}


_SPHERE = wp.constant(int(newton.GeoType.SPHERE))
_CAPSULE = wp.constant(int(newton.GeoType.CAPSULE))
_CYLINDER = wp.constant(int(newton.GeoType.CYLINDER))
_ELLIPSOID = wp.constant(int(newton.GeoType.ELLIPSOID))
_SMALLEST = wp.constant(1.0e-4)
"""Smallest length of a shape [m]."""


@randomizes(
    ranges={
        "static_friction_range": ("friction", "not negative"),
        "restitution_range": ("restitution", "not negative"),
    },
    defaults={"restitution_range": KEEP},
    ignored={
        "dynamic_friction_range": _ONE_COEFFICIENT,
        "make_consistent": _ONE_COEFFICIENT,
        "num_buckets": "the number of materials has no bound, each shape gets a draw of its own",
    },
    shapes="colliders",
)
@wp.func
def randomize_rigid_body_material(
    env: int,
    model: ShapeModelData,
    rng: wp.array[wp.uint32],
    shape_ids: wp.array[int],
    static_friction_range: wp.vec2,
    restitution_range: wp.vec2,
):
    """Randomise the coefficients of friction and restitution of colliders.

    Formula: ``mu_i = U(static_friction_range)``, ``e_i = U(restitution_range)``.

    Source: Isaac Lab, ``mdp.randomize_rigid_body_material``, which on Newton draws from the static range, too.
    """
    for i in range(shape_ids.shape[0]):
        shape = shape_ids[i]
        model.friction[env, shape] = wp.max(random.uniform_range(env, rng, static_friction_range), 0.0)
        if not is_kept(restitution_range):
            model.restitution[env, shape] = wp.max(random.uniform_range(env, rng, restitution_range), 0.0)


@randomizes(
    ranges={
        "ranges": ("friction", "not negative"),
        "torsional_range": ("torsional_friction", "not negative"),
        "rolling_range": ("rolling_friction", "not negative"),
    },
    defaults={"torsional_range": KEEP, "rolling_range": KEEP, **_BY_VALUE},
    shapes="colliders",
)
@wp.func
def randomize_geom_friction(
    env: int,
    model: ShapeModelData,
    rng: wp.array[wp.uint32],
    shape_ids: wp.array[int],
    ranges: wp.vec2,
    torsional_range: wp.vec2,
    rolling_range: wp.vec2,
    operation: int,
    distribution: int,
):
    """Randomise the coefficients of sliding, torsional [m] and rolling [m] friction of colliders.

    Formula: ``mu_i = max(op(mu_default,i, draw), 0)``, each of the three on its own.

    Source: mjlab, ``dr.geom_friction``, there with ``axes``.
    """
    for i in range(shape_ids.shape[0]):
        shape = shape_ids[i]
        sliding = randomize(env, rng, model.default_friction[env, shape], ranges, operation, distribution)
        model.friction[env, shape] = wp.max(sliding, 0.0)
        if not is_kept(torsional_range):
            default = model.default_torsional_friction[env, shape]
            torsional = randomize(env, rng, default, torsional_range, operation, distribution)
            model.torsional_friction[env, shape] = wp.max(torsional, 0.0)
        if not is_kept(rolling_range):
            default = model.default_rolling_friction[env, shape]
            rolling = randomize(env, rng, default, rolling_range, operation, distribution)
            model.rolling_friction[env, shape] = wp.max(rolling, 0.0)


@randomizes(
    ranges={"rest_offset_distribution_params": ("margin", "any"), "contact_offset_distribution_params": ("gap", "any")},
    defaults={
        "rest_offset_distribution_params": KEEP,
        "contact_offset_distribution_params": KEEP,
        "distribution": "uniform",
    },
    shapes="colliders",
)
@wp.func
def randomize_rigid_body_collider_offsets(
    env: int,
    model: ShapeModelData,
    rng: wp.array[wp.uint32],
    shape_ids: wp.array[int],
    rest_offset_distribution_params: wp.vec2,
    contact_offset_distribution_params: wp.vec2,
    distribution: int,
):
    """Randomise the contact margin and gap of colliders, by PhysX's rest offset and contact offset.

    Formula: ``margin_i = draw`` [m], ``gap_i = max(draw - margin_i, 0)`` [m].

    Source: Isaac Lab, ``mdp.randomize_rigid_body_collider_offsets``, as it does on Newton.
    """
    for i in range(shape_ids.shape[0]):
        shape = shape_ids[i]
        if not is_kept(rest_offset_distribution_params):
            model.margin[env, shape] = sample(env, rng, rest_offset_distribution_params, distribution)
        if not is_kept(contact_offset_distribution_params):
            # PhysX's contact offset counts from the surface, Newton's gap from the margin, which may be new by now.
            reach = sample(env, rng, contact_offset_distribution_params, distribution)
            model.gap[env, shape] = wp.max(reach - model.margin[env, shape], 0.0)


@randomizes(shapes="colliders")
@wp.func
def randomize_geom_pose(
    env: int, model: ShapeModelData, rng: wp.array[wp.uint32], shape_ids: wp.array[int], pose_range: wp.array[wp.vec2]
):
    """Randomise the poses of colliders on their bodies; masses do not change.

    Formula: ``p_i = p_default,i + U`` [m] in the body's frame, ``q_i = q_default,i Rz(U) Ry(U) Rx(U)``.

    Source: mjlab, ``dr.geom_pos``, ``dr.geom_quat``.
    """
    for i in range(shape_ids.shape[0]):
        shape = shape_ids[i]
        default = model.default_pose[env, shape]
        offset = random.uniform_vec3(env, rng, pose_range, 0)
        angles = random.uniform_vec3(env, rng, pose_range, 3)
        turn = wp.quat_rpy(angles[0], angles[1], angles[2])
        model.pose[env, shape] = wp.transform(
            wp.transform_get_translation(default) + offset, wp.transform_get_rotation(default) * turn
        )


@randomizes(shapes="sites")
@wp.func
def randomize_site_pose(
    env: int, model: ShapeModelData, rng: wp.array[wp.uint32], shape_ids: wp.array[int], pose_range: wp.array[wp.vec2]
):
    """Randomise the poses of sites on their bodies, for readers of the model's sites.

    Formula: ``p_i = p_default,i + U`` [m] in the body's frame, ``q_i = q_default,i Rz(U) Ry(U) Rx(U)``.

    Source: mjlab, ``dr.site_pos``, ``dr.site_quat``.
    """
    randomize_geom_pose(env, model, rng, shape_ids, pose_range)


@wp.func
def _num_lengths(kind: int) -> int:
    """Number of lengths in the size of a primitive."""
    if kind == _SPHERE:
        return 1
    if kind == _CAPSULE:
        return 2
    if kind == _CYLINDER:
        return 2
    return 3


@wp.func
def _bounding_radius(kind: int, size: wp.vec3) -> float:
    """Bounding radius of a primitive: of the smallest sphere around its centre that contains it [m]."""
    if kind == _SPHERE:
        return size[0]
    if kind == _CAPSULE:
        return size[0] + size[1]
    if kind == _CYLINDER:
        return wp.sqrt(size[0] * size[0] + size[1] * size[1])
    if kind == _ELLIPSOID:
        return wp.max(wp.max(size[0], size[1]), size[2])
    return wp.length(size)


@randomizes(
    ranges={"ranges": ("size", "positive")},
    defaults={"operation": "scale", "distribution": "uniform", "shared_random": False},
    shapes="primitives",
)
@wp.func
def randomize_geom_size(
    env: int,
    model: ShapeModelData,
    rng: wp.array[wp.uint32],
    shape_ids: wp.array[int],
    ranges: wp.vec2,
    operation: int,
    distribution: int,
    shared_random: bool,
):
    """Randomise the sizes of spheres, capsules, cylinders, ellipsoids and boxes; masses do not change.

    With ``shared_random`` all lengths of a shape share one draw.

    Formula: ``s_i,k = max(op(s_default,i,k, draw), 0.0001)`` [m]: radius, half height, or half extents.

    Source: mjlab, ``dr.geom_size``.
    """
    for i in range(shape_ids.shape[0]):
        shape = shape_ids[i]
        kind = model.kind[shape]
        size = model.default_size[env, shape]
        draw = wp.float32(0.0)
        for k in range(_num_lengths(kind)):
            if k == 0 or not shared_random:
                draw = sample(env, rng, ranges, distribution)
            size[k] = wp.max(operate(size[k], draw, operation), _SMALLEST)
        model.size[env, shape] = size
        # The broad phase tests bounding spheres: with the old radius a grown shape would miss contacts.
        model.radius[env, shape] = _bounding_radius(kind, size)


@randomizes(shapes="visible shapes")
@wp.func
def randomize_visual_color(
    env: int, model: ShapeModelData, rng: wp.array[wp.uint32], shape_ids: wp.array[int], colors: wp.array[wp.vec2]
):
    """Randomise the colours of visible shapes, as cameras see them.

    A config gives the bounds as ``colors={"r": (low, high), "g": ..., "b": ...}``.

    Formula: ``c_i = (U(colors_r), U(colors_g), U(colors_b))``, sRGB from 0 to 1.

    Source: Isaac Lab, ``mdp.randomize_visual_color``; mjlab, ``dr.geom_rgba``.
    """
    for i in range(shape_ids.shape[0]):
        model.color[env, shape_ids[i]] = random.uniform_vec3(env, rng, colors, 0)
