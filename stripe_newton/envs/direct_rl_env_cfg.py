# SPDX-License-Identifier: Apache-2.0
"""Config of an environment in the direct workflow."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseModelCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import SimulationCfg
from stripe_newton.viewers import ViewerCfg

from .spaces import to_space

__all__ = ["DirectRLEnvCfg"]


@configclass
class DirectRLEnvCfg:
    """What every direct environment has; subclass it and add fields of your own."""

    viewer: ViewerCfg = ViewerCfg()
    """Camera of ``render()`` and of videos."""
    sim: SimulationCfg = SimulationCfg()
    """Time step, gravity, device, solver."""
    seed: int | None = None
    """Seed of the random numbers; ``None`` leaves them unseeded."""
    decimation: int = MISSING
    """Physics steps in an environment step."""
    is_finite_horizon: bool = False
    """Whether the time limit is part of the task. Then time-outs are not handed to the learner as truncation."""
    episode_length_s: float = MISSING
    """Duration of an episode [s]."""
    scene: InteractiveSceneCfg = MISSING
    """The scene."""
    events: Any = None
    """Config whose fields are :class:`EventTermCfg`, or a dict of them."""
    observation_space: Any = MISSING
    """Space of the group ``"policy"``, as :func:`to_space` reads it; a dict with the key ``"policy"`` names the spaces
    of all groups."""
    state_space: Any = 0
    """Space of the group ``"critic"``, which ``_get_states`` fills; 0 for none."""
    action_space: Any = MISSING
    """Space of the actions."""
    observation_noise_model: NoiseModelCfg | None = None
    """Noise on the group ``"policy"``."""
    action_noise_model: NoiseModelCfg | None = None
    """Noise on the actions."""
    apply_action: str = "auto"
    """When ``_apply_action`` runs: ``"substep"`` before each physics step, ``"step"`` once before all of them, which
    are one CUDA graph then. ``"auto"`` watches the first steps, and later ones now and then: while what the hook sets
    does not change from one physics step to the next, it runs once."""
    compute_final_obs: bool = False
    """Put the observation that an episode ended with into ``extras["final_obs"]``."""
    rerender_on_reset: bool = False
    """Accepted for compatibility: a picture is rendered when asked for, from the state there is."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.decimation is not MISSING and (not isinstance(self.decimation, int) or self.decimation < 1):
            yield "decimation", f"is {self.decimation!r}, must be a whole number of physics steps, 1 or more"
        length = self.episode_length_s
        if length is not MISSING and not (math.isfinite(length) and length > 0):
            yield "episode_length_s", f"is {length!r}, must be a positive time [s]"
        if self.apply_action not in ("auto", "step", "substep"):
            yield "apply_action", f"is '{self.apply_action}', must be 'auto', 'step' or 'substep'"
        for name in ("observation_space", "action_space", "state_space"):
            value = getattr(self, name)
            if value is MISSING or (name == "state_space" and not value):
                continue
            try:
                to_space(value)
            except ValueError as error:
                yield name, str(error)
