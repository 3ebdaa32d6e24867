# SPDX-License-Identifier: Apache-2.0
"""Environments in the direct workflow: subclass, fill the hooks."""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from typing import Any, ClassVar

import newton
import numpy as np
import torch
import warp as wp
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from stripe_newton.configclass import ConfigError
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import Simulation

from .direct_rl_env_cfg import DirectRLEnvCfg
from .events import EventRunner
from .spaces import to_space
from .substeps import Substeps

__all__ = ["DirectRLEnv"]

Observations = dict[str, torch.Tensor]


class DirectRLEnv(VectorEnv):
    """Base class of environments whose hooks compute observations, rewards and dones for all environments at once.

    A subclass fills the hooks below. A step runs in this order: noise on the actions, ``_pre_physics_step``, the
    physics (``decimation`` steps, ``_apply_action`` before them), episode length + 1, ``_get_dones``, ``_get_rewards``,
    ``_reset_idx`` for environments that are done, interval events, sensors, ``_get_observations``, ``_get_states``,
    noise on the observations. State is fresh wherever a hook reads it.

    It is a :class:`gymnasium.vector.VectorEnv` of torch tensors that resets within the step (``SAME_STEP``).

    Attributes:
        cfg: The config.
        sim: The simulation.
        scene: The scene.
        common_step_counter: Environment steps taken.
        reset_buf: Environments that ended in the last step, bool, shape ``(num_envs,)``.
        reset_terminated: Those that ended in failure or success, bool, shape ``(num_envs,)``.
        reset_time_outs: Those that ran out of time, bool, shape ``(num_envs,)``.
        extras: What is handed out beside the observations; ``extras["log"]`` is a new dict in every step.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "render_modes": [None, "rgb_array"],
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    cfg: DirectRLEnvCfg

    def __init__(self, cfg: DirectRLEnvCfg, render_mode: str | None = None, **kwargs: Any):
        """Build scene and simulation.

        Args:
            cfg: The config; it is copied.
            render_mode: ``"rgb_array"`` for :meth:`render` to return pictures.
            kwargs: None are known; a subclass may pass on its own.

        Raises:
            ConfigError: all problems of the config at once.
        """
        if kwargs:
            raise TypeError(f"{type(self).__name__} got unexpected arguments: {', '.join(kwargs)}")
        if render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode '{render_mode}': must be None or 'rgb_array'")
        cfg.validate()
        self.cfg = cfg.copy()
        self.render_mode = render_mode
        if self.cfg.seed is not None:
            self.seed(self.cfg.seed)
        self.sim = Simulation(self.cfg.sim)
        self.scene = InteractiveScene(self.cfg.scene, self.sim)
        with self.scene.construction():
            self._setup_scene()
        self.scene.build()
        self._make_buffers()
        self._make_spaces()
        for name in ("observation", "action"):
            noise = getattr(self.cfg, f"{name}_noise_model")
            model = noise.class_type(noise, self.num_envs, self.device) if noise is not None else None
            setattr(self, f"_{name}_noise_model", model)
        self._events = EventRunner(self.cfg.events, self) if self.cfg.events is not None else None
        self._renderer: Any = None
        self._substeps = Substeps(self.cfg.apply_action, self.cfg.decimation)
        if self._events is not None:
            self._events.startup()

    def _make_buffers(self) -> None:
        count, device = self.num_envs, self.device
        self._episode_length_buf = torch.zeros(count, dtype=torch.long, device=device)
        self.reset_terminated = torch.zeros(count, dtype=torch.bool, device=device)
        self.reset_time_outs = torch.zeros(count, dtype=torch.bool, device=device)
        self.reset_buf = torch.ones(count, dtype=torch.bool, device=device)
        self.reward_buf = torch.zeros(count, device=device)
        self.obs_buf: Observations = {}
        self.extras: dict[str, Any] = {"log": {}}
        self.common_step_counter = 0
        self._checked = False

    def _make_spaces(self) -> None:
        cfg = self.cfg
        groups = to_space(cfg.observation_space)
        named = isinstance(groups, spaces.Dict) and "policy" in groups.spaces
        own = dict(groups.spaces) if named else {"policy": groups}
        if cfg.state_space:
            own["critic"] = to_space(cfg.state_space)
        self.single_observation_space = spaces.Dict(own)
        self.single_action_space = to_space(cfg.action_space)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.state_space = self.observation_space["critic"] if cfg.state_space else None
        size = spaces.flatdim(self.single_action_space)
        self.actions = torch.zeros(self.num_envs, size, device=self.device)

    # -- properties

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return self.scene.num_envs

    @property
    def device(self) -> str:
        """Device of the simulation and of every tensor."""
        return self.sim.device

    @property
    def physics_dt(self) -> float:
        """Time step of the physics [s]."""
        return self.sim.physics_dt

    @property
    def step_dt(self) -> float:
        """Time step of the environment [s]."""
        return self.sim.physics_dt * self.cfg.decimation

    @property
    def max_episode_length_s(self) -> float:
        """Duration of an episode [s]."""
        return self.cfg.episode_length_s

    @property
    def max_episode_length(self) -> int:
        """Environment steps in an episode."""
        return math.ceil(self.max_episode_length_s / self.step_dt - 1.0e-9)

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps since the last reset, int64, shape ``(num_envs,)``; assigning copies into the same memory."""
        return self._episode_length_buf

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        self._episode_length_buf.copy_(torch.as_tensor(value, device=self.device))

    # -- gymnasium

    def seed(self, seed: int | None = None) -> int:
        """Seed Python's, NumPy's and torch's random numbers; ``None`` draws a seed. Returns the seed."""
        seed = int(np.random.default_rng().integers(2**31)) if seed is None else int(seed)
        random.seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002  (what users' hooks draw from)
        torch.manual_seed(seed)
        self._np_random, self._np_random_seed = seeding.np_random(seed)
        return seed

    @torch.inference_mode(False)  # tensors made in an inference mode could not be written outside of it
    @torch.no_grad()
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observations, dict[str, Any]]:
        """Begin new episodes.

        Args:
            seed: Seeds the random numbers first.
            options: ``{"reset_mask": mask}`` resets only those environments; bool, shape ``(num_envs,)``.

        Returns:
            Observations by group, and extras.
        """
        if seed is not None:
            self.seed(seed)
        mask = (options or {}).get("reset_mask")
        ids = torch.arange(self.num_envs, device=self.device)
        if mask is not None:
            ids = ids[torch.as_tensor(mask, dtype=torch.bool, device=self.device)]
        self.extras = {k: v for k, v in self.extras.items() if k not in ("final_obs", "_final_obs")}
        self.extras["log"] = {}
        self._reset(ids)
        self.scene.update(self.physics_dt)
        observations = self._observe()
        self.extras["log"] = _own(self.extras.get("log") or {})
        return observations, self.extras

    @torch.inference_mode(False)
    @torch.no_grad()
    def step(
        self, action: torch.Tensor
    ) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Advance all environments by ``step_dt``; those that end are reset within the step.

        Args:
            action: Shape ``(num_envs, *action_shape)``.

        Returns:
            Observations by group (of the new episode where one began), rewards float ``(num_envs,)``, terminated and
            truncated bool ``(num_envs,)``, and extras. All are new tensors.

        Raises:
            ValueError: if the shape of the actions does not fit.
        """
        action = self._checked_action(action)
        if self._action_noise_model is not None:
            action = self._action_noise_model(action)
        self.extras = {k: v for k, v in self.extras.items() if k not in ("final_obs", "_final_obs")}
        self.extras["log"] = {}
        self._pre_physics_step(action)
        self._substeps.run(self)
        self.common_step_counter += 1
        self._episode_length_buf += 1
        terminated, time_outs = self._get_dones()
        self.reset_terminated[:], self.reset_time_outs[:] = terminated, time_outs
        self.reset_buf = self.reset_terminated | self.reset_time_outs
        self.reward_buf = self._get_rewards()
        outcome = self.reward_buf.clone(), self.reset_terminated.clone(), self.reset_time_outs.clone()
        ids = self.reset_buf.nonzero().squeeze(-1)
        if len(ids):
            if self.cfg.compute_final_obs:
                self.extras["final_obs"] = self._observe()
                self.extras["_final_obs"] = self.reset_buf.clone()
            self._reset(ids)
        self._interval_events(self.step_dt)
        self.scene.update(self.step_dt)
        self.obs_buf = self._observe()
        self.extras["log"] = _own(self.extras.get("log") or {})
        return self.obs_buf, *outcome, self.extras

    def render(self) -> np.ndarray | None:
        """A picture of the scene, uint8, shape ``(height, width, 3)``; ``None`` without ``render_mode="rgb_array"``.

        It is ray traced by Newton's camera sensor: neither a display nor a graphics library is needed.
        """
        if self.render_mode != "rgb_array":
            return None
        if self._renderer is None:
            from stripe_newton.viewers import SceneRenderer

            self._renderer = SceneRenderer(self.sim, self.cfg.viewer)
        return self._renderer.render()

    def close_extras(self, **kwargs: Any) -> None:
        """Release renderer and simulation."""
        if getattr(self, "_renderer", None) is not None:
            self._renderer.close()
            self._renderer = None
        if hasattr(self, "scene"):  # the constructor may have failed before
            self.scene.close()

    def describe(self) -> str:
        """The stages of a step, what runs in each, and what of it is one CUDA graph, as a table in plain text."""
        mode, steps = self._substeps.mode, self.cfg.decimation
        graph = self.sim.device != "cpu" and self.cfg.sim.use_cuda_graph
        what = "one CUDA graph" if graph else "kernel by kernel"
        how = f"{what}, {steps} physics steps"
        if self._substeps.each:
            how = f"{steps} x {what}, _apply_action eager before each"
        noise = [n for n in ("action", "observation") if getattr(self.cfg, f"{n}_noise_model") is not None]
        rows = (
            ("actions", "_pre_physics_step" + (", noise" if "action" in noise else ""), "eager torch"),
            ("physics", f"_apply_action ({mode}), {type(self.sim.solver).__name__}", how),
            ("outcome", "_get_dones, _get_rewards", "eager torch"),
            ("reset", "_reset_idx, forward kinematics by mask", "eager torch, for environments that ended"),
            ("events", "interval events" if self._events is not None else "-", "eager torch"),
            ("sensors", ", ".join(self.scene.sensors) or "-", "eager"),
            ("observations", "_get_observations" + (", noise" if "observation" in noise else ""), "eager torch"),
        )
        widths = [max(len(row[i]) for row in rows) for i in range(2)]
        return "\n".join(f"{a:<{widths[0]}}  {b:<{widths[1]}}  {c}" for a, b, c in rows)

    # -- continuing where it stopped

    def get_state(self) -> dict[str, Any]:
        """All that the next step depends on: joints, targets, the solver's warm start, counters, and every tensor that
        the subclass keeps as an attribute. :meth:`set_state` brings it back."""
        return {
            "step": self.common_step_counter,
            "arrays": {k: wp.to_torch(v).clone() for k, v in self._arrays().items()},
            "buffers": {k: v.clone() for k, v in self._buffers().items()},
            "parts": [_own({k: v for k, v in p.items() if isinstance(v, torch.Tensor)}) for p in self._parts()],
        }

    @torch.inference_mode(False)
    @torch.no_grad()
    def set_state(self, state: dict[str, Any]) -> None:
        """Go on from what :meth:`get_state` returned.

        Raises:
            ValueError: if it is the state of another environment.
        """
        if "external_wrench" in state["arrays"]:
            self.sim.enable_external_wrench()
        dynamics = [name.removeprefix("model.") for name in state["arrays"] if name.startswith("model.")]
        for name in dynamics:
            self.scene.controller.track(name)
        arrays, buffers = self._arrays(), self._buffers()
        for name, value in state["arrays"].items():
            mine = wp.to_torch(arrays[name]) if name in arrays else None
            if mine is None or mine.shape != value.shape:
                here = tuple(mine.shape) if mine is not None else "none"
                raise ValueError(
                    f"the state has '{name}' of shape {tuple(value.shape)}, the environment {here}: "
                    "it is of another task or size"
                )
        self.common_step_counter = state["step"]
        for name, value in state["arrays"].items():
            wp.to_torch(arrays[name]).copy_(value)
        for name, value in state["buffers"].items():
            mine = buffers.get(name)
            if mine is not None and mine.shape == value.shape and mine.is_contiguous() and not mine.is_inference():
                mine.copy_(value)
            else:  # made by a hook that has not run here yet, or not to be written in place
                setattr(self, name, value.to(self.device).clone())
        for mine, part in zip(self._parts(), state["parts"]):
            mine.update({k: v.to(self.device).clone() for k, v in part.items()})
        self.sim.roots_moved = True
        if dynamics:
            self.sim.refresh_drives()
            self.sim.notify(newton.ModelFlags.ALL)
        self.sim.forward()

    def _parts(self) -> list[dict[str, Any]]:
        """What events and noise models remember, as the dicts they keep it in."""
        models = [m.__dict__ for m in (self._action_noise_model, self._observation_noise_model) if m is not None]
        return [*models, *(self._events.clocks() if self._events is not None else [])]

    def _arrays(self) -> dict[str, wp.array]:
        sim = self.sim
        found = {
            "joint_q": sim.state.joint_q,
            "joint_qd": sim.state.joint_qd,
            "previous_joint_qd": sim.previous_joint_qd,
        }
        found |= {k: getattr(sim.control, k) for k in ("joint_target_q", "joint_target_qd", "joint_act")}
        found["joint_X_p"] = sim.model.joint_X_p
        found |= {f"model.{k}": getattr(sim.model, k) for k in self.scene.controller.randomized}
        if sim.external_wrench is not None:
            found |= {"external_wrench": sim.external_wrench, "wrench_in_world": sim.wrench_in_world}
        data = getattr(sim.solver, "mjw_data", None)
        if data is not None:
            found["qacc_warmstart"] = data.qacc_warmstart
        return {k: v for k, v in found.items() if v is not None}

    def _buffers(self) -> dict[str, torch.Tensor]:
        """Tensors kept as attributes, but those that share memory with the simulation."""
        shared = {wp.to_torch(a).untyped_storage().data_ptr() for a in self._arrays().values()}
        shared |= {wp.to_torch(a).untyped_storage().data_ptr() for a in (self.sim.state.body_q, self.sim.state.body_qd)}
        mine = {k: v for k, v in vars(self).items() if isinstance(v, torch.Tensor)}
        return {k: v for k, v in mine.items() if v.untyped_storage().data_ptr() not in shared}

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
        ids = (
            torch.arange(self.num_envs, device=self.device)
            if env_ids is None
            else torch.as_tensor(env_ids, device=self.device)
        )
        self.scene.reset(ids)
        self._reset_events(ids)
        for model in (self._action_noise_model, self._observation_noise_model):
            if model is not None:
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

    # -- parts of a step

    def _reset(self, ids: torch.Tensor) -> None:
        """Reset environments and make what is derived from the joints theirs."""
        self._reset_idx(ids)
        mask = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        mask[ids] = True
        self.sim.forward(mask)

    def _observe(self) -> Observations:
        groups: dict[str, Any] = dict(self._get_observations())
        if self.cfg.state_space:
            groups["critic"] = self._get_states()
        if not self._checked:
            self._check_observations(groups)
        if self._observation_noise_model is not None:
            groups["policy"] = self._observation_noise_model(groups["policy"])
        return _own(groups)  # learners keep what they are given: nobody may overwrite it

    def _checked_action(self, action: Any) -> torch.Tensor:
        action = torch.as_tensor(action, device=self.device)
        expected = self.action_space.shape
        if expected is not None and tuple(action.shape) != tuple(expected):
            raise ValueError(f"actions have shape {tuple(action.shape)}, expected {tuple(expected)}")
        return action.float().clone() if action.is_floating_point() else action.clone()

    def _check_observations(self, groups: dict[str, Any]) -> None:
        """Compare the first observations with the spaces; groups that no space names get one."""
        problems = []
        if "policy" not in groups:
            problems.append(
                f"_get_observations: returned {', '.join(groups) or 'nothing'}, must have the group 'policy'"
            )
        for name, value in groups.items():
            space = self.single_observation_space.spaces.get(name)
            if not isinstance(value, torch.Tensor):
                problems.append(f"observation '{name}': is {type(value).__name__}, must be a tensor")
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


def _own(values: dict[str, Any]) -> dict[str, Any]:
    """A copy of a dict with its tensors."""
    return {k: v.clone() if isinstance(v, torch.Tensor) else v for k, v in values.items()}
