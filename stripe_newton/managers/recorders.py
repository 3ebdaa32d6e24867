# SPDX-License-Identifier: Apache-2.0
"""What can be recorded."""

from __future__ import annotations

from typing import Any

import torch

from stripe_newton.configclass import configclass

from .recorder_cfg import RecorderManagerBaseCfg, RecorderTermCfg

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
    "Recorded",
    "RecorderTerm",
]

Recorded = tuple[str | None, Any]
"""Key and value: a tensor, or nested dicts of tensors. The key may be a path, ``"obs/joint_pos"``; None for nothing."""


class RecorderTerm:
    """Says what to record at four points of a step; a subclass overrides those it needs.

    What is returned is copied at once, so a view of the simulation's memory may be returned as it is. The calls before
    and after a step return one row an environment, those around a reset one row for each of ``env_ids``.
    """

    def __init__(self, cfg: RecorderTermCfg, env: Any):
        """Keep config and environment."""
        self.cfg, self._env = cfg, env

    def record_pre_step(self) -> Recorded:
        """After the actions were processed, before physics."""
        return None, None

    def record_post_step(self) -> Recorded:
        """After physics and rewards, before environments are reset."""
        return None, None

    def record_pre_reset(self, env_ids: torch.Tensor) -> Recorded:
        """Before environments are reset, at the end of their episodes; ``env_ids`` is int64."""
        return None, None

    def record_post_reset(self, env_ids: torch.Tensor) -> Recorded:
        """After environments were reset, at the start of their episodes; ``env_ids`` is int64."""
        return None, None


class InitialStateRecorder(RecorderTerm):
    """``initial_state``: the state of all assets at the start of the episode, one row."""

    def record_post_reset(self, env_ids: torch.Tensor) -> Recorded:
        return "initial_state", _rows(self._env.scene.get_state(is_relative=True), env_ids)


class PostStepStatesRecorder(RecorderTerm):
    """``states``: the state of all assets after each step."""

    def record_post_step(self) -> Recorded:
        return "states", self._env.scene.get_state(is_relative=True)


class PreStepActionsRecorder(RecorderTerm):
    """``actions``: what the policy asked for."""

    def record_pre_step(self) -> Recorded:
        return "actions", self._env.actions


class PostStepProcessedActionsRecorder(RecorderTerm):
    """``processed_actions``: what the action terms made of it."""

    def record_post_step(self) -> Recorded:
        return "processed_actions", self._env.processed_actions


class PreStepFlatPolicyObservationsRecorder(RecorderTerm):
    """``obs/policy``: what the policy saw; ``obs/TERM`` where the terms of the group are not concatenated."""

    def record_pre_step(self) -> Recorded:
        seen = self._env.obs_buf.get("policy")
        if seen is None:  # no observation was handed out yet
            return None, None
        return "obs", seen if isinstance(seen, dict) else {"policy": seen}


def _rows(value: Any, env_ids: torch.Tensor) -> Any:
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
    """All that replaying an episode and learning from it take."""

    record_initial_state: RecorderTermCfg | None = InitialStateRecorderCfg()
    record_post_step_states: RecorderTermCfg | None = PostStepStatesRecorderCfg()
    record_pre_step_actions: RecorderTermCfg | None = PreStepActionsRecorderCfg()
    record_pre_step_flat_policy_observations: RecorderTermCfg | None = PreStepFlatPolicyObservationsRecorderCfg()
    record_post_step_processed_actions: RecorderTermCfg | None = PostStepProcessedActionsRecorderCfg()
