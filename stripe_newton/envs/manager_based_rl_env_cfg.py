# SPDX-License-Identifier: Apache-2.0
"""Config of a manager-based environment."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stripe_kernels import mdp
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.managers import EventTermCfg

from .rl_env_cfg import RLEnvCfg

__all__ = ["DefaultEventsCfg", "ManagerBasedRLEnvCfg"]


@configclass
class DefaultEventsCfg:
    """What happens where a config names no events."""

    reset_scene_to_default = EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")
    """Every asset begins an episode in its default state."""


@configclass
class ManagerBasedRLEnvCfg(RLEnvCfg):
    """What an environment made of terms has. Each manager's field is a config whose fields are terms, or a dict."""

    observations: Any = MISSING
    """Observation groups: :class:`ObservationGroupCfg`; ``policy`` is needed."""
    actions: Any = MISSING
    """Action terms."""
    rewards: Any = MISSING
    """Reward terms: :class:`RewardTermCfg`."""
    terminations: Any = MISSING
    """Termination terms: :class:`TerminationTermCfg`."""
    events: Any = DefaultEventsCfg()
    """Events: :class:`EventTermCfg`; by default a reset brings everything to its default state."""
    commands: Any = None
    """Command terms."""
    curriculum: Any = None
    """Curriculum terms: :class:`CurriculumTermCfg`."""
    objects: Any = None
    """Pools of rigid objects: :class:`ObjectPoolCfg`."""
    metrics: Any = None
    """Metric terms: :class:`MetricTermCfg`."""
    recorders: Any = None
    """What is recorded to a file: :class:`RecorderManagerBaseCfg`."""
    scale_rewards_by_dt: bool = True
    """Whether rewards are multiplied by the environment's time step, so that weights are per second."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from RLEnvCfg.problems(self)
