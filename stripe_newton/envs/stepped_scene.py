# SPDX-License-Identifier: Apache-2.0
"""Stepped scene: a simulation, a scene and a step that is a list of stages, without the interface of gymnasium."""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, ClassVar, NoReturn, SupportsIndex

import numpy as np
import torch
import warp as wp
from gymnasium.utils import seeding
from typing_extensions import Self

from stripe_newton.call_checks import (
    check_finite_actions,
    check_state,
    checked_function,
    checked_lengths,
    checked_mask,
    checked_seed,
    reset_mask_of,
    to_tensor,
)
from stripe_newton.configclass import ConfigError, check_types, is_config
from stripe_newton.fusion import Plan, Stage
from stripe_newton.managers import ManagerContext, TermEvaluation
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import Simulation, SimulationCfg
from stripe_newton.value_types import short

from .env_pictures import EnvPictures
from .env_state import EnvState, restore_state, save_state
from .output_block import OutputBlock
from .rl_env_cfg import RLEnvCfg
from .safety import Safety
from .single_caller import SingleCaller
from .without_gradients import without_gradients

if TYPE_CHECKING:
    from stripe_newton.viewers import SceneRenderer

__all__ = ["RENDER_MODES", "Extras", "Observations", "ResetOptions", "SteppedScene"]

Observations = dict[str, Any]
"""Observations by group; a dict by term in the place of a tensor where a group's terms are not concatenated."""
Extras = dict[str, Any]
"""Extras of a reset or step, gymnasium's ``infos``; ``"log"`` is a dict of numbers."""
ResetOptions = Mapping[str, object]
"""Options of a reset; see :meth:`SteppedScene.reset`."""
RENDER_MODES = (None, "rgb_array")
"""Render modes of all environments."""
_STEP_METHODS = (
    "step", "begin_step", "launch_step", "finish_step", "_take_action", "_collect_observations", "_rewards",
    "_begin_extras",
)  # fmt: skip
"""Methods that do not run when a recorded step is replayed. A subclass that overrides one cannot be recorded."""


