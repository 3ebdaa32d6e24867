# SPDX-License-Identifier: Apache-2.0
"""Manager-based RL environment: managers made from a config of terms, and a step that is one CUDA graph."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import ClassVar

import numpy as np
import torch
import warp as wp
from gymnasium import spaces

from stripe_kernels import mdp
from stripe_newton.configclass import MISSING, ConfigError, configclass, is_config
from stripe_newton.fusion import Captured, Eager, Item, Plan, Section, Stage, block, code, fuse, may_use, only, usage_of
from stripe_newton.managers import (
    ActionManager,
    CommandManager,
    CurriculumManager,
    EventManager,
    EventTermCfg,
    ManagerBase,
    MetricsManager,
    ObjectManager,
    ObservationManager,
    RecorderManager,
    RewardManager,
    TerminationManager,
    TerminationTermCfg,
    prestartup_events,
    spawn_object_pools,
)
from stripe_newton.managers.manager_base import terms_of

from .env_state import EnvState
from .name_checks import name_problems
from .rl_env import Extras, Observations, RLEnv
from .rl_env_cfg import RLEnvCfg

__all__ = ["DefaultEventsCfg", "ManagerBasedRLEnv", "ManagerBasedRLEnvCfg"]

_OBSERVABLES = {"body_acc": "body_qdd", "body_parent_wrench": "body_parent_f"}
"""Fields of articulations that the solver reports on request only, with Newton's name of the request."""
_FIELDS = "observations", "rewards", "terminations", "events", "curriculum", "metrics", "commands", "actions"
_BODY_FIELDS = frozenset({"body_pose", "body_vel"})
"""Fields that forward kinematics computes."""
_ROOT_FIELDS = frozenset({"root_pose", "root_vel"})
"""Fields that forward kinematics computes for a fixed base; those of a floating base are joint coordinates."""


@configclass
class DefaultEventsCfg:
    """Default events of a config that names none."""

    reset_scene_to_default = EventTermCfg(func=mdp.reset_scene_to_default, mode="reset")
    """Every asset begins an episode in its default state."""


@configclass
class ManagerBasedRLEnvCfg(RLEnvCfg):
    """Config of an environment made of terms. Each manager's field is a config whose fields are terms, or a dict."""

    observations: object = MISSING
    """Observation groups: :class:`ObservationGroupCfg`; ``policy`` is needed."""
    actions: object = MISSING
    """Action terms."""
    rewards: object = MISSING
    """Reward terms: :class:`RewardTermCfg`."""
    terminations: object = MISSING
    """Termination terms: :class:`TerminationTermCfg`."""
    events: object = DefaultEventsCfg()
    """Events: :class:`EventTermCfg`; by default a reset brings everything to its default state."""
    commands: object = None
    """Command terms."""
    curriculum: object = None
    """Curriculum terms: :class:`CurriculumTermCfg`."""
    objects: object = None
    """Pools of rigid objects: :class:`ObjectPoolCfg`."""
    metrics: object = None
    """Metric terms: :class:`MetricTermCfg`."""
    recorders: object = None
    """Recorder terms and the file they write to: :class:`RecorderManagerBaseCfg`."""
    scale_rewards_by_dt: bool = True
    """Multiply rewards by the environment's time step, so that weights are per second."""

    def complete(self) -> None:
        """In an imported scenery, measure the heights of falls above the storey that a robot is on."""
        if self.scene is MISSING or self.scene.scenery_file is None:
            return
        for term in terms_of(self.terminations).values():
            if isinstance(term, TerminationTermCfg) and term.func is mdp.root_height_below_minimum:
                term.func = mdp.root_height_over_ground_below_minimum

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from RLEnvCfg.problems(self)


