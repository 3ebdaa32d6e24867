# SPDX-License-Identifier: Apache-2.0
"""Environments made of terms."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import torch
import warp as wp
from gymnasium import spaces

from stripe_newton.configclass import ConfigError, is_config
from stripe_newton.fusion import Captured, Item, Plan, Section, Stage, fields_read, fuse
from stripe_newton.managers import (
    ActionManager,
    CommandManager,
    CurriculumManager,
    EventManager,
    ManagerBase,
    MetricsManager,
    ObjectManager,
    ObservationManager,
    RecorderManager,
    RewardManager,
    TerminationManager,
    prestartup_events,
    spawn_object_pools,
)

from .manager_based_rl_env_cfg import ManagerBasedRLEnvCfg
from .rl_env import Observations, RLEnv

__all__ = ["ManagerBasedRLEnv"]

_NEEDS = {"body_acc": "body_qdd", "body_parent_wrench": "body_parent_f"}
"""What the solver must report for terms that read these fields."""
_FIELDS = "observations", "rewards", "terminations", "events", "curriculum", "metrics", "commands", "actions"
_STEPPING = "stepping[0] != 0"


class ManagerBasedRLEnv(RLEnv):
    """An environment whose config says what it consists of: managers made of terms.

    Terms are Warp functions; each manager is generated source, neighbouring ones become one kernel, and a step is one
    CUDA graph. A torch term runs eagerly between graphs; :meth:`describe` says which. A step runs in this order:
    actions, physics, terminations, rewards, metrics, then for environments that ended curriculum, log and reset,
    then interval events, forward kinematics, commands, observations.

    Attributes:
        action_manager, observation_manager, reward_manager, termination_manager, event_manager, command_manager,
        curriculum_manager, object_manager, metrics_manager, recorder_manager: The managers.
    """

    cfg: ManagerBasedRLEnvCfg

    def __init__(self, cfg: ManagerBasedRLEnvCfg, render_mode: str | None = None, **kwargs: Any):
        super().__init__(cfg, render_mode, **kwargs)
        cfg, context = self.cfg, self.context
        self._prestartup()
        self.object_manager = ObjectManager(cfg.objects, context)
        self.action_manager = ActionManager(cfg.actions, context)
        self.command_manager = CommandManager(cfg.commands, context)
        self.termination_manager = TerminationManager(cfg.terminations, context)
        self.reward_manager = RewardManager(cfg.rewards, context, cfg.scale_rewards_by_dt)
        self.metrics_manager = MetricsManager(cfg.metrics, context)
        self.observation_manager = ObservationManager(cfg.observations, context, self._reserve_observations)
        self.curriculum_manager = CurriculumManager(cfg.curriculum, context)
        self.recorder_manager = RecorderManager(cfg.recorders, context)
        stages = self._stages()
        if "policy" not in self.observation_manager.buffers:
            context.problems.append("observations: has no group 'policy'; the learner needs it")
        if context.problems:
            raise ConfigError(context.problems)
        self._plan = Plan("step", stages, context.scope, self.num_envs, self.device, cfg.sim.use_cuda_graph)
        self._make_spaces()
        self._startup()

    # -- construction

    def _terms(self, *names: str) -> Iterator[Any]:
        """Functions of all terms in some fields of the config."""
        todo: list[Any] = [getattr(self.cfg, n) for n in names]
        while todo:
            cfg = todo.pop()
            for value in cfg.values() if isinstance(cfg, dict) else vars(cfg).values() if is_config(cfg) else ():
                if isinstance(value, wp.Function):
                    yield value
                elif isinstance(value, dict) or is_config(value):
                    todo.append(value)

    def _terms_after_reset(self) -> list[Any]:
        own = list(self._terms("observations", "commands", "curriculum"))
        known = [v for t in self.command_manager.functions() for v in t if v is not None]
        return [*own, *known]

    def _prepare_simulation(self) -> None:
        self._read = set[str]().union(*(fields_read(f) for f in self._terms(*_FIELDS)))
        wanted = [_NEEDS[name] for name in _NEEDS if name in self._read]
        self.sim.cfg.observables = tuple(dict.fromkeys([*self.sim.cfg.observables, *wanted]))

    def _setup_scene(self) -> None:
        spawn_object_pools(self.cfg.objects, self.scene)
        for item in prestartup_events(self.cfg.events, self):
            item.function()
        self.scene.clone_environments()

    def _num_terminations(self) -> int:
        cfg = self.cfg.terminations
        names = cfg if isinstance(cfg, dict) else getattr(cfg, "__dataclass_fields__", {})
        return len(names)

    def _prestartup(self) -> None:
        if "external_wrench" in self._read:
            self.sim.enable_external_wrench()
        self.event_manager = EventManager(self.cfg.events, self.context)

    def _reserve_observations(self, name: str, size: int) -> wp.array:
        shape = self.num_envs, size
        array = self.outputs.reserve(f"obs.{name}", wp.float32, shape)
        self.context.arrays[f"obs.{name}"] = array
        if self.cfg.compute_final_obs:
            self.outputs.reserve(f"final.{name}", wp.float32, shape)
        return array

    def _make_spaces(self) -> None:
        def box(*shape: int) -> spaces.Box:
            return spaces.Box(-np.inf, np.inf, shape, np.float32)

        groups, manager = {}, self.observation_manager
        for name, buffer in manager.buffers.items():
            if isinstance(buffer, dict):
                groups[name] = spaces.Dict({k: box(*manager.shape(name, k)) for k in buffer})
            else:
                groups[name] = box(*manager.shape(name))
        self._set_spaces(groups, box(self.action_manager.total_action_dim))
        self._action_input = wp.to_torch(self.action_manager.input)

    def _startup(self) -> None:
        items = self.event_manager.startup()
        if items:
            context = self.context
            plan = Plan("startup", [Stage("startup", items)], context.scope, self.num_envs, self.device, False)
            if context.problems:
                raise ConfigError(context.problems)
            plan.run()
            self.sim.forward()

    # -- the step

    def _stages(self) -> list[Stage]:
        safety, record = self._safety, self.recorder_manager
        self._bodies_later = not self._reads_bodies()
        process = self.action_manager.process()
        parts = int(any(isinstance(i, Section) and i.parts for i in process))
        count = Section("count", ["if env == 0:", "    step[0] = step[0] + wp.int64(1)"], parts=parts)
        outcome = [safety.after_physics(), *self.termination_manager.compute()]
        rewards = [*self.reward_manager.compute(), *self.metrics_manager.compute()]
        curriculum = _when(self.curriculum_manager.compute(), f"{_STEPPING} and not nonfinite[env]")
        reset: list[Item] = [
            *self.reward_manager.reset(),
            *self.metrics_manager.reset(),
            safety.begin_reset(),
            *self.event_manager.reset(),
            *self.object_manager.reset(),
            *self.action_manager.reset(),
            *self.command_manager.reset(),
            *self.observation_manager.reset(),
            safety.end_reset(),
        ]
        events = [*self.event_manager.interval(), *self.event_manager.step()]
        commands = self.command_manager.compute()
        observe = self.observation_manager.compute()
        final = self._final_observations()
        measured = self._measure("launch_measured")
        end: list[Item] = [*self.curriculum_manager.update(), Captured("log", self.context.log.finish, beside=True)]
        return [
            Stage("actions", [count, *process, *record.pre_step()]),
            Stage("physics", [self._physics()]),
            *([Stage("measurements", measured)] if measured else []),
            Stage("outcome", _when(outcome, _STEPPING)),
            Stage("rewards", [*_when(rewards, _STEPPING), *record.post_step()]),
            Stage("episode log", [*final, *curriculum, *_when(self.termination_manager.reset(), _STEPPING)]),
            Stage("reset", [*record.pre_reset(), *reset, *self._measure("launch_reset")]),
            Stage("events", _when(events, _STEPPING)),
            Stage("objects", _when(self.object_manager.update(), _STEPPING)),
            Stage("forward kinematics", [*safety.forward(later=self._bodies_later), *record.post_reset()]),
            Stage("commands", _when(commands, _STEPPING)),
            Stage("log", end),
            Stage("sensors", self._measure("launch_observed")),
            Stage("observations", _when(observe, f"({_STEPPING} or reset[env])")),
        ]

    def _reads_bodies(self) -> bool:
        """Whether anything reads bodies between the reset and the end of the next physics step."""
        sim, read = self.sim, set[str]().union(*(fields_read(f) for f in self._terms_after_reset()))
        fixed = not all(a.layout.floating for a in self.scene.articulations.values())
        return (
            bool(read & {"body_pose", "body_vel", *(("root_pose", "root_vel") if fixed else ())})
            or not (sim.cfg.solver.finds_contacts and sim.cfg.solver.reduced_coordinates and sim.cfg.solver.in_place)
            or sim.external_wrench is not None
            or bool(self.action_manager.apply())
            or bool(self._measure("launch_observed"))
            or bool(self.recorder_manager.active_terms)
        )

    def _physics(self) -> Captured:
        steps, sim = self.cfg.decimation, self.sim
        what = f"{type(sim.solver).__name__}, {steps} physics steps"
        apply = [i for i in self.action_manager.apply() if isinstance(i, Section)]
        if not apply:
            return Captured(what, lambda: sim.launch(steps))
        kernel = fuse("step_apply", apply, self.context.scope, self.num_envs, self.device)
        names = ", ".join(t for section in apply for t in section.terms)
        return Captured(f"{what}, before each: {names}", lambda: sim.launch(steps, kernel.launch))

    def _final_observations(self) -> list[Item]:
        if not self.cfg.compute_final_obs:
            return []
        compute = self.observation_manager.compute(where_reset=True)
        copies, scope = [], self.context.scope
        for name, buffer in self.observation_manager.flat_buffers().items():
            source = scope.name(f"obs_{name}", buffer)
            target = scope.name(f"final_{name}", self.outputs.array(f"final.{name}"))
            copies += [f"for i in range({target}.shape[1]):", f"    {target}[env, i] = {source}[env, i]"]
        return _when([*compute, Section("final_observations", copies, where_reset=True)], _STEPPING)

    def _take_action(self, action: torch.Tensor) -> None:
        self._action_input.copy_(action)

    def _hand_out(self, values: dict[str, torch.Tensor]) -> Observations:
        groups = self._groups(values, "obs")
        if self.cfg.compute_final_obs and bool(self._stepping_now):
            self.extras["final_obs"] = self._groups(values, "final")
            self.extras["_final_obs"] = values["terminated"] | values["truncated"]
        return groups

    def _groups(self, values: dict[str, torch.Tensor], prefix: str) -> Observations:
        groups: Observations = {}
        manager = self.observation_manager
        for name, buffer in manager.buffers.items():
            if isinstance(buffer, dict):
                groups[name] = {k: values[f"{prefix}.{name}.{k}"].view(-1, *manager.shape(name, k)) for k in buffer}
            else:
                groups[name] = values[f"{prefix}.{name}"].view(-1, *manager.shape(name))
        return groups

    # -- what users ask for

    @property
    def managers(self) -> list[ManagerBase]:
        """All managers that have terms."""
        every = [v for v in vars(self).values() if isinstance(v, ManagerBase)]
        return [m for m in every if m.active_terms]

    @property
    def actions(self) -> torch.Tensor:
        """Actions of the last step, shape ``(num_envs, total_action_dim)``."""
        return self.action_manager.action

    @property
    def processed_actions(self) -> torch.Tensor:
        """What the action terms made of them, shape ``(num_envs, n)``."""
        return self.action_manager.processed_actions

    def describe(self, kernels: bool = False) -> str:
        """The managers with their terms, the stages of a step, and what of it is one CUDA graph, in plain text.

        Args:
            kernels: Also the source of the generated kernels.
        """
        return "\n\n".join([*map(str, self.managers), super().describe(kernels)])

    def set_state(self, state: dict[str, Any]) -> None:
        """See :meth:`RLEnv.set_state`; what was recorded of the episodes under way is dropped."""
        super().set_state(state)
        self.recorder_manager.clear()

    def close_extras(self, **kwargs: Any) -> None:
        """Release the recorder's file, renderer and simulation."""
        if hasattr(self, "recorder_manager"):
            self.recorder_manager.close()
        super().close_extras(**kwargs)


def _when(items: Iterable[Item], condition: str) -> list[Item]:
    """The items, whose sections run only under a condition."""
    out = list(items)
    for item in out:
        if isinstance(item, Section):
            item.condition = condition
    return out
