# SPDX-License-Identifier: Apache-2.0
"""Direct RL environment: subclass it and fill the hooks, with torch or with Warp kernels."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import ClassVar

import numpy as np
import torch
import warp as wp
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from stripe_newton.configclass import MISSING, ConfigError, configclass
from stripe_newton.fusion import HostFunction, Item, KernelLaunches, Section, Stage
from stripe_newton.noise import NoiseModel, NoiseModelCfg

from .hook_parts import hook_recorder
from .hook_results import ObservationGroup, copied, leaves_of
from .hooks import DirectHooks
from .recording_env import RecordingEnv
from .rl_env import Observations
from .rl_env_cfg import RLEnvCfg
from .spaces import SpaceSpec, nested_mismatches, to_space
from .stage_items import count_section, scenery_items, sensor_items
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


class DirectRLEnv(RecordingEnv):
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
        # Actions of the step under way. In a list, as they are the caller's and no part of a saved state.
        self._given: list[torch.Tensor] = []
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

    # -- the step

    def _stages(self) -> list[Stage]:
        return [
            Stage("actions", self._action_items()),
            Stage("physics", self._physics_items()),
            # Sensors measure the new state before dones and rewards read them.
            *self._measurements_stage(),
            Stage("outcome", self._outcome_items()),
            # Resets lie within the step, so the observations below are those of the new episodes.
            Stage("reset", self._reset_items()),
            Stage("events", self._event_items()),
            # After a torch hook the bodies have been computed already, for the environments that it was called with.
            Stage("forward kinematics", self._safety.forward() if self._hooks.reset.is_warp else []),
            Stage("sensors", self._sensor_items()),
            Stage("observations", self._observation_items()),
        ]

    def _action_items(self) -> list[Item]:
        if self._hooks.pre_physics.is_warp:
            finite = self._safety.actions(self._actions_name)
            launch = KernelLaunches(
                "_launch_pre_physics_step", lambda: self._launch_pre_physics_step(self.warp.actions)
            )
            return [finite, launch]
        noise = ", noise" if self._action_noise_model is not None else ""
        return [self._torch_item(f"_pre_physics_step{noise}", self._torch_pre_physics, "_pre_physics_step")]

    def _physics_items(self) -> list[Item]:
        steps, name = self.cfg.decimation, self._physics_name
        alone = KernelLaunches(name, lambda: self.sim.launch(steps))
        if self._hooks.apply_action.is_warp and self._substeps.mode == "step":
            return [KernelLaunches("_launch_apply_action", self._launch_apply_action), alone]
        if self._hooks.apply_action.is_warp:
            each = self._launch_apply_action
            return [KernelLaunches(f"{name}, _launch_apply_action before each", lambda: self.sim.launch(steps, each))]
        if self._hooks.pre_physics.is_warp and self._hooks.apply_action.is_empty:
            return [alone]
        return [self._torch_physics()]

    def _outcome_items(self) -> list[Item]:
        context = self.context
        # The length of the episode counts this step already where dones and rewards look at it, as in Isaac Lab.
        items: list[Item] = [count_section(context).only(context.within_step), self._safety.after_physics()]
        items.append(
            self._hooks.dones.item(
                self._launch_dones,
                # The counter includes this step from here on, as in Isaac Lab.
                lambda name: self._torch_item(name, self._torch_dones, "_get_dones", self.count_step),
            )
        )
        if self._hooks.dones.is_warp:
            body = [
                context.code("{episode.terminated}[env] = {episode.terminated}[env] or {nonfinite}[env]"),
                context.code("{reset}[env] = {episode.terminated}[env] or {episode.truncated}[env]"),
                context.code("{moved}[env] = {reset}[env]"),
            ]
            items.append(Section("ended", body).only(context.within_step))
        items.append(
            self._hooks.rewards.item(
                self._launch_rewards,
                lambda name: self._torch_item(name, self._torch_rewards, "_get_rewards", self.count_step),
            )
        )
        if self._hooks.rewards.is_warp:
            finite = [context.code("if {nonfinite}[env]:"), context.code("    {reward}[env] = 0.0")]
            items.append(Section("finite_reward", finite))
        return items

    def _torch_dones(self) -> None:
        self._end_episodes(*self._get_dones())

    def _torch_rewards(self) -> None:
        rewards = self._per_env(self._get_rewards(), "_get_rewards")
        self.reward_buf[:] = torch.where(self._safety.nonfinite, 0.0, rewards)

    def _reset_items(self) -> list[Item]:
        items = self._list_items()
        if self.cfg.compute_final_obs:
            items.append(HostFunction("final observations", self._keep_final_observations, "torch copies"))
        if not self._hooks.reset.is_warp:
            return [*items, self._torch_reset_item("_reset_idx, forward kinematics")]
        if self._events is not None or self._noise_models():
            items.append(HostFunction("reset events, noise models", self._torch_reset_events, "torch terms"))
        items += [self._safety.begin_reset(), *scenery_items(self.scene, self.context)]
        items.append(KernelLaunches("_launch_reset", lambda: self._launch_reset(self.warp.reset)))
        return [*items, *sensor_items(self.scene, self.context, "launch_reset"), self._safety.end_reset()]

    def _torch_reset_events(self) -> None:
        ids = self.context.reset_mask.indices()
        if len(ids):
            self._reset_events(ids)
            for model in self._noise_models():
                model.reset(ids)

    def _keep_final_observations(self) -> None:
        if not self._is_final():
            return
        if self._hooks.observations.is_warp:
            self._launch_observations()
            groups = {k: wp.to_torch(v) for k, v in self.warp.observations.items()}
        else:
            groups = self._torch_groups()
        if self._recorder is not None:
            self._recorder.settle()
        self.extras["final_obs"] = copied(groups)
        self.extras["_final_obs"] = self.reset_buf.clone()

    def _event_items(self) -> list[Item]:
        own = type(self)._interval_events is not DirectRLEnv._interval_events
        if own or (self._events is not None and self._events.has_intervals):
            events = self._torch_item("interval events", self._torch_events, "_interval_events")
            return [events if self._recorder is not None else dataclasses.replace(events, reason="torch terms")]
        return []

    def _observation_items(self) -> list[Item]:
        noise = ", noise" if self._observation_noise_model is not None else ""
        observe = self._hooks.observations.item(
            self._launch_observations,
            lambda name: self._torch_item(name, self._torch_observations, "_get_observations"),
            noise,
        )
        return [observe, *self._log_items()]

    def _torch_events(self) -> None:
        self._interval_events(self.step_dt)

    def _torch_observations(self) -> None:
        # Copies: learners keep observations, and a hook may return the same tensor in every step.
        groups = self._torch_groups()
        if self._recorder is None:
            self._observed = copied(groups)
            return
        # A graph writes the same memory in each step, so learners get copies of that, at the end of the step.
        if not self._observation_buffers:
            self._observation_buffers = {k: self._observation_buffer(k, v) for k, v in groups.items()}
        for name, value in groups.items():
            for buffer, leaf in zip(leaves_of(self._observation_buffers[name]), leaves_of(value), strict=True):
                buffer.copy_(leaf)

    def _observation_buffer(self, name: str, value: ObservationGroup) -> ObservationGroup:
        if not isinstance(value, torch.Tensor):  # dicts and tuples of tensors
            return copied(value)
        if value.dtype == torch.float32:
            return wp.to_torch(self.outputs.reserve(f"obs.{name}", wp.float32, tuple(value.shape)))
        return torch.empty_like(value, memory_format=torch.contiguous_format)

    def _torch_groups(self) -> dict[str, torch.Tensor]:
        groups: Observations = dict(self._get_observations())
        if self.cfg.state_space and "critic" not in groups:
            groups["critic"] = self._get_states()
        if not self._checked:
            self._check_observations(groups)
        if self._observation_noise_model is not None:
            groups["policy"] = self._observation_noise_model(groups["policy"])
        return groups

    def _take_action(self, action: torch.Tensor) -> None:
        if self._hooks.pre_physics.is_warp:
            if self._action_noise_model is not None:
                action = self._action_noise_model(action.float())
            wp.to_torch(self.warp.actions).copy_(action.reshape(self.num_envs, -1))
            return
        if self._recorder is None:
            self._given = [action]
        elif self._given and self._given[0].shape == action.shape and self._given[0].dtype == action.dtype:
            self._given[0].copy_(action)  # where graphs read it
        else:
            if self._given:
                self._recorder.start_again("the actions change their type again and again")
            self._given = [action.clone()]

    def _torch_pre_physics(self) -> None:
        (action,) = self._given
        if self._action_noise_model is not None:
            action = self._action_noise_model(action.float())
        # A copy, as the hook may keep it or change it in place, and the tensor belongs to the caller.
        # It is no attribute, which would be saved with the state: replays of a recorded hook would not bind it anew.
        own = action.float().clone() if action.is_floating_point() else action.clone()
        if own.is_floating_point():
            self._safety.make_finite(own)
        self._pre_physics_step(own)

    def _collect_observations(self, values: dict[str, torch.Tensor]) -> Observations:
        if not self._hooks.observations.is_warp:
            if self._recorder is None:
                return self._observed
            return {k: values.get(f"obs.{k}", v) for k, v in self._observation_buffers.items()}
        groups = {name: self._shaped(name, values[f"obs.{name}"]) for name in self.warp.observations}
        if self._observation_noise_model is not None:
            groups["policy"] = self._observation_noise_model(groups["policy"])
        return groups

    def _shaped(self, name: str, flat: torch.Tensor) -> torch.Tensor:
        """Observations that a Warp hook wrote, ``(num_envs, size)``, in the shape of their space, such as pictures."""
        shape = self.single_observation_space[name].shape
        return flat if shape is None or len(shape) < 2 else flat.view(-1, *shape)

    def why_not_capturable(self) -> str:
        own = self._recorder is not None and not self._hooks.pre_physics.is_warp
        if self._noise_models() and not (own and not self._hooks.observations.is_warp):
            return "noise models are torch modules"
        reason = super().why_not_capturable()
        if not reason and self._recorder is not None and self._apply_part is not None and self._substeps.mode == "auto":
            return "apply_action is 'auto', which watches some steps: set 'step' or 'substep'"
        return reason

    def _noise_models(self) -> list[NoiseModel]:
        return [m for m in (self._action_noise_model, self._observation_noise_model) if m is not None]

    def state_parts(self) -> list[dict[str, torch.Tensor]]:
        """State of the noise models and of the clocks of events, as the dicts in which they keep it."""
        models = [m.__dict__ for m in self._noise_models()]
        return [*models, *(self._events.clocks() if self._events is not None else [])]

    # -- hooks

    def _setup_scene(self) -> None:
        """Create assets, spawn ground and lights, call ``self.scene.clone_environments``. The default adds nothing:
        the fields of the scene config are there already."""

    def _pre_physics_step(self, actions: torch.Tensor) -> None:
        """Process the actions once, before the physics.

        Args:
            actions: Shape ``(num_envs, *action_shape)``.
        """
        raise NotImplementedError(f"{type(self).__name__} needs '_pre_physics_step(self, actions)'")

    def _apply_action(self) -> None:
        """Set targets or forces, before the physics steps; see ``DirectRLEnvCfg.apply_action``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_apply_action(self)'")

    def _get_observations(self) -> Observations:
        """Observations by group; ``"policy"`` is needed. Shapes ``(num_envs, *shape)``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_observations(self)' that returns a dict")

    def _get_states(self) -> torch.Tensor | None:
        """Observations of the critic, shape ``(num_envs, n)``; called where ``state_space`` is set."""
        return None

    def _get_rewards(self) -> torch.Tensor:
        """Rewards, float, shape ``(num_envs,)``."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_rewards(self)'")

    def _get_dones(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Terminated and timed out, bool, shape ``(num_envs,)`` each."""
        raise NotImplementedError(f"{type(self).__name__} needs '_get_dones(self)'")

    def _reset_idx(self, env_ids: Sequence[int] | torch.Tensor | None) -> None:
        """Begin new episodes; a subclass calls this first, then writes its initial states.

        Args:
            env_ids: Environments, int64, shape ``(n,)``; ``None`` means all.
        """
        ids = self._env_indices(env_ids)
        self.scene.reset(ids)
        self._reset_events(ids)
        for model in self._noise_models():
            model.reset(ids)
        self._episode_length_buf[ids] = 0

    def _reset_events(self, env_ids: torch.Tensor) -> None:
        """Runs at every reset, before the subclass writes its initial states; the default runs ``cfg.events``."""
        if self._events is not None:
            self._events.reset(env_ids)

    def _interval_events(self, dt: float) -> None:
        """Runs in every step after the resets; the default runs the interval terms of ``cfg.events`` that are due.

        A subclass that overrides it and writes positions calls ``self.sim.forward()`` after.
        """
        if self._events is not None and self._events.interval(dt):
            self.sim.forward()

    # -- Warp hooks: they launch kernels on the arrays of ``self.warp`` and do nothing else

    def _launch_pre_physics_step(self, actions: wp.array) -> None:
        """Process the actions once, before the physics.

        Args:
            actions: float, shape ``(num_envs, num_actions)``; finite.
        """
        raise NotImplementedError

    def _launch_apply_action(self) -> None:
        """Set targets or forces: before each physics step, or once with ``apply_action="step"``."""
        raise NotImplementedError

    def _launch_dones(self) -> None:
        """Write ``warp.terminated`` and ``warp.truncated``."""
        raise NotImplementedError

    def _launch_rewards(self) -> None:
        """Write ``warp.reward``."""
        raise NotImplementedError

    def _launch_reset(self, env_mask: wp.array) -> None:
        """Write the initial states of the environments whose episode begins; targets are their defaults already.

        Bodies follow and the solver's memory is cleared afterwards.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """
        raise NotImplementedError

    def _launch_observations(self) -> None:
        """Write ``warp.observations``."""
        raise NotImplementedError

    def set_debug_vis(self, debug_vis: bool) -> bool:
        """Ask the subclass to show or hide its markers; whether it has any."""
        try:
            self._set_debug_vis_impl(debug_vis)
        except NotImplementedError:
            return False
        return True

    def _set_debug_vis_impl(self, debug_vis: bool) -> None:
        """Show or hide markers."""
        raise NotImplementedError

    def _check_observations(self, groups: Observations) -> None:
        """Compare the first observations with the spaces; groups that no space names get one."""
        problems = []
        if "policy" not in groups:
            problems.append(
                f"_get_observations: returned {', '.join(groups) or 'nothing'}, must have the group 'policy'"
            )
        for name, value in groups.items():
            space = self.single_observation_space.spaces.get(name)
            if isinstance(space, (spaces.Dict, spaces.Tuple)):
                problems += nested_mismatches(f"observation '{name}'", value, space, self.num_envs)
                continue
            if not isinstance(value, torch.Tensor):
                hint = ", from _get_states, as state_space is not 0" if name == "critic" else ""
                problems.append(f"observation '{name}': is {type(value).__name__}, must be a tensor{hint}")
                continue
            shape = tuple(value.shape[1:])
            field = {"policy": "observation_space", "critic": "state_space"}.get(name, "observation_space")
            if value.shape[0] != self.num_envs:
                problems.append(
                    f"observation '{name}': leads with {value.shape[0]}, must lead with num_envs {self.num_envs}"
                )
            elif space is None:
                box = spaces.Box(-np.inf, np.inf, shape, np.float32)
                self.single_observation_space = spaces.Dict({**self.single_observation_space.spaces, name: box})
            elif space.shape != shape:
                problems.append(f"{field}: is {space.shape} but the group '{name}' has {shape}; make them agree")
        if problems:
            raise ConfigError(problems)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._checked = True
