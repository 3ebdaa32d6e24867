# SPDX-License-Identifier: Apache-2.0
"""Dynamics: the randomising events as kernels, for code that changes the model outside of a fused step.

Every kernel runs once for each environment, over its whole part of the model, and does nothing where ``mask`` is False.
"""

import warp as wp

from .mdp.randomization import DISTRIBUTIONS, OPERATIONS
from .mdp.randomization_bodies import randomize_rigid_body_mass
from .mdp.randomization_joints import randomize_actuator_gains, randomize_joint_parameters
from .mdp.randomization_shapes import randomize_rigid_body_material
from .model_data import BodyModelData, JointModelData, ShapeModelData

__all__ = ["scale_armatures", "scale_gains", "scale_masses", "set_friction"]

_SCALE = wp.constant(OPERATIONS["scale"])
_UNIFORM = wp.constant(DISTRIBUTIONS["uniform"])
_MIN_MASS = wp.constant(1.0e-6)  # [kg], as the event's default: a body that has mass keeps some


@wp.func
def _keep() -> wp.vec2:
    """The range ``randomization.KEEP``. Warp cannot write a vector constant of NaN."""
    return wp.vec2(wp.nan, wp.nan)


@wp.kernel
def scale_masses(
    mask: wp.array[wp.bool],
    rng: wp.array[wp.uint32],
    model: BodyModelData,
    body_ids: wp.array[int],
    scale: wp.vec2,
):
    """Scale masses and inertias of bodies, each by a uniform draw from the range ``scale``."""
    env = wp.tid()
    if mask[env]:
        randomize_rigid_body_mass(env, model, rng, body_ids, scale, _SCALE, _UNIFORM, True, _MIN_MASS)


@wp.kernel
def set_friction(
    mask: wp.array[wp.bool],
    rng: wp.array[wp.uint32],
    model: ShapeModelData,
    shape_ids: wp.array[int],
    friction: wp.vec2,
):
    """Set the coefficients of friction of shapes, each to a uniform draw from the range ``friction``."""
    env = wp.tid()
    if mask[env]:
        randomize_rigid_body_material(env, model, rng, shape_ids, friction, _keep())


@wp.kernel
def scale_gains(
    mask: wp.array[wp.bool],
    rng: wp.array[wp.uint32],
    model: JointModelData,
    joint_ids: wp.array[int],
    stiffness_scale: wp.vec2,
    damping_scale: wp.vec2,
):
    """Scale the gains of joint drives, each by a uniform draw; a range of ``KEEP`` leaves them alone."""
    env = wp.tid()
    if mask[env]:
        randomize_actuator_gains(env, model, rng, joint_ids, stiffness_scale, damping_scale, _SCALE, _UNIFORM)


@wp.kernel
def scale_armatures(
    mask: wp.array[wp.bool],
    rng: wp.array[wp.uint32],
    model: JointModelData,
    joint_ids: wp.array[int],
    scale: wp.vec2,
):
    """Scale the armatures of joints, each by a uniform draw from the range ``scale``."""
    env = wp.tid()
    if mask[env]:
        randomize_joint_parameters(
            env, model, rng, joint_ids, _keep(), scale, _keep(), _keep(), _keep(), _keep(), _SCALE, _UNIFORM
        )
