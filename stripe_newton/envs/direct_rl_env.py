# SPDX-License-Identifier: Apache-2.0
"""Direct RL environment: subclass it and fill the hooks, with torch or with Warp kernels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import warp as wp
from gymnasium import spaces

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseModel, NoiseModelCfg

from .direct_step import DirectStep
from .hook_parts import hook_recorder
from .hook_results import ObservationGroup
from .hooks import DirectHooks
from .rl_env_cfg import RLEnvCfg
from .spaces import SpaceSpec, to_space
from .warp_arrays import WarpArrays

__all__ = ["DirectRLEnv", "DirectRLEnvCfg"]


def _has_shape_of(own: SpaceSpec, value: SpaceSpec) -> bool:
    """Whether a space is a ``Box`` of the same shape as another one, with whatever bounds, or equal to it."""
    try:
        one, other = to_space(own), to_space(value)
    except (TypeError, ValueError):  # reported elsewhere
        return value == own
    boxes = isinstance(one, spaces.Box) and isinstance(other, spaces.Box)
    return one.shape == other.shape if boxes else one == other


@configclass
class DirectRLEnvCfg(RLEnvCfg):
    """Base config of direct environments; subclass it and add fields of your own."""

    FIXED_SPACES: ClassVar[tuple[str, ...]] = ()
    """Names of spaces that hooks take in the shape that the class has, so that any other is an error. Set it where
    kernels are written for so many numbers: they would go beyond the end of a smaller space."""
    observation_space: SpaceSpec = MISSING
    """Space of the group ``"policy"``, as :func:`to_space` reads it; a dict with the key ``"policy"`` names the spaces
    of all groups."""
    state_space: SpaceSpec = 0
    """Space of the group ``"critic"``, which ``_get_observations`` or ``_get_states`` fills; 0 for none."""
    action_space: SpaceSpec = MISSING
    """Space of the actions."""
    observation_noise_model: NoiseModelCfg | None = None
    """Noise on the group ``"policy"``."""
    action_noise_model: NoiseModelCfg | None = None
    """Noise on the actions."""
    apply_action: str = "auto"
    """Rate of ``_apply_action``: ``"substep"`` calls it before each physics step, ``"step"`` once before all of them,
    which are then one CUDA graph. ``"auto"`` begins with ``"step"`` and compares, in the first steps and now and
    then, the targets of all physics steps; if they differ it changes to ``"substep"``."""
    hooks_graph: bool | str = "auto"
    """Whether torch hooks become part of the step's CUDA graph, on a GPU: ``"auto"`` where a replay gives the same as
    the hook, ``True`` to make it an error where they cannot, ``False`` never. ``describe()`` says which are not and
    why."""
    hooks_fusion: bool = True
    """Whether chains of operations of recorded hooks become one kernel each, where that gives the same numbers.
    ``describe()`` says how many launches are left, or why there is none."""

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from RLEnvCfg.problems(self)
        if self.apply_action not in ("auto", "step", "substep"):
            yield "apply_action", f"is '{self.apply_action}', must be 'auto', 'step' or 'substep'"
        if self.hooks_graph not in ("auto", True, False):
            yield "hooks_graph", f"is {self.hooks_graph!r}, must be 'auto', True or False"
        for name in self.FIXED_SPACES:
            own, value = type(self).__dataclass_fields__[name].default, getattr(self, name)
            if own is not MISSING and not _has_shape_of(own, value):
                yield name, f"is {value!r}, must be {own!r}, which the hooks of this task are written for"
        for name in ("observation_space", "action_space", "state_space"):
            value = getattr(self, name)
            if value is MISSING or (name == "state_space" and not value):
                continue
            try:
                to_space(value)
            except ValueError as error:
                yield name, str(error)


class DirectRLEnv(DirectStep):
    """Base class of environments whose hooks compute observations, rewards and dones for all environments at once.

    A step runs in this order: noise on the actions, ``_pre_physics_step``, the physics (``decimation`` steps,
    ``_apply_action`` before them), episode length + 1, ``_get_dones``, ``_get_rewards``, ``_reset_idx`` for
    environments that are done, interval events, sensors, ``_get_observations``, ``_get_states``, noise on the
    observations. State is fresh wherever a hook reads it.

    Each of these hooks may be filled with torch, under the name above, or with Warp kernels, under the name
    ``_launch_pre_physics_step``, ``_launch_apply_action``, ``_launch_dones``, ``_launch_rewards``, ``_launch_reset`` or
    ``_launch_observations``. Warp hooks read and write the arrays of :attr:`warp` and become part of the step's CUDA
    graph. Torch hooks do, too, where a replay gives what the hook gives; others run between graphs.
    :meth:`describe` shows which is which, and why.

    Attributes:
        warp: Arrays of the Warp hooks: ``actions`` float ``(num_envs, num_actions)``, always finite; ``terminated``,
            ``truncated`` and ``reset`` bool ``(num_envs,)``; ``reward`` float ``(num_envs,)``; ``observations``, by
            group, float ``(num_envs, n)``; ``episode``, a ``stripe_kernels.data.EpisodeData``; ``rng`` uint32
            ``(num_envs,)``; ``step`` int64 ``(1,)``; ``log``, the step's :class:`EpisodeLog`.
    """

    cfg: DirectRLEnvCfg

    def __init__(self, cfg: DirectRLEnvCfg, render_mode: str | None = None, **kwargs: object):
        """Build scene and simulation.

        Args:
            cfg: The config; it is copied.
            render_mode: ``"rgb_array"`` for :meth:`render` to return pictures.
            kwargs: Not used; a subclass may have arguments of its own, and unknown ones are an error.

        Raises:
            ConfigError: all problems of the config at once.
            TypeError: if a class fills a hook twice, with torch and with Warp.
        """
        self._hooks = DirectHooks.of(type(self), DirectRLEnv)
        super().__init__(cfg, render_mode, **kwargs)
        self._make_spaces()
        self._observation_noise_model = self._make_noise(self.cfg.observation_noise_model)
        self._action_noise_model = self._make_noise(self.cfg.action_noise_model)
        self._make_hook_helpers(self.cfg)
        self._recorder = hook_recorder(self)
        self._observation_buffers: dict[str, ObservationGroup] = {}
        self._given = []
        self._make_warp()
        self._run_startup_events()

    def _make_noise(self, cfg: NoiseModelCfg | None) -> NoiseModel | None:
        return cfg.class_type(cfg, self.num_envs, self.device) if cfg is not None else None

    def _make_spaces(self) -> None:
        cfg = self.cfg
        groups = to_space(cfg.observation_space)
        named = isinstance(groups, spaces.Dict) and "policy" in groups.spaces
        own = dict(groups.spaces) if named else {"policy": groups}
        if cfg.state_space:
            own["critic"] = to_space(cfg.state_space)
        self._set_spaces(own, to_space(cfg.action_space))
        self.state_space = self.observation_space["critic"] if cfg.state_space else None

    def _make_warp(self) -> None:
        context, size = self.context, spaces.flatdim(self.single_action_space)
        self.warp = WarpArrays(
            actions=context.array("actions", wp.float32, size),
            terminated=context.episode.terminated,
            truncated=context.episode.truncated,
            reset=context.reset,
            reward=context.reward,
            episode=context.episode,
            rng=context.rng,
            step=context.step,
            log=context.log,
        )
        self._actions_name = context.scope.name("actions", self.warp.actions)
        self.actions = wp.to_torch(self.warp.actions)
        if self._hooks.observations.is_warp:
            for name, space in self.single_observation_space.spaces.items():
                shape = self.num_envs, spaces.flatdim(space)
                self.warp.observations[name] = self.outputs.reserve(f"obs.{name}", wp.float32, shape)
                context.arrays[f"obs.{name}"] = self.warp.observations[name]
                if self.cfg.compute_final_obs:
                    self.outputs.reserve(f"final.{name}", wp.float32, shape)