class SteppedScene:
    """Simulation, scene, and a step that is a list of stages: the part of environments that needs no gymnasium.

    Subclasses define the stages. Environments that end are reset within the step.

    Attributes:
        cfg: The config.
        sim: The simulation.
        scene: The scene.
        context: Arrays and names that kernels share.
        common_step_counter: Environment steps taken.
        reset_buf: Environments that ended in the last step, bool, shape ``(num_envs,)``.
        reset_terminated: Environments that ended in failure or success, bool, shape ``(num_envs,)``.
        reset_time_outs: Environments that ran out of time, bool, shape ``(num_envs,)``.
        extras: Extras of the last reset or step; ``extras["log"]`` is a new dict in every step.
    """

    scene_class: ClassVar[type[InteractiveScene]] = InteractiveScene
    """Class of the scene."""
    simulation_class: ClassVar[Callable[[SimulationCfg], Simulation]] = Simulation
    """Class of the simulation, or a function that makes one."""

    cfg: RLEnvCfg
    closed: bool = False
    """Whether :meth:`close` was called."""
    _pictures: EnvPictures | None = None
    _np_random: np.random.Generator | None = None
    _np_random_seed: int | None = None

    def __init_subclass__(cls, **kwargs: object):
        """Let constructors make tensors that can be written anywhere, wherever an environment is made."""
        super().__init_subclass__(**kwargs)
        if "__init__" in vars(cls):
            setattr(cls, "__init__", torch.inference_mode(False)(cls.__init__))  # noqa: B010  (a method, to mypy)

    @torch.inference_mode(False)
    def __init__(self, cfg: RLEnvCfg, render_mode: str | None = None, **kwargs: object):
        """Build scene and simulation.

        Args:
            cfg: The config; it is copied.
            render_mode: ``"rgb_array"`` for :meth:`render` to return pictures.
            kwargs: Not used; a subclass may have arguments of its own, and unknown ones are an error.

        Raises:
            ConfigError: all problems of the config at once.
            TypeError: for an unknown argument.
        """
        if kwargs:
            raise TypeError(f"{type(self).__name__} got unexpected arguments: {', '.join(kwargs)}")
        if render_mode is not None and (not isinstance(render_mode, str) or render_mode not in RENDER_MODES):
            raise ValueError(f"render_mode: is {short(render_mode)}, must be None or 'rgb_array'")
        self.cfg = _completed(cfg, type(self).__name__)
        self.render_mode = render_mode
        self._single_caller = SingleCaller(type(self).__name__)
        if self.cfg.seed is not None:
            self._seed_host(self.cfg.seed)  # before the scene, as hooks draw from torch and NumPy while they make it
        self.sim = type(self).simulation_class(self.cfg.sim)
        self.sim.decimation = self.cfg.decimation
        self._prepare_simulation()
        self.scene = self.scene_class(self.cfg.scene, self.sim)
        with self.scene.construction():
            self._setup_scene()
        self.scene.builder.checks.append(self._name_problems)
        self.scene.build()
        self._make_buffers()

    def _prepare_simulation(self) -> None:
        """Set options of the simulation that must be known before the model is built. The default sets none."""

    def _name_problems(self) -> Iterable[str]:
        """Names in the config that the scene does not have, asked before the model is made; here none."""
        return ()

    def _setup_scene(self) -> None:
        """Create assets that the scene config does not name; called while the scene is under construction."""

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
        # The tolerance: 0.3 s are three steps of 0.1 s, however the quotient is rounded.
        return max(1, math.ceil(self.max_episode_length_s / self.step_dt - 1.0e-9))

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps since the last reset, int64, shape ``(num_envs,)``; assigning copies into the same memory."""
        return self._episode_length_buf

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        self._episode_length_buf.copy_(checked_lengths(value, self.num_envs, self.device))

    # -- reset and step

    def seed(self, seed: int | None = None) -> int:
        """Seed Python's, NumPy's and torch's random numbers; ``None`` draws a seed. Returns the seed.

        Raises:
            ValueError: if the seed is no whole number from 0 to 2**63 - 1.
        """
        seed = int(np.random.default_rng().integers(2**31)) if seed is None else checked_seed(seed)
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

    @without_gradients
    def reset(self, *, seed: int | None = None, options: ResetOptions | None = None) -> tuple[Observations, Extras]:
        """Begin new episodes.

        Args:
            seed: Seeds the random numbers first.
            options: ``{"reset_mask": mask}`` resets only those environments; bool, shape ``(num_envs,)``.

        Returns:
            Observations by group, and extras.

        Raises:
            ValueError: for a wrong seed, other options, or a mask of another type or shape, such as indices.
            RuntimeError: if the environment is closed.
        """
        self._check_open()
        given = reset_mask_of(options)
        mask = None if given is None else checked_mask(given, self.num_envs, self.device)
        if seed is not None:
            self.seed(seed)
        self._begin_extras()
        self._steps_before = self.common_step_counter - 1  # a reset is no step: count_step() does nothing within it
        # The mask stands where a step's terminations would have written it, so that the reset below is a step's.
        self.context.reset_mask.begin_step()
        self.reset_buf[:] = True if mask is None else mask
        self._safety.begin_reset_from_outside()
        # Only the stages that begin an episode run. A fused kernel may also hold sections of the stages beside them;
        # sections that belong to a step alone are guarded by this flag.
        self._stepping.zero_()
        self.plan.compile_ahead()  # of all stages, as the first step follows
        self.plan.run_without_graph(self._reset_stages)
        self._stepping.fill_(1)
        self._defer_body_update()
        self.context.log.clear()  # episodes that a caller cuts off are not logged: they say nothing of the policy
        self.obs_buf = self._collect_observations(self.outputs.take())
        self.extras["log"] = _cloned(self.extras.get("log") or {})
        return self.obs_buf, self.extras

    _reset_stages: ClassVar[tuple[str, ...]] = ("reset", "forward kinematics", "sensors", "observations")

    @without_gradients
    def step(self, action: torch.Tensor) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
        """Advance all environments by ``step_dt``; those that end are reset within the step.

        Args:
            action: Shape ``(num_envs, *action_shape)``.

        Returns:
            Observations by group (of the new episode where one began), rewards float ``(num_envs,)``, terminated and
            truncated bool ``(num_envs,)``, and extras. All are new tensors.

        Raises:
            ValueError: if the shape of the actions does not fit, or they are not finite and the config says to raise.
            RuntimeError: if contacts or constraints were dropped, naming the size to set; if the environment is
                closed; or if it is called within another step, by a second thread or by a hook.
        """
        self._check_open()
        with self._single_caller:
            action = self._checked_action(action)
            # On the host, before anything is launched: overflows that the device has reported, replaced arrays.
            self.begin_step()
            # The actions are copied into memory that the graphs read, as a graph cannot read the caller's tensor.
            self._take_action(action)
            # All stages, in the order of _stages(): physics, terminations and rewards of the episodes under way,
            # resets, then commands, sensors and observations, which see the new episodes.
            self.plan.run(self._replays())
            # The results are copied out, as the next step overwrites the memory that they stand in.
            return self.finish_step()

    # -- the parts of a step: step() runs them, and so does a user who records the step in a CUDA graph (GraphStep)

    def _check_open(self) -> None:
        """Raise if the environment is closed: its model and solver are gone."""
        if self.closed:
            raise RuntimeError(f"{type(self).__name__}: is closed; make a new one")

    def begin_step(self) -> None:
        """Do the host's part before a step.

        Raises:
            RuntimeError: if contacts or constraints were dropped, naming the size to set.
        """
        self._check_open()
        self._begin_extras()
        self._steps_before = self.common_step_counter
        self.context.reset_mask.begin_step()
        # The solver learns here, before the physics, of floating roots that were moved by hand. If the device has
        # reported dropped contacts or constraints the run ends here, as all that was computed since is wrong.
        self.sim.begin_step()
        if self.sim.recaptures != self._recaptures:
            # An array that the graphs read has been replaced, for example by the first external force of a hook.
            self._recaptures = self.sim.recaptures
            self.plan.recapture()

    def _record_mixed(self, function: Callable[[], None]) -> Callable[[], None]:
        """Record what a function launches with torch and with Warp; returns the replay."""
        raise NotImplementedError(f"{type(self).__name__} records no torch hooks")

    def _replays(self) -> bool:
        """Whether the present step launches graphs, if there are any."""
        return True

    def settle_hooks(self) -> None:
        """Find out which torch hooks can be recorded, where that takes steps; the state is then as it was."""

    def hook_log_keys(self) -> list[str]:
        """Keys of the episode log that recorded torch hooks write."""
        return []

    def hook_log(self, launched: Sequence[Callable[[], None]]) -> dict[str, torch.Tensor]:
        """Numbers that recorded torch hooks write to the episode log, by key.

        Args:
            launched: Result of :meth:`launch_step`.
        """
        return {}

    def launch_step(self, action: torch.Tensor) -> list[Callable[[], None]]:
        """Launch all kernels of a step on the current stream, so that a caller can record them in a CUDA graph.

        Args:
            action: Shape ``(num_envs, num_actions)``.

        Returns:
            What the host does after each replay of the caller's graph.

        Raises:
            GraphCaptureError: if something in the step runs on the host; see :meth:`why_not_capturable`.
        """
        self._check_open()
        self._take_action(action)
        return self.plan.launch()

    def count_step(self) -> None:
        """Count the step under way.

        Torch hooks that run before the physics see the number of steps before this one, later hooks include it, as in
        Isaac Lab. Several places call this, whichever comes first, so it may run more than once in a step.
        """
        self.common_step_counter = self._steps_before + 1

    def raise_for_actions(self) -> None:
        """Raise if the device has reported actions that were not finite, where the config says to raise.

        Raises:
            ValueError: with their number.
        """
        if self.cfg.nonfinite_actions == "raise":
            self._safety.raise_for_actions()

    @without_gradients
    def finish_step(self) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
        """Do the host's part after a step: update :attr:`obs_buf` and :attr:`extras`, and return copies of the results.

        Returns:
            The same as :meth:`step`.

        Raises:
            ValueError: if actions were not finite and the config says to raise.
            RuntimeError: on the CPU, if contacts or constraints were dropped in this step.
        """
        self._check_open()
        self.count_step()
        self._defer_body_update()
        self.raise_for_actions()
        self.sim.end_step()
        # All results lie in one block of memory, so this is one copy.
        values = self.outputs.take()
        self.obs_buf = self._collect_observations(values)
        self.extras |= self._final_extras(values)
        self.extras["log"] = self.outputs.copies(self.extras.get("log") or {}, values) | self._log(values)
        return self.obs_buf, self._rewards(values), values["terminated"], values["truncated"], self.extras

    def why_not_capturable(self) -> str:
        """Reason why the step cannot be recorded in a caller's CUDA graph; empty if it can."""
        package = __name__.partition(".")[0]
        changed = [n for n in _STEP_METHODS if getattr(type(self), n).__module__.partition(".")[0] != package]
        if changed:
            return f"{type(self).__name__} has a {changed[0]} of its own"
        if self.plan.host_functions:
            stage, name, reason = self.plan.host_functions[0]
            return f"stage '{stage}' has {name}: {reason}"
        return "an observation group is not concatenated" if _has_dicts(self.obs_buf) else ""

    def observation_views(self) -> Observations:
        """Observations by group in the memory that every step overwrites, rather than in new tensors."""
        return self._collect_observations(self.outputs.views())

    def _defer_body_update(self) -> None:
        """Leave forward kinematics after a reset to the next reader, where nothing in the plan reads a body."""
        if self._defers_bodies:
            self.sim.defer_forward()

    _defers_bodies = False
    """Whether forward kinematics after a reset waits until the next read of a body, as no term in between reads one."""

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
            self._plan.record_mixed = self._record_mixed
        return self._plan

    # -- the parts that subclasses define

    @property
    def _action_shape(self) -> tuple[int, ...] | None:
        """Shape of the actions, ``(num_envs, ...)``; None if it is not fixed."""
        raise NotImplementedError

    def _stages(self) -> list[Stage]:
        """The step, stage by stage, in the order in which it runs."""
        raise NotImplementedError

    def _take_action(self, action: torch.Tensor) -> None:
        """Copy the actions into the memory that the first stage reads."""
        raise NotImplementedError

    def _collect_observations(self, values: dict[str, torch.Tensor]) -> Observations:
        """Observations by group, from the results of a step by name."""
        raise NotImplementedError

    def _final_extras(self, values: dict[str, torch.Tensor]) -> Extras:
        """Final observations of the episodes that ended, if the config enables them."""
        return {}

    def _rewards(self, values: dict[str, torch.Tensor]) -> torch.Tensor:
        return values["reward"]

    def _begin_extras(self) -> None:
        self.extras = {k: v for k, v in self.extras.items() if k not in ("final_obs", "_final_obs")}
        self.extras["log"] = {}

    def _checked_action(self, action: object) -> torch.Tensor:
        expected = self._action_shape
        action = to_tensor("action", action, f"a tensor of shape {expected or self.num_envs}", self.device)
        if expected is not None and tuple(action.shape) != expected:
            raise ValueError(f"actions have shape {tuple(action.shape)}, expected {tuple(expected)}")
        if self.device == "cpu" and self.cfg.nonfinite_actions == "raise" and action.is_floating_point():
            check_finite_actions(action)
        return action

    @property
    def nonfinite_worlds(self) -> int:
        """Number of worlds that became non-finite and were reset, as of the last report from the device."""
        return self._safety.worlds

    def describe(self, kernels: bool = False) -> str:
        """Describe the physics, the stages of a step, what runs in each, and what of it is one CUDA graph.

        Args:
            kernels: Also the source of the generated kernels.

        Returns:
            A line and a table, in plain text.

        Raises:
            RuntimeError: after :meth:`close`.
        """
        self._check_open()
        scenery = "" if self.scene.scenery is None else f"scenery: {self.scene.scenery.describe()}\n"
        return f"{scenery}physics: {self.sim.describe_solver()}\n\n{self.plan.describe(kernels)}"

    def render(self) -> np.ndarray | None:
        """A picture of the scene, uint8, shape ``(height, width, 3)``; ``None`` without ``render_mode="rgb_array"``.

        Newton's camera sensor ray traces it, so neither a display nor a graphics library is needed.
        """
        self._check_open()
        if self.render_mode != "rgb_array":
            return None
        if self._pictures is None:
            self._pictures = EnvPictures(self)
        return self._pictures.render()

    @property
    def renderer(self) -> SceneRenderer | None:
        """The renderer of :meth:`render`, None before its first picture."""
        return None if self._pictures is None else self._pictures.renderer

    def close(self, **kwargs: object) -> None:
        """Release renderer and simulation; a second call does nothing."""
        if not self.closed:
            self.close_extras(**kwargs)
            self.closed = True

    def __enter__(self) -> Self:
        return self

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Refuse to be copied or pickled, as for a process that is spawned: memory of a device cannot be."""
        raise TypeError(
            f"{type(self).__name__}: an environment cannot be copied or pickled; make another of its config, env.cfg, "
            "in the process that uses it"
        )

    def __exit__(self, *error: object) -> None:
        self.close()

    def close_extras(self, **kwargs: object) -> None:
        """Release renderer and simulation."""
        self._close_pictures()
        if "scene" in vars(self):  # the constructor may have failed before
            self.scene.close()

    def regenerate(self, seed: int) -> None:
        """Change to another scene of the same specification. All episodes are cut off and begin anew.

        Model, solver and captured graphs are kept, and so are the levels of a terrain curriculum. Results are those of
        a new environment with that scene's seed. ``obs_buf`` has the first observations.

        Args:
            seed: Seed of the scene.

        Raises:
            ValueError: if the scene has no specification, or a part of it cannot change; the environment is unchanged.
        """
        self._move_to_scene(seed)
        self.reset()

    @without_gradients
    def _move_to_scene(self, seed: int) -> None:
        self._check_open()
        self.scene.regenerate(checked_seed(seed))
        self._close_pictures()

    def _close_pictures(self) -> None:
        if self._pictures is not None:
            self._pictures.close()
            self._pictures = None

    # -- Warp terms from torch code

    @torch.no_grad()
    def evaluate(self, term: wp.Function, **params: object) -> torch.Tensor:
        """Value of a Warp term on the present state, for torch hooks and terms.

        Args:
            term: An observation, reward or termination term, such as ``mdp.joint_pos_rel``.
            params: Its parameters, as in the config of a term.

        Returns:
            A new tensor: ``(num_envs, size)`` for an observation, ``(num_envs,)`` for rewards and terminations.

        Raises:
            ConfigError: parameters that do not fit.
        """
        return self._evaluation.value(checked_function(term, "term"), params)

    @torch.no_grad()
    def apply_event(
        self, event: wp.Function, env_ids: Sequence[int] | torch.Tensor | None = None, **params: object
    ) -> None:
        """Run a Warp event, such as ``mdp.randomize_rigid_body_mass``, in some environments; None means all of them.

        Raises:
            ConfigError: parameters that do not fit.
        """
        self._evaluation.apply(checked_function(event, "event"), env_ids, params)

    @property
    def _evaluation(self) -> TermEvaluation:
        self._check_open()
        if self._evaluates is None:
            self._evaluates = TermEvaluation(self.context)
        return self._evaluates

    _evaluates: TermEvaluation | None = None

    # -- saving and restoring

    def get_state(self) -> EnvState:
        """State that the next step depends on; :meth:`set_state` restores it.

        It has joints, targets, the solver's warm start, counters, and every tensor that the subclass keeps as an
        attribute.
        """
        self._check_open()
        return save_state(self)

    @without_gradients
    def set_state(self, state: EnvState) -> None:
        """Restore a state of :meth:`get_state`; steps from there on repeat those that followed it.

        Raises:
            ValueError: if it is the state of another environment.
        """
        self._check_open()
        check_state(state)
        seed = state.get("scenery_seed", self.scene.first_scenery_seed)
        if isinstance(seed, int) and seed != self.scene.scenery_seed:
            self._move_to_scene(seed)
        restore_state(self, state)

    def state_parts(self) -> list[dict[str, torch.Tensor]]:
        """Parts of the state that are not attributes of the environment, as the dicts of tensors that hold them."""
        return []


def _completed(cfg: RLEnvCfg, owner: str) -> RLEnvCfg:
    """A copy of a config, completed and checked, for a class of environments."""
    if not is_config(cfg):
        given = f"the class {cfg.__name__}; call it" if isinstance(cfg, type) else short(cfg)
        raise TypeError(f"{owner}: cfg: is {given}, must be a config of the environment")
    cfg = cfg.copy()
    try:
        cfg.complete()
    except (AttributeError, TypeError):
        check_types(("cfg", cfg))  # what a value of a wrong type has led to is no help
        raise
    cfg.validate()
    return cfg


def _cloned(values: Extras) -> Extras:
    """A copy of a dict with its tensors."""
    return {k: v.clone() if isinstance(v, torch.Tensor) else v for k, v in values.items()}


def _has_dicts(observations: Observations) -> bool:
    return any(not isinstance(group, torch.Tensor) for group in observations.values())
