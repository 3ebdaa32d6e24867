# SPDX-License-Identifier: Apache-2.0
"""Config of an environment in the direct workflow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseModelCfg

from .rl_env_cfg import RLEnvCfg
from .spaces import to_space

__all__ = ["DirectRLEnvCfg"]


@configclass
class DirectRLEnvCfg(RLEnvCfg):
    """What every direct environment has; subclass it and add fields of your own."""

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

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from RLEnvCfg.problems(self)
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
