# SPDX-License-Identifier: Apache-2.0
"""Encoder bias: the event that draws it, and observations and actions of joint encoders that are off by a constant.

An encoder with a bias ``b`` reads ``q + b``. The policy observes that, and drives that hold a position by the encoder
stop at ``q* - b``.
"""

from typing import TYPE_CHECKING

import warp as wp

from ..data import ArticulationData
from ..model_data import EncoderData
from ..removed_tables import forward_tables
from ..term_info import Each, randomizes, writes
from . import random

__all__ = [
    "apply_joint_position_biased",
    "joint_pos_biased",
    "joint_pos_rel_biased",
    "randomize_encoder_bias",
]

if not TYPE_CHECKING:
    __getattr__ = forward_tables(
        __name__, sizes={"ENCODER_OBSERVATION_SIZES": __name__}, randomizations={"ENCODER_RANDOMIZATIONS": __name__}
    )


@randomizes(ranges={"bias_range": ("", "any")})
@wp.func
def randomize_encoder_bias(
    env: int, encoder: EncoderData, rng: wp.array[wp.uint32], joint_ids: wp.array[int], bias_range: wp.vec2
):
    """Randomise the bias of joint encoders.

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
    """Joint positions as read by their encoders [m or rad].

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
    """Joint positions as read by their encoders, relative to the default positions [m or rad].

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
    """Set joint position targets for drives that measure by encoders; use with ``JointPositionActionCfg(apply=...)``.

    Formula: ``q*_i = u_i - b_i`` [m or rad].

    Source: mjlab, ``JointPositionAction``.
    """
    for i in range(joint_ids.shape[0]):
        joint = joint_ids[i]
        robot.joint_pos_target[env, joint] = processed[i] - encoder.bias[env, joint]
