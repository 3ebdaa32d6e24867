# SPDX-License-Identifier: Apache-2.0
"""Stepped scene: reset and step of a built scene, as a list of stages, without the interface of gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import ClassVar

import torch

from stripe_newton.call_checks import check_finite_actions, checked_mask, reset_mask_of, to_tensor
from stripe_newton.configclass import ConfigError
from stripe_newton.fusion import Plan, Stage

from .built_scene import Extras, Observations
from .scene_access import SceneAccess
from .without_gradients import without_gradients

__all__ = ["ResetOptions", "SteppedScene"]

ResetOptions = Mapping[str, object]
"""Options of a reset; see :meth:`SteppedScene.reset`."""
_STEP_METHODS = (
    "step", "begin_step", "launch_step", "finish_step", "_take_action", "_collect_observations", "_rewards",
    "_begin_extras",
)  # fmt: skip
"""Methods that do not run when a recorded step is replayed. A subclass that overrides one cannot be recorded."""


class SteppedScene(SceneAccess):
    """A scene with a step that is a list of stages: the part of environments that needs no gymnasium.

    Subclasses define the stages. Environments that end are reset within the step. The methods in the order in which a
    step calls them: :meth:`begin_step`, then the stages by :attr:`plan`, then :meth:`finish_step`.
    """

    def _make_buffers(self) -> None:
        super()._make_buffers()
        self._plan: Plan | None = None
        self._steps_before = 0
        self._recaptures = 0

    # -- reset and step

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

    # -- the stages

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

    # -- recording: torch hooks as parts of graphs, and the step as a part of a caller's graph

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

    # -- description, and another scene

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


def _cloned(values: Extras) -> Extras:
    """A copy of a dict with its tensors."""
    return {k: v.clone() if isinstance(v, torch.Tensor) else v for k, v in values.items()}


def _has_dicts(observations: Observations) -> bool:
    return any(not isinstance(group, torch.Tensor) for group in observations.values())
