# SPDX-License-Identifier: Apache-2.0
"""Direct step: the stages of a direct environment, made of its hooks, and the memory that hooks write to."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
import warp as wp
from gymnasium import spaces
from gymnasium.vector.utils import batch_space

from stripe_newton.configclass import ConfigError
from stripe_newton.fusion import HostFunction, Item, KernelLaunches, Name, Section, Stage

from .hook_methods import HookMethods
from .hook_results import ObservationGroup, copied, leaves_of
from .rl_env import Observations
from .spaces import nested_mismatches
from .stage_items import count_section, scenery_items, sensor_items
from .warp_arrays import WarpArrays

__all__ = ["DirectStep"]


class DirectStep(HookMethods):
    """The step of a direct environment. A Warp hook is captured; a torch hook is, too, where it can be recorded."""

    warp: WarpArrays
    """Arrays of the Warp hooks."""
    _actions_name: Name
    """The name of ``warp.actions`` in generated kernels."""
    _given: list[torch.Tensor]
    """Actions of the current step. In a list, which a saved state leaves out: the tensor belongs to the caller."""

    # -- the stages

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
        # Dones and rewards see lengths of episodes and a count of steps that include this step, as in Isaac Lab.
        items: list[Item] = [count_section(context).only(context.within_step), self._safety.after_physics()]
        items.append(
            self._hooks.dones.item(
                self._launch_dones,
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
        own = type(self)._interval_events is not HookMethods._interval_events
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
        # Noise models are torch modules: a graph can hold them only as part of recorded torch hooks.
        runs_noise = not self._hooks.pre_physics.is_warp and not self._hooks.observations.is_warp
        if self._noise_models() and not (self._recorder is not None and runs_noise):
            return "noise models are torch modules"
        reason = super().why_not_capturable()
        if not reason and self._recorder is not None and self._apply_part is not None and self._substeps.mode == "auto":
            return "apply_action is 'auto', which watches some steps: set 'step' or 'substep'"
        return reason

    def state_parts(self) -> list[dict[str, torch.Tensor]]:
        """State of the noise models and of the clocks of events, as the dicts in which they keep it."""
        models = [m.__dict__ for m in self._noise_models()]
        return [*models, *(self._events.clocks() if self._events is not None else [])]

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
