# SPDX-License-Identifier: Apache-2.0
"""Recorders: recorder terms of the package."""

from __future__ import annotations

from typing import Any

import torch

from stripe_newton.configclass import configclass

from .episode_file import Episode
from .recorder_manager import RecorderManagerBaseCfg
from .recorder_term import Recorded, RecorderTerm, RecorderTermCfg

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


class InitialStateRecorder(RecorderTerm):
    """``initial_state``: the state of all assets at the start of the episode, one row."""

    def record_post_reset(self, env_ids: torch.Tensor) -> Recorded:
        return "initial_state", _rows(self._env.scene.querier.get_state(is_relative=True), env_ids)


class PostStepStatesRecorder(RecorderTerm):
    """``states``: the state of all assets after each step."""

    def record_post_step(self) -> Recorded:
        return "states", self._env.scene.querier.get_state(is_relative=True)


class PreStepActionsRecorder(RecorderTerm):
    """``actions``: actions of the policy."""

    def record_pre_step(self) -> Recorded:
        return "actions", self._env.actions


class PostStepProcessedActionsRecorder(RecorderTerm):
    """``processed_actions``: actions after the scale, offset and clip of the action terms."""

    def record_post_step(self) -> Recorded:
        return "processed_actions", self._env.processed_actions


class PreStepFlatPolicyObservationsRecorder(RecorderTerm):
    """``obs/policy``: observations of the policy; ``obs/TERM`` where the terms of the group are not concatenated."""

    def record_pre_step(self) -> Recorded:
        seen = self._env.obs_buf.get("policy")
        if seen is None:  # before the first reset
            return None, None
        return "obs", seen if isinstance(seen, dict) else {"policy": seen}


def _rows(value: Episode | torch.Tensor, env_ids: torch.Tensor) -> Any:
    return {k: _rows(v, env_ids) for k, v in value.items()} if isinstance(value, dict) else value[env_ids]


@configclass
class InitialStateRecorderCfg(RecorderTermCfg):
    """Config of :class:`InitialStateRecorder`."""

    class_type: type = InitialStateRecorder


@configclass
class PostStepStatesRecorderCfg(RecorderTermCfg):
    """Config of :class:`PostStepStatesRecorder`."""

    class_type: type = PostStepStatesRecorder


@configclass
class PreStepActionsRecorderCfg(RecorderTermCfg):
    """Config of :class:`PreStepActionsRecorder`."""

    class_type: type = PreStepActionsRecorder


@configclass
class PreStepFlatPolicyObservationsRecorderCfg(RecorderTermCfg):
    """Config of :class:`PreStepFlatPolicyObservationsRecorder`."""

    class_type: type = PreStepFlatPolicyObservationsRecorder


@configclass
class PostStepProcessedActionsRecorderCfg(RecorderTermCfg):
    """Config of :class:`PostStepProcessedActionsRecorder`."""

    class_type: type = PostStepProcessedActionsRecorder


@configclass
class ActionStateRecorderManagerCfg(RecorderManagerBaseCfg):
    """Recorder config with all that is needed to replay episodes and to learn from them."""

    record_initial_state: RecorderTermCfg | None = InitialStateRecorderCfg()
    record_post_step_states: RecorderTermCfg | None = PostStepStatesRecorderCfg()
    record_pre_step_actions: RecorderTermCfg | None = PreStepActionsRecorderCfg()
    record_pre_step_flat_policy_observations: RecorderTermCfg | None = PreStepFlatPolicyObservationsRecorderCfg()
    record_post_step_processed_actions: RecorderTermCfg | None = PostStepProcessedActionsRecorderCfg()
