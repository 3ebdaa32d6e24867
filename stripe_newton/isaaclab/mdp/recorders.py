# SPDX-License-Identifier: Apache-2.0
"""Recorders of ``isaaclab.envs.mdp``: those of the package, whose files have quaternions (w, x, y, z)."""

from __future__ import annotations

from stripe_newton.configclass import configclass
from stripe_newton.managers import recorders as native
from stripe_newton.managers.recorders import (
    InitialStateRecorder,
    InitialStateRecorderCfg,
    PostStepProcessedActionsRecorder,
    PostStepProcessedActionsRecorderCfg,
    PostStepStatesRecorder,
    PostStepStatesRecorderCfg,
    PreStepActionsRecorder,
    PreStepActionsRecorderCfg,
    PreStepFlatPolicyObservationsRecorder,
    PreStepFlatPolicyObservationsRecorderCfg,
)

__all__ = [
    "ActionStateRecorderManagerCfg",
    "InitialStateRecorder",
    "InitialStateRecorderCfg",
    "PostStepProcessedActionsRecorder",
    "PostStepProcessedActionsRecorderCfg",
    "PostStepStatesRecorder",
    "PostStepStatesRecorderCfg",
    "PreStepActionsRecorder",
    "PreStepActionsRecorderCfg",
    "PreStepFlatPolicyObservationsRecorder",
    "PreStepFlatPolicyObservationsRecorderCfg",
]


@configclass
class ActionStateRecorderManagerCfg(native.ActionStateRecorderManagerCfg):
    """:class:`stripe_newton.managers.ActionStateRecorderManagerCfg`; states in files are (w, x, y, z)."""

    quaternion_order: str = "wxyz"
