# SPDX-License-Identifier: Apache-2.0
"""Joint encoders that are off by a constant: the event that draws it, and observations and actions through them.

A controller sees ``q + b``. Its policy observes that, and where its drives hold a position by the encoder they stop at
``q* - b``.
"""

import warp as wp

from ..data import ArticulationData
from ..model_data import EncoderData
from ..term_info import Each, randomizes, writes
from . import random

__all__ = [
    "apply_joint_position_biased",
    "joint_pos_biased",
    "joint_pos_rel_biased",
    "randomize_encoder_bias",
]


@randomizes(ranges={"bias_range": ("", "any")})
@wp.func
def randomize_encoder_bias(
    env: int, encoder: EncoderData, rng: wp.array[wp.uint32], joint_ids: wp.array[int], bias_range: wp.vec2
):
    """Draw by how much the encoders of joints are off.

    Formula: ``b_i = U(bias_range)`` [m or rad].

    Source: mjlab, ``dr.encoder_bias``.
    """
    for i in range(joint_ids.shape[0]):
        encoder.bias[env, joint_ids[i]] = random.uniform_range(env, rng, bias_range)


@writes(Each("joint_ids"))
@wp.func
def joint_pos_biased(
    env: int, robot: ArticulationData, encoder: EncoderData, joint_ids: wp.array[int], out: wp.array[float]
):
    """Joint positions as their encoders show them [m or rad].

    Formula: ``q_i + b_i``.

    Source: mjlab, ``mdp.joint_pos_rel`` with ``biased``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        out[i] = robot.joint_pos[env, joint] + encoder.bias[env, joint]


@writes(Each("joint_ids"))
@wp.func
def joint_pos_rel_biased(
    env: int, robot: ArticulationData, encoder: EncoderData, joint_ids: wp.array[int], out: wp.array[float]
):
    """Joint positions as their encoders show them, relative to those at the start of an episode [m or rad].

    Formula: ``q_i + b_i - q_default,i``.

    Source: mjlab, ``mdp.joint_pos_rel`` with ``biased``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        shown = robot.joint_pos[env, joint] + encoder.bias[env, joint]
        out[i] = shown - robot.default_joint_pos[env, joint]


@wp.func
def apply_joint_position_biased(
    env: int, processed: wp.array[float], robot: ArticulationData, encoder: EncoderData, joint_ids: wp.array[int]
):
    """Set position targets that drives hold by their encoders: ``JointPositionActionCfg(apply=...)``.

    Formula: ``q*_i = u_i - b_i`` [m or rad].

    Source: mjlab, ``JointPositionAction``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        robot.joint_pos_target[env, joint] = processed[i] - encoder.bias[env, joint]
