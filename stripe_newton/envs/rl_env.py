# SPDX-License-Identifier: Apache-2.0
"""RL environment: the base class of all environments, with the step and the interface of gymnasium."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
import torch
import warp as wp
from gymnasium import spaces
from gymnasium.utils import seeding
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from stripe_newton.configclass import ConfigError
from stripe_newton.fusion import Captured, Item, Plan, Section, Stage, code
from stripe_newton.managers import ManagerContext
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import Simulation

from .env_state import EnvState, restore_state, save_state
from .output_block import OutputBlock
from .rl_env_cfg import RLEnvCfg
from .safety import Safety

if TYPE_CHECKING:
    from stripe_newton.viewers import SceneRenderer

__all__ = ["Extras", "Observations", "RLEnv", "ResetOptions"]

Observations = dict[str, Any]
"""Observations by group; a dict by term in the place of a tensor where a group's terms are not concatenated."""
Extras = dict[str, Any]
"""What is handed out beside the observations; ``"log"`` is a dict of numbers."""
ResetOptions = Mapping[str, object]
"""Options of a reset; see :meth:`RLEnv.reset`."""
_RENDER_MODES = (None, "rgb_array")
_STEP_METHODS = (
    "step", "begin_step", "launch_step", "finish_step", "_take_action", "_collect_observations", "_rewards",
    "_begin_extras",
)  # fmt: skip
"""Methods of a step that a graph replaces: one of a user's own would not run then."""


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

    metadata: ClassVar[dict[str, object]] = {
        "render_modes": list(_RENDER_MODES),
        "autoreset_mode": AutoresetMode.SAME_STEP,
    }

    cfg: RLEnvCfg
    _renderer: SceneRenderer | None = None

    def __init__(self, cfg: RLEnvCfg, render_mode: str | None = None, **kwargs: object):
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
        if render_mode not in _RENDER_MODES:
            raise ValueError(f"render_mode '{render_mode}': must be None or 'rgb_array'")
        cfg.validate()
        self.cfg = cfg.copy()
        self.render_mode = render_mode
        if self.cfg.seed is not None:
            self._seed_host(self.cfg.seed)
        self.sim = Simulation(self.cfg.sim)
        self.sim.decimation = self.cfg.decimation
        self._prepare_simulation()
        self.scene = InteractiveScene(self.cfg.scene, self.sim)
        with self.scene.construction():
            self._setup_scene()
        self.scene.build()
        self._make_buffers()

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
        context.seed(self._np_random_seed or int(torch.randint(2**31, ()).item()))
        self._safety = Safety(self.sim, context)
        self._episode_length_buf = wp.to_torch(context.episode.length)
        self.reset_terminated = wp.to_torch(context.episode.terminated)
        self.reset_time_outs = wp.to_torch(context.episode.truncated)
        self.reset_buf = context.reset_mask.tensor
        self.reset_buf[:] = True
        self.reward_buf = wp.to_torch(context.reward)
        self._stepping = wp.to_torch(context.stepping)
        self.obs_buf: Observations = {}
        self.extras: Extras = {"log": {}}
        self.common_step_counter = 0
        self._steps_before = 0
        self._plan: Plan | None = None
        self._recaptures = 0

    def _set_spaces(self, observations: dict[str, spaces.Space], action: spaces.Space) -> None:
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
        self._seed_host(seed)
        if "context" in vars(self):  # a hook may seed while the scene is made
            self.context.seed(seed)
        return seed

    def _seed_host(self, seed: int) -> None:
        """Seed the random numbers that hooks and the scene draw on the host."""
        random.seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002  (what users' hooks draw from)
        torch.manual_seed(seed)
        self._np_random, self._np_random_seed = seeding.np_random(seed)

    @torch.inference_mode(False)  # tensors made in an inference mode could not be written outside of it
    @torch.no_grad()
    def reset(self, *, seed: int | None = None, options: ResetOptions | None = None) -> tuple[Observations, Extras]:
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
        self._begin_extras()
        self.context.reset_mask.begin_step()
        self.reset_buf[:] = True if mask is None else torch.as_tensor(mask, dtype=torch.bool, device=self.device)
        self._safety.begin_reset_from_outside()
        # The stages that begin an episode, and no others. A kernel may reach into the stages beside them: its sections
        # that are for a step alone look at the flag.
        self._stepping.zero_()
        self.plan.run_without_graph(self._reset_stages)
        self._stepping.fill_(1)
        self._leave_bodies_for_later()
        self.context.log.clear()  # episodes that were cut off from outside are not logged
        self.obs_buf = self._collect_observations(self.outputs.take())
        self.extras["log"] = _own(self.extras.get("log") or {})
        return self.obs_buf, self.extras

    _reset_stages: ClassVar[tuple[str, ...]] = ("reset", "forward kinematics", "sensors", "observations")

    @torch.inference_mode(False)
    @torch.no_grad()
    def step(self, action: torch.Tensor) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
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
        action = self._checked_action(action)
        self.begin_step()
        self._take_action(action)
        self.plan.run()
        return self.finish_step()

    # -- a step in parts: :meth:`step` runs them, and whoever records the step in a graph of their own

    def begin_step(self) -> None:
        """What the host does before a step.

        Raises:
            RuntimeError: if contacts or constraints were dropped, naming the size to set.
        """
        self._begin_extras()
        self._steps_before = self.common_step_counter
        self.context.reset_mask.begin_step()
        # Before the physics: the solver learns of roots that were moved by hand. An overflow that the device has
        # reported ends the run here, as what was computed since is wrong.
        self.sim.begin_step()
        if self.sim.recaptures != self._recaptures:
            # An array that the graphs read was replaced, say by a hook that applied the first external force.
            self._recaptures = self.sim.recaptures
            self.plan.recapture()

    def launch_step(self, action: torch.Tensor) -> None:
        """Launch all kernels of a step on the current stream, to be recorded in a graph of the caller's.

        Args:
            action: Shape ``(num_envs, num_actions)``.

        Raises:
            GraphCaptureError: if something in the step runs on the host; see :meth:`why_not_capturable`.
        """
        self._take_action(action)
        self.plan.launch()

    def count_step(self) -> None:
        """Count the step under way. Torch hooks before the physics see the steps before it, those after it this one."""
        self.common_step_counter = self._steps_before + 1

    def raise_for_actions(self) -> None:
        """Raise if the device has reported actions that were not finite, where the config says to raise.

        Raises:
            ValueError: with their number.
        """
        if self.cfg.nonfinite_actions == "raise":
            self._safety.raise_for_actions()

    @torch.inference_mode(False)
    @torch.no_grad()
    def finish_step(self) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
        """What the host does after a step: hand out what the step wrote, as :meth:`step` returns it.

        Raises:
            ValueError: if actions were not finite and the config says to raise.
        """
        self.count_step()
        self._leave_bodies_for_later()
        self.raise_for_actions()
        # One copy for all: learners keep what they are given, and the next step overwrites the outputs.
        values = self.outputs.take()
        self.obs_buf = self._collect_observations(values)
        self.extras |= self._final_extras(values)
        self.extras["log"] = _own(self.extras.get("log") or {}) | self._log(values)
        return self.obs_buf, self._rewards(values), values["terminated"], values["truncated"], self.extras

    def why_not_capturable(self) -> str:
        """Why the step cannot be a part of a graph of the caller's; empty if it can."""
        package = __name__.partition(".")[0]
        changed = [n for n in _STEP_METHODS if getattr(type(self), n).__module__.partition(".")[0] != package]
        if changed:
            return f"{type(self).__name__} has a {changed[0]} of its own"
        if self.plan.eager:
            stage, name, reason = self.plan.eager[0]
            return f"stage '{stage}' has {name}: {reason}"
        return "an observation group is not concatenated" if _has_dicts(self.obs_buf) else ""

    def observation_views(self) -> Observations:
        """Observations by group in the memory that every step overwrites, rather than in new tensors."""
        return self._collect_observations(self.outputs.views())

    def _leave_bodies_for_later(self) -> None:
        """Let whoever reads the bodies next compute them, if the step has left them as they were before the reset."""
        self.sim.pending = self._bodies_later

    _bodies_later = False
    """Whether forward kinematics after a reset waits until somebody reads the bodies."""

    def _log(self, values: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """The episode log of the step by key."""
        keys = self.context.log.keys
        return dict(zip(keys, values["log"][: len(keys)].unbind(), strict=True)) if keys else {}

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

    # -- what the kinds of environments fill

    def _stages(self) -> list[Stage]:
        """The step, stage by stage, in the order in which it runs."""
        raise NotImplementedError

    def _take_action(self, action: torch.Tensor) -> None:
        """Put the actions where the first stage finds them."""
        raise NotImplementedError

    def _collect_observations(self, values: dict[str, torch.Tensor]) -> Observations:
        """Observations by group, from what the step wrote."""
        raise NotImplementedError

    def _final_extras(self, values: dict[str, torch.Tensor]) -> Extras:
        """Final observations of the episodes that ended, where the config asks for them."""
        return {}

    def _rewards(self, values: dict[str, torch.Tensor]) -> torch.Tensor:
        return values["reward"]

    def _count_section(self, parts: int = 0) -> Section:
        """Count the environment steps, on the device: one thread for all environments."""
        count = self.context.code("    {step}[0] = {step}[0] + wp.int64(1)")
        return Section("count", [code("if env == 0:"), count], parts=parts)

    def _measure(self, when: str) -> list[Item]:
        """The launches of the sensors that measure at a time, such as ``"launch_measured"``."""
        items: list[Item] = []
        for name, sensor in self.scene.sensors.items():
            if when in sensor.measures:
                launch = getattr(sensor, when)
                items.append(Captured(name, partial(launch, self.context.reset) if when == "launch_reset" else launch))
        return items

    def _begin_extras(self) -> None:
        self.extras = {k: v for k, v in self.extras.items() if k not in ("final_obs", "_final_obs")}
        self.extras["log"] = {}

    def _checked_action(self, action: object) -> torch.Tensor:
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
        """How often a world became non-finite and was reset, as of the last report from the device."""
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
            from stripe_newton.viewers import SceneRenderer  # most environments are never drawn, and it takes a while

            self._renderer = SceneRenderer(self.sim, self.cfg.viewer)
        return self._renderer.render()

    def close_extras(self, **kwargs: object) -> None:
        """Release renderer and simulation."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if "scene" in vars(self):  # the constructor may have failed before
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

    def get_state(self) -> EnvState:
        """All that the next step depends on: joints, targets, the solver's warm start, counters, and every tensor that
        the subclass keeps as an attribute. :meth:`set_state` brings it back."""
        return save_state(self)

    @torch.inference_mode(False)
    @torch.no_grad()
    def set_state(self, state: EnvState) -> None:
        """Go on from what :meth:`get_state` returned.

        Raises:
            ValueError: if it is the state of another environment.
        """
        seed = state.get("scenery_seed", self.scene.first_scenery_seed)
        if isinstance(seed, int) and seed != self.scene.scenery_seed:
            self._move_to_scene(seed)
        restore_state(self, state)

    def state_parts(self) -> list[dict[str, torch.Tensor]]:
        """What is remembered elsewhere than in attributes, as the dicts it is kept in; they are part of the state."""
        return []


def _own(values: Extras) -> Extras:
    """A copy of a dict with its tensors."""
    return {k: v.clone() if isinstance(v, torch.Tensor) else v for k, v in values.items()}


def _has_dicts(observations: Observations) -> bool:
    return any(isinstance(group, dict) for group in observations.values())
