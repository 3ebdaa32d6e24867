# SPDX-License-Identifier: Apache-2.0
"""Randomisation of joints: events that change gains, limits, friction, armature and default positions of joints.

``operation`` and ``distribution`` are codes of ``randomization.OPERATIONS`` and ``DISTRIBUTIONS``; a config gives their
names. Quantities whose range is ``randomization.KEEP`` are not changed and take no draw.
"""

from typing import TYPE_CHECKING

import warp as wp

from ..data import ArticulationData
from ..model_data import JointModelData
from ..removed_tables import forward_tables
from ..term_info import randomizes
from .randomization import KEEP, is_kept, randomize

__all__ = [
    "randomize_actuator_gains",
    "randomize_effort_limits",
    "randomize_joint_default_pos",
    "randomize_joint_parameters",
    "randomize_pd_gains",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(__name__, randomizations={"JOINT_RANDOMIZATIONS": __name__})

_BY_VALUE: dict[str, object] = {"operation": "abs", "distribution": "uniform"}
_BY_FACTOR: dict[str, object] = {"operation": "scale", "distribution": "uniform"}


@wp.func
def _not_negative(
    env: int, rng: wp.array[wp.uint32], default: float, params: wp.vec2, operation: int, distribution: int
) -> float:
    """Draw a new value of a quantity, limited to 0 from below."""
    return wp.max(randomize(env, rng, default, params, operation, distribution), 0.0)


@randomizes(
    ranges={
        "stiffness_distribution_params": ("stiffness", "not negative"),
        "damping_distribution_params": ("damping", "not negative"),
    },
    defaults={"stiffness_distribution_params": KEEP, "damping_distribution_params": KEEP, **_BY_VALUE},
)
@wp.func
def randomize_actuator_gains(
    env: int,
    model: JointModelData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    stiffness_distribution_params: wp.vec2,
    damping_distribution_params: wp.vec2,
    operation: int,
    distribution: int,
):
    """Randomise the gains of joint drives, implicit or explicit.

    Formula: ``kp_i = max(op(kp_default,i, draw), 0)`` [N/m or N m/rad], ``kd_i = max(op(kd_default,i, draw), 0)``
    [N s/m or N m s/rad].

    Source: Isaac Lab, ``mdp.randomize_actuator_gains``.
    """
    kp_range = stiffness_distribution_params
    kd_range = damping_distribution_params
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        if not is_kept(kp_range):
            kp = model.default_stiffness[env, joint]
            model.stiffness[env, joint] = _not_negative(env, rng, kp, kp_range, operation, distribution)
        if not is_kept(kd_range):
            kd = model.default_damping[env, joint]
            model.damping[env, joint] = _not_negative(env, rng, kd, kd_range, operation, distribution)


@randomizes(
    ranges={"kp_range": ("stiffness", "not negative"), "kd_range": ("damping", "not negative")}, defaults=_BY_FACTOR
)
@wp.func
def randomize_pd_gains(
    env: int,
    model: JointModelData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    kp_range: wp.vec2,
    kd_range: wp.vec2,
    operation: int,
    distribution: int,
):
    """Randomise the gains of joint drives, with mjlab's parameters; the default operation is ``"scale"``.

    Formula: ``kp_i = max(op(kp_default,i, draw), 0)`` [N/m or N m/rad], ``kd_i = max(op(kd_default,i, draw), 0)``
    [N s/m or N m s/rad].

    Source: mjlab, ``dr.pd_gains``.
    """
    randomize_actuator_gains(env, model, rng, joint_ids, kp_range, kd_range, operation, distribution)


@randomizes(ranges={"effort_limit_range": ("effort_limit", "not negative")}, defaults=_BY_FACTOR)
@wp.func
def randomize_effort_limits(
    env: int,
    model: JointModelData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    effort_limit_range: wp.vec2,
    operation: int,
    distribution: int,
):
    """Randomise the effort limits of joints.

    Formula: ``limit_i = max(op(limit_default,i, draw), 0)`` [N or N m].

    Source: mjlab, ``dr.effort_limits``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        limit = model.default_effort_limit[env, joint]
        model.effort_limit[env, joint] = _not_negative(env, rng, limit, effort_limit_range, operation, distribution)


@randomizes(
    ranges={
        "friction_distribution_params": ("friction", "not negative"),
        "armature_distribution_params": ("armature", "not negative"),
        "lower_limit_distribution_params": ("lower", "any"),
        "upper_limit_distribution_params": ("upper", "any"),
        "stiffness_distribution_params": ("passive_stiffness", "not negative"),
        "damping_distribution_params": ("passive_damping", "not negative"),
    },
    defaults={
        f"{name}_distribution_params": KEEP
        for name in ("friction", "armature", "lower_limit", "upper_limit", "stiffness", "damping")
    }
    | _BY_VALUE,
)
@wp.func
def randomize_joint_parameters(
    env: int,
    model: JointModelData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    friction_distribution_params: wp.vec2,
    armature_distribution_params: wp.vec2,
    lower_limit_distribution_params: wp.vec2,
    upper_limit_distribution_params: wp.vec2,
    stiffness_distribution_params: wp.vec2,
    damping_distribution_params: wp.vec2,
    operation: int,
    distribution: int,
):
    """Randomise Coulomb friction, armature, position limits, and passive stiffness and damping of joints.

    Formula: ``x_i = op(x_default,i, draw)``; friction [N or N m], armature [kg or kg m^2], stiffness [N/m or N m/rad]
    and damping [N s/m or N m s/rad] not below 0; limits [m or rad] that would cross are both set to their middle, or to
    the one that is kept.

    Source: Isaac Lab, ``mdp.randomize_joint_parameters``; stiffness and damping: mjlab, ``dr.joint_stiffness``,
    ``dr.joint_damping``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        if not is_kept(friction_distribution_params):
            friction = model.default_friction[env, joint]
            model.friction[env, joint] = _not_negative(
                env, rng, friction, friction_distribution_params, operation, distribution
            )
        if not is_kept(armature_distribution_params):
            armature = model.default_armature[env, joint]
            model.armature[env, joint] = _not_negative(
                env, rng, armature, armature_distribution_params, operation, distribution
            )
        # Present values: a limit that is kept may have been changed by an earlier term.
        lower = model.lower[env, joint]
        upper = model.upper[env, joint]
        if not is_kept(lower_limit_distribution_params):
            lower = randomize(
                env, rng, model.default_lower[env, joint], lower_limit_distribution_params, operation, distribution
            )
        if not is_kept(upper_limit_distribution_params):
            upper = randomize(
                env, rng, model.default_upper[env, joint], upper_limit_distribution_params, operation, distribution
            )
        if lower > upper:  # the solver needs an ordered pair; a limit that is kept wins over a drawn one
            if is_kept(lower_limit_distribution_params):
                upper = lower
            elif is_kept(upper_limit_distribution_params):
                lower = upper
            else:
                lower = 0.5 * (lower + upper)
                upper = lower
        model.lower[env, joint] = lower
        model.upper[env, joint] = upper
        if not is_kept(stiffness_distribution_params):
            stiffness = model.default_passive_stiffness[env, joint]
            model.passive_stiffness[env, joint] = _not_negative(
                env, rng, stiffness, stiffness_distribution_params, operation, distribution
            )
        if not is_kept(damping_distribution_params):
            damping = model.default_passive_damping[env, joint]
            model.passive_damping[env, joint] = _not_negative(
                env, rng, damping, damping_distribution_params, operation, distribution
            )


@randomizes(ranges={"ranges": ("initial_joint_pos", "any")}, defaults={"operation": "add", "distribution": "uniform"})
@wp.func
def randomize_joint_default_pos(
    env: int,
    robot: ArticulationData,
    model: JointModelData,
    rng: wp.array[wp.uint32],
    joint_ids: wp.array[int],
    ranges: wp.vec2,
    operation: int,
    distribution: int,
):
    """Randomise the default positions of joints, and set their targets to them.

    Resets, actions with ``use_default_offset`` and relative observations use the new default positions. List this term
    before the term that resets the joints.

    Formula: ``q_default,i = op(q_configured,i, draw)``, ``q*_i = q_default,i`` [m or rad].

    Source: mjlab, ``dr.joint_default_pos``.
    """
    # From the configured position, not from the present default, which an earlier episode has randomised.
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        configured = model.initial_joint_pos[env, joint]
        position = randomize(env, rng, configured, ranges, operation, distribution)
        robot.default_joint_pos[env, joint] = position
        robot.joint_pos_target[env, joint] = position
