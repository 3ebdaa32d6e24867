# SPDX-License-Identifier: Apache-2.0
"""What all environments have in common: construction, the step, the interface of gymnasium, saved state."""

from __future__ import annotations

import math
import random
from functools import partial
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
from stripe_newton.fusion import Captured, Item, Plan, Stage
from stripe_newton.managers import ManagerContext
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import Simulation

from .outputs import OutputBlock
from .rl_env_cfg import RLEnvCfg
from .safety import Safety

__all__ = ["Observations", "RLEnv"]

Observations = dict[str, Any]


class RLEnv(VectorEnv):
    """A simulation, a scene, and a step that is a list of stages; :class:`DirectRLEnv` and
    :class:`ManagerBasedRLEnv` say what the stages are.

    It is a :class:`gymnasium.vector.VectorEnv` of torch tensors that resets within the step (``SAME_STEP``).

    Attributes:
        cfg: The config.
        sim: The simulation.
        scene: The scene.
        context: Arrays and names that kernels share.
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

    cfg: RLEnvCfg

    def __init__(self, cfg: RLEnvCfg, render_mode: str | None = None, **kwargs: Any):
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
        self.sim.decimation = self.cfg.decimation
        self._prepare_simulation()
        self.scene = InteractiveScene(self.cfg.scene, self.sim)
        with self.scene.construction():
            self._setup_scene()
        self.scene.build()
        self._make_buffers()
        self._renderer: Any = None

    def _prepare_simulation(self) -> None:
        """What the simulation must know before it is built."""

    def _setup_scene(self) -> None:
        """Create what the scene config does not; called while the scene is under construction."""

    def _num_terminations(self) -> int:
        return 0

    def _make_buffers(self) -> None:
        self.outputs = OutputBlock(self.num_envs, self.device)
        self.context = context = ManagerContext(
            self.scene,
            step_dt=self.step_dt,
            decimation=self.cfg.decimation,
            max_episode_length_s=self.max_episode_length_s,
            max_episode_length=self.max_episode_length,
            num_terminations=self._num_terminations(),
            owner=self,
            reserve=self.outputs.reserve,
        )
        context.seed(getattr(self, "_np_random_seed", None) or int(torch.randint(2**31, ()).item()))
        self._safety = Safety(self.sim, context)
        self._episode_length_buf = wp.to_torch(context.episode.length)
        self.reset_terminated = wp.to_torch(context.episode.terminated)
        self.reset_time_outs = wp.to_torch(context.episode.truncated)
        self.reset_buf = wp.to_torch(context.reset)
        self.reset_buf[:] = True
        self.reward_buf = wp.to_torch(context.reward)
        self._stepping = wp.to_torch(context.stepping)
        self.obs_buf: Observations = {}
        self.extras: dict[str, Any] = {"log": {}}
        self.common_step_counter = 0
        self._plan: Plan | None = None
        self._recaptures = 0
        self._stepping_now = True

    def _set_spaces(self, observations: dict[str, Any], action: Any) -> None:
        self.single_observation_space = spaces.Dict(observations)
        self.single_action_space = action
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(action, self.num_envs)

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
        if hasattr(self, "context"):
            self.context.seed(seed)
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
        self.reset_buf[:] = True if mask is None else torch.as_tensor(mask, dtype=torch.bool, device=self.device)
        self._begin_extras()
        self._safety.begin(self.reset_buf)
        self._stepping.zero_()
        self._stepping_now = False
        self.plan.run_without_graph(self._reset_stages)
        self.sim.pending = self._bodies_later
        self._stepping.fill_(1)
        self.context.log.clear()
        self.obs_buf = self._hand_out(self.outputs.take())
        self._stepping_now = True
        self.extras["log"] = _own(self.extras.get("log") or {})
        return self.obs_buf, self.extras

    _bodies_later = False
    """Whether forward kinematics after a reset waits until somebody reads the bodies."""

    _reset_stages: ClassVar[tuple[str, ...]] = ("reset", "forward kinematics", "sensors", "observations")

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
            ValueError: if the shape of the actions does not fit, or they are not finite and the config says to raise.
            RuntimeError: if contacts or constraints were dropped, naming the size to set.
        """
        self._take_action(self._checked_action(action))
        self._begin_extras()
        plan, count = self.plan, self.common_step_counter
        self.sim.begin_step()
        if self.sim.recaptures != self._recaptures:
            self._recaptures = self.sim.recaptures
            plan.recapture()
        plan.run()
        self.sim.pending = self._bodies_later
        self.common_step_counter = count + 1
        if self.cfg.nonfinite_actions == "raise":
            self._safety.raise_for_actions()
        values = self.outputs.take()
        self.obs_buf = self._hand_out(values)
        log = self.extras.get("log")
        self.extras["log"] = _own(log) if log else {}
        keys = self.context.log.keys
        if keys:
            self.extras["log"] |= dict(zip(keys, values["log"][: len(keys)].unbind(), strict=True))
        return self.obs_buf, self._rewards(values), values["terminated"], values["truncated"], self.extras

    @property
    def plan(self) -> Plan:
        """The step as stages."""
        if self._plan is None:
            stages = self._stages()
            if self.context.problems:
                raise ConfigError(self.context.problems)
            graph = self.cfg.sim.use_cuda_graph
            self._plan = Plan("step", stages, self.context.scope, self.num_envs, self.device, graph)
        return self._plan

    def _stages(self) -> list[Stage]:
        raise NotImplementedError

    def _measure(self, when: str) -> list[Item]:
        """The items of the sensors that launch something at a time, such as ``"launch_measured"``."""
        items: list[Item] = []
        for name, sensor in self.scene.sensors.items():
            if when in sensor.measures:
                launch = getattr(sensor, when)
                items.append(Captured(name, partial(launch, self.context.reset) if when == "launch_reset" else launch))
        return items

    def _take_action(self, action: torch.Tensor) -> None:
        """Put the actions where the first stage finds them."""
        raise NotImplementedError

    def _hand_out(self, values: dict[str, torch.Tensor]) -> Observations:
        """Observations by group, from what the step wrote."""
        raise NotImplementedError

    def _rewards(self, values: dict[str, torch.Tensor]) -> torch.Tensor:
        return values["reward"]

    def _begin_extras(self) -> None:
        self.extras = {k: v for k, v in self.extras.items() if k not in ("final_obs", "_final_obs")}
        self.extras["log"] = {}

    def _checked_action(self, action: Any) -> torch.Tensor:
        action = torch.as_tensor(action, device=self.device)
        expected = self.action_space.shape
        if expected is not None and tuple(action.shape) != tuple(expected):
            raise ValueError(f"actions have shape {tuple(action.shape)}, expected {tuple(expected)}")
        if self.device == "cpu" and self.cfg.nonfinite_actions == "raise" and action.is_floating_point():
            bad = ~torch.isfinite(action).flatten(1).all(dim=1)
            if bad.any():
                where = ", ".join(map(str, bad.nonzero().flatten()[:5].tolist()))
                raise ValueError(
                    f"actions of {int(bad.sum())} environments are not finite (environments {where}); look at the "
                    "policy, or set nonfinite_actions='clamp'"
                )
        return action

    @property
    def nonfinite_worlds(self) -> int:
        """How often a world became non-finite and was reset, as far as the device has told."""
        return self._safety.worlds

    def describe(self, kernels: bool = False) -> str:
        """The stages of a step, what runs in each, and what of it is one CUDA graph, as a table in plain text.

        Args:
            kernels: Also the source of the generated kernels.
        """
        return self.plan.describe(kernels)

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

    def regenerate(self, seed: int) -> None:
        """Go on in another scene of the same specification; episodes are cut and begin anew.

        Model, solver and captured graphs stay. What a fresh environment of that scene's seed computes, this one does.
        ``obs_buf`` has the first observations. Levels of a terrain curriculum stay.

        Args:
            seed: Seed of the scene.

        Raises:
            ValueError: if the scene is of no specification, or something in it cannot follow; nothing has changed then.
        """
        self._move_to_scene(seed)
        self.reset()

    @torch.inference_mode(False)
    @torch.no_grad()
    def _move_to_scene(self, seed: int) -> None:
        self.scene.regenerate(seed)
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    # -- continuing where it stopped

    def get_state(self) -> dict[str, Any]:
        """All that the next step depends on: joints, targets, the solver's warm start, counters, and every tensor that
        the subclass keeps as an attribute. :meth:`set_state` brings it back."""
        moved = self.scene.scenery_seed != self.scene.first_scenery_seed
        return ({"scenery_seed": self.scene.scenery_seed} if moved else {}) | {
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
        seed = state.get("scenery_seed", self.scene.first_scenery_seed)
        if seed is not None and seed != self.scene.scenery_seed:
            self._move_to_scene(seed)
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
        """What is remembered elsewhere, as the dicts it is kept in."""
        return []

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
        found |= {f"context.{k}": v for k, v in self.context.arrays.items()}
        return {k: v for k, v in found.items() if v is not None and v.size}

    def _buffers(self) -> dict[str, torch.Tensor]:
        """Tensors kept as attributes, but those that share memory with the simulation."""
        shared = {wp.to_torch(a).untyped_storage().data_ptr() for a in self._arrays().values()}
        shared |= {wp.to_torch(a).untyped_storage().data_ptr() for a in (self.sim.state.body_q, self.sim.state.body_qd)}
        mine = {k: v for k, v in vars(self).items() if isinstance(v, torch.Tensor)}
        return {k: v for k, v in mine.items() if v.untyped_storage().data_ptr() not in shared}


def _own(values: dict[str, Any]) -> dict[str, Any]:
    """A copy of a dict with its tensors."""
    return {k: v.clone() if isinstance(v, torch.Tensor) else v for k, v in values.items()}
