# SPDX-License-Identifier: Apache-2.0
"""Manager-based RL environment config: a field for each manager, which a lab scene and an environment read alike."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from stripe_kernels import mdp
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.managers import EventTermCfg, TerminationTermCfg
from stripe_newton.managers.manager_base import terms_of

from .manager_fields import manager_field_problems
from .rl_env_cfg import RLEnvCfg

__all__ = ["MAX_STEPS", "DefaultEventsCfg", "ManagerBasedRLEnvCfg"]

MAX_STEPS = 2**31 - 2
"""Steps of an episode without end: the largest count of the environment's clocks, less one."""


@configclass
class DefaultEventsCfg:
    """Default events of a config that names none."""

    reset_scene_to_default = EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")
    """Every asset begins an episode in its default state."""


@configclass
class ManagerBasedRLEnvCfg(RLEnvCfg):
    """Config of an environment made of terms. Each manager's field is a config whose fields are terms, or a dict."""

    observations: object = MISSING
    """Observation groups: :class:`ObservationGroupCfg`; ``policy`` is needed."""
    actions: object = MISSING
    """Action terms."""
    rewards: object = MISSING
    """Reward terms: :class:`RewardTermCfg`."""
    terminations: object = MISSING
    """Termination terms: :class:`TerminationTermCfg`."""
    events: object = DefaultEventsCfg()
    """Events: :class:`EventTermCfg`. An asset whose root or joints no event resets begins in its default state."""
    keep_at_reset: Sequence[str] = ()
    """Expressions for the names of assets that stay as they are where an episode begins, unless events reset them."""
    commands: object = None
    """Command terms."""
    curriculum: object = None
    """Curriculum terms: :class:`CurriculumTermCfg`."""
    objects: object = None
    """Pools of rigid objects: :class:`ObjectPoolCfg`."""
    metrics: object = None
    """Metric terms: :class:`MetricTermCfg`."""
    managers: object = None
    """Managers of your own by name: :class:`CustomManagerCfg`."""
    recorders: object = None
    """Recorder terms and the file they write to: :class:`RecorderManagerBaseCfg`."""
    scale_rewards_by_dt: bool = True
    """Multiply rewards by the environment's time step, so that weights are per second."""

    def complete(self) -> None:
        """In an imported scenery, measure the heights of falls above the storey that a robot is on."""
        if self.scene is MISSING or self.scene.scenery_file is None:
            return
        for term in terms_of(self.terminations).values():
            if isinstance(term, TerminationTermCfg) and term.func is mdp.root_height_below_minimum:
                term.func = mdp.root_height_over_ground_below_minimum

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from RLEnvCfg.problems(self)
        yield from manager_field_problems(self)