class ManagerBasedRLEnv(RLEnv):
    """Environment whose config lists the terms of its managers.

    Terms are Warp functions. Each manager generates source code, neighbouring managers become one kernel, and a step is
    one CUDA graph. A torch term runs eagerly between graphs; :meth:`describe` lists which. A step runs in this order:
    actions, physics, terminations, rewards, metrics; for environments that ended curriculum, log and reset; then
    interval events, forward kinematics, commands, observations.

    Attributes:
        action_manager, observation_manager, reward_manager, termination_manager, event_manager, command_manager,
        curriculum_manager, object_manager, metrics_manager, recorder_manager: The managers.
    """

    cfg: ManagerBasedRLEnvCfg
    needs_policy: ClassVar[bool] = True
    """Whether there must be a group of observations for a policy."""

    def __init__(self, cfg: ManagerBasedRLEnvCfg, render_mode: str | None = None, **kwargs: object):
        super().__init__(cfg, render_mode, **kwargs)
        self._make_managers()
        stages = self._stages()
        problems = self.context.problems
        if self.needs_policy and "policy" not in self.observation_manager.buffers:
            problems.append("observations: has no group 'policy'; the learner needs it")
        if problems:
            raise ConfigError(problems)
        graph = self.cfg.sim.use_cuda_graph
        self._plan = Plan("step", stages, self.context.scope, self.num_envs, self.device, graph)
        self._make_spaces()
        self._startup()

    # -- construction

    def _make_managers(self) -> None:
        cfg, context = self.cfg, self.context
        if self._reads("external_wrench"):
            self.sim.enable_external_wrench()
        self._provide_structs()
        self.event_manager = EventManager(cfg.events, context)
        self.object_manager = ObjectManager(cfg.objects, context)
        self.action_manager = ActionManager(cfg.actions, context)
        self.command_manager = CommandManager(cfg.commands, context)
        self.termination_manager = TerminationManager(cfg.terminations, context)
        self.reward_manager = RewardManager(cfg.rewards, context, cfg.scale_rewards_by_dt)
        self.metrics_manager = MetricsManager(cfg.metrics, context)
        self.observation_manager = ObservationManager(cfg.observations, context, self._reserve_observations)
        self.curriculum_manager = CurriculumManager(cfg.curriculum, context)
        self.recorder_manager = RecorderManager(cfg.recorders, context)

    def _provide_structs(self) -> None:
        """Offer structs of a subclass to its terms, by ``self.context.provide(struct, name)``. The default offers none.

        A term then has an argument of the struct's type, and is given the struct of the name in its params.
        """

    def _terms(self) -> Iterator[wp.Function]:
        """Warp functions of all terms in the config."""
        todo: list[object] = [getattr(self.cfg, name) for name in _FIELDS]
        while todo:
            cfg = todo.pop()
            for value in cfg.values() if isinstance(cfg, dict) else vars(cfg).values() if is_config(cfg) else ():
                if isinstance(value, wp.Function):
                    yield value
                elif isinstance(value, dict) or is_config(value):
                    todo.append(value)

    def _reads(self, field: str) -> bool:
        """Whether a Warp term reads or writes a field, or cannot be known not to."""
        return any(usage_of(function).may_use([field]) for function in self._terms())

    def _prepare_simulation(self) -> None:
        wanted = [observable for field, observable in _OBSERVABLES.items() if self._reads(field)]
        self.sim.cfg.observables = tuple(dict.fromkeys([*self.sim.cfg.observables, *wanted]))

    def _name_problems(self) -> Iterator[str]:
        return name_problems({name: getattr(self.cfg, name) for name in _FIELDS}, self.scene)

    def _setup_scene(self) -> None:
        spawn_object_pools(self.cfg.objects, self.scene)
        for item in prestartup_events(self.cfg.events, self):
            item.function()
        self.scene.clone_environments()

    def _num_terminations(self) -> int:
        return len(terms_of(self.cfg.terminations))

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
        items = self.event_manager.startup_items()
        if items:
            context = self.context
            plan = Plan("startup", [Stage("startup", items)], context.scope, self.num_envs, self.device, False)
            if context.problems:
                raise ConfigError(context.problems)
            plan.run()
            self.sim.forward()

    # -- the step

    def _stages(self) -> list[Stage]:
        context, safety, record = self.context, self._safety, self.recorder_manager
        in_step = context.within_step
        apply, process = self.action_manager.apply_items(), self.action_manager.process_items()
        # Actions may be processed by one thread for each number. The count then takes part in that kernel's layout
        # (one of its threads does it), so that the two are not cut into two kernels.
        parts = int(any(isinstance(item, Section) and item.parts for item in process))
        actions = [self._count_section(parts), *process, *record.pre_step_items()]
        measured = self._measure("launch_measured")
        # Terminations and rewards read the state after the physics. Terminations come first: rewards of termination
        # read which episodes end.
        outcome = [safety.after_physics(), *self.termination_manager.compute_items()]
        rewards = [*self.reward_manager.compute_items(), *self.metrics_manager.compute_items()]
        # The curriculum reads sums and states of the episode that ended, so it runs before the reset clears them.
        curriculum = only(self.curriculum_manager.compute_items(), in_step, context.is_finite)
        reset: list[Item] = [
            *record.pre_reset_items(),
            *self.reward_manager.reset_items(),
            *self.metrics_manager.reset_items(),
            safety.begin_reset(),
            *self._scenery_items(),
            *self.event_manager.reset_items(),
            # After the events, as spawned objects keep a distance from the positions that robots are reset to.
            *self.object_manager.reset_items(),
            *self.action_manager.reset_items(),
            *self.command_manager.reset_items(),
            *self.observation_manager.reset_items(),
            # Class terms read the states that the events have set, and the length of the episode that ended.
            *self._reset_classes(),
            safety.end_reset(),
            *self._measure("launch_reset"),
        ]
        events = [*self.event_manager.interval_items(), *self.event_manager.step_items()]
        objects = self.object_manager.update_items()
        # Commands, observed sensors and observations follow forward kinematics: they read the bodies of new episodes.
        commands = only(self.command_manager.compute_items(), in_step)
        observe = only(self.observation_manager.compute_items(), context.within_step_or_reset)
        observed = self._measure("launch_observed")
        final = self._final_observations()
        # Made last, when every parameter that a curriculum may change exists. The log runs beside the rest: no kernel
        # of this step reads it.
        end = self.curriculum_manager.update_items()
        log = Captured("log", context.log.finish, beside=True, fields=frozenset())
        readers = [*record.post_reset_items(), *commands, *end, *observed, *observe, *actions, *apply]
        self._bodies_later = self._may_leave_bodies(readers)
        after_physics = [
            *([Stage("measurements", measured)] if measured else []),
            Stage("outcome", only(outcome, in_step)),
            Stage("rewards", [*only(rewards, in_step), *record.post_step_items()]),
            Stage("episode log", [*final, *curriculum, *only(self.termination_manager.reset_items(), in_step)]),
            Stage("reset", reset),
            Stage("events", only(events, in_step)),
            Stage("objects", only(objects, in_step)),
            Stage("forward kinematics", [*safety.forward(later=self._bodies_later), *record.post_reset_items()]),
            Stage("commands", commands),
            Stage("log", [*end, log]),
            Stage("sensors", observed),
            Stage("observations", observe),
        ]
        return [Stage("actions", actions), Stage("physics", [self._physics(apply)]), *self._counting(after_physics)]

    def _counting(self, stages: list[Stage]) -> list[Stage]:
        """Let the first host function after the physics count the step: torch terms see a count that includes it."""
        for index, stage in enumerate(stages):
            for place, item in enumerate(stage.items):
                if isinstance(item, Eager):
                    first = dataclasses.replace(item, function=partial(self._count_and_run, item.function))
                    items = [*stage.items[:place], first, *stage.items[place + 1 :]]
                    return [*stages[:index], Stage(stage.name, items), *stages[index + 1 :]]
        return stages

    def _count_and_run(self, function: Callable[[], None]) -> None:
        self.count_step()
        function()

    def _reset_classes(self) -> list[Item]:
        """Items that reset class terms and torch action terms, manager by manager."""
        managers = (
            self.observation_manager,
            self.action_manager,
            self.reward_manager,
            self.metrics_manager,
            self.curriculum_manager,
            self.command_manager,
            self.event_manager,
            self.termination_manager,
        )
        return [item for manager in managers for item in manager.reset_instance_items()]

    def _may_leave_bodies(self, readers: list[Item]) -> bool:
        """Whether nothing needs the bodies between the reset and the next physics step, which computes them anyway.

        Args:
            readers: All that runs in between, from forward kinematics to the end of the step and, in the next one, up
                to the physics.
        """
        sim, solver = self.sim, self.sim.cfg.solver
        if not (solver.finds_contacts and solver.reduced_coordinates and solver.in_place):
            return False  # the solver, or Newton's collision pipeline, starts from body poses
        if sim.turns_wrenches:
            return False
        all_float = all(a.layout.floating for a in self.scene.articulations.values())
        fields = _BODY_FIELDS if all_float else _BODY_FIELDS | _ROOT_FIELDS
        return not any(may_use(item, fields, self.context.scope.functions) for item in readers)

    def _physics(self, apply: Sequence[Section | Eager]) -> Captured | Eager:
        """The physics steps, each after the action terms that compute targets from the state."""
        steps, sim = self.cfg.decimation, self.sim
        what = f"{type(sim.solver).__name__}, {steps} physics steps"
        if not apply:
            return Captured(what, lambda: sim.launch(steps))
        parts = [self._apply_part(index, item) for index, item in enumerate(apply)]
        what = f"{what}, before each: {', '.join(t for item in apply for t in item.terms)}"
        if all(isinstance(item, Section) for item in apply):
            return Captured(what, lambda: sim.launch(steps, parts[0]))

        def run() -> None:
            for _ in range(steps):
                for part in parts:
                    part()
                sim.step(1)

        classes = ", ".join(t for item in apply if isinstance(item, Eager) for t in item.terms)
        return Eager(what, run, f"torch action terms: {classes}", [t for item in apply for t in item.terms])

    def _apply_part(self, index: int, item: Section | Eager) -> Callable[[], None]:
        if isinstance(item, Eager):
            return item.function
        return fuse(
            f"step_apply_{index}" if index else "step_apply", [item], self.context.scope, self.num_envs, self.device
        ).launch

    def _final_observations(self) -> list[Item]:
        """Items that copy the last observations of episodes that end, where ``compute_final_obs`` is set."""
        if not self.cfg.compute_final_obs:
            return []
        copies, scope = [], self.context.scope
        compute = self.observation_manager.compute_items(where_reset=True)
        for name, buffer in self.observation_manager.flat_buffers().items():
            source = scope.name(f"obs_{name}", buffer)
            target = scope.name(f"final_{name}", self.outputs.array(f"final.{name}"))
            copy = code("{}[env, i] = {}[env, i]", target, source)
            copies += block(code("for i in range({}.shape[1]):", target), [copy])
        keep = Section("final_observations", copies).only(self.context.is_reset)
        return only([*compute, keep], self.context.within_step)

    def begin_step(self) -> None:
        self.context.config_watch.take()
        super().begin_step()

    def _take_action(self, action: torch.Tensor) -> None:
        self._action_input.copy_(action)

    def _collect_observations(self, values: dict[str, torch.Tensor]) -> Observations:
        return self._groups(values, "obs")

    def _final_extras(self, values: dict[str, torch.Tensor]) -> Extras:
        if not self.cfg.compute_final_obs:
            return {}
        ended = values["terminated"] | values["truncated"]
        return {"final_obs": self._groups(values, "final"), "_final_obs": ended}

    def _groups(self, values: dict[str, torch.Tensor], prefix: str) -> Observations:
        groups: Observations = {}
        manager = self.observation_manager
        for name, buffer in manager.buffers.items():
            if isinstance(buffer, dict):
                groups[name] = {k: values[f"{prefix}.{name}.{k}"].view(-1, *manager.shape(name, k)) for k in buffer}
            else:
                groups[name] = values[f"{prefix}.{name}"].view(-1, *manager.shape(name))
        return groups

    # -- public properties

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
        """Actions of the last step after the action terms' scale, offset and clip, shape ``(num_envs, n)``."""
        return self.action_manager.processed_actions

    def describe(self, kernels: bool = False) -> str:
        """The managers with their terms, the stages of a step, and what of it is one CUDA graph, in plain text.

        Args:
            kernels: Also the source of the generated kernels.
        """
        return "\n\n".join([*map(str, self.managers), super().describe(kernels)])

    def set_state(self, state: EnvState) -> None:
        """See :meth:`RLEnv.set_state`. Recordings of the episodes under way are dropped."""
        super().set_state(state)
        self.recorder_manager.clear()

    def state_parts(self) -> list[dict[str, torch.Tensor]]:
        """Tensors of class terms; see :meth:`RLEnv.state_parts`."""
        every = [v for v in vars(self).values() if isinstance(v, ManagerBase)]
        return [part for manager in every for part in manager.instance_states()]

    def close_extras(self, **kwargs: object) -> None:
        """Release the recorder's file, renderer and simulation."""
        if "recorder_manager" in vars(self):  # the constructor may have failed before
            self.recorder_manager.close()
        super().close_extras(**kwargs)
