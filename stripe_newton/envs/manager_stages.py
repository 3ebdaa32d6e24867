# SPDX-License-Identifier: Apache-2.0
"""Manager stages: the step of a lab scene as stages, made of the items of its managers, sensors and safety.

=================== ==============================================================================================
stage               what runs in it
=================== ==============================================================================================
actions             the count of steps, action terms, recorder terms before the step
physics             ``decimation`` physics steps, each after the action terms that compute targets from the state
measurements        sensors that terminations and rewards read
outcome, rewards    terminations; then rewards and metrics, which read which episodes end
episode log         last observations, curriculum and log of episodes that end, before the reset clears their sums
reset               of these environments: default state, reset events, states of terms
events, objects     interval and step events; spawned objects
forward kinematics  bodies of new episodes follow their joints, if anything reads them before the next physics step
commands            goals of new episodes, and those that are due
log                 values of the curriculum, and the log of the step
sensors             those that observations read, in the state of new episodes
observations        of new episodes where they began
=================== ==============================================================================================
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING

from stripe_newton.fusion import HostFunction, Item, KernelLaunches, Section, Stage, block, code, fuse, may_use, only
from stripe_newton.managers.default_reset import default_reset_items

from .safety import Safety
from .stage_items import count_section, scenery_items, sensor_items

if TYPE_CHECKING:
    from .lab_scene import LabScene

__all__ = ["ManagerStages"]

_BODY_FIELDS = frozenset({"body_pose", "body_vel"})
"""Fields that forward kinematics computes."""
_ROOT_FIELDS = frozenset({"root_pose", "root_vel"})
"""Fields that forward kinematics computes for a fixed base; those of a floating base are joint coordinates."""


class ManagerStages:
    """Makes the stages of a step once, when the environment is built.

    Attributes:
        defers_bodies: Whether forward kinematics after a reset waits for the next reader; known after :meth:`make`.
    """

    def __init__(self, lab: LabScene, safety: Safety):
        self._lab, self._safety, self._context = lab, safety, lab.context
        self._custom = list(lab.custom_managers.values())
        self.defers_bodies = False

    def make(self) -> list[Stage]:
        """The stages in the order in which they run.

        Items are made in about the same order. Those of the curriculum come late, when every parameter exists that it
        may change, and forward kinematics last, when it is known what reads the bodies.
        """
        lab, context, record = self._lab, self._context, self._lab.recorder_manager
        in_step = context.within_step
        actions, apply = self._actions()
        measured = sensor_items(lab.scene, context, "launch_measured")
        outcome, rewards, ended = self._outcome(), self._rewards(), self._ended()
        reset = self._reset()
        events = [*lab.event_manager.interval_items(), *lab.event_manager.step_items()]
        objects = lab.object_manager.update_items()
        commands = only(lab.command_manager.compute_items(), in_step)
        observe = self._observe()
        observed = sensor_items(lab.scene, context, "launch_observed")
        final = self._final_observations()
        curriculum = lab.curriculum_manager.update_items()
        later = [*events, *objects, *record.post_reset_items(), *commands, *curriculum, *observed, *observe]
        reset += self._sensor_resets(later)
        # The log runs beside the rest: no kernel of this step reads it.
        log = KernelLaunches("log", context.log.finish, concurrent=True, fields=frozenset())
        readers = [*record.post_reset_items(), *commands, *curriculum, *observed, *observe, *actions, *apply]
        self.defers_bodies = self._can_defer_bodies(readers)
        after_physics = [
            *([Stage("measurements", measured)] if measured else []),
            Stage("outcome", only(outcome, in_step)),
            Stage("rewards", [*only(rewards, in_step), *record.post_step_items()]),
            Stage("episode log", [*final, *ended, *only(lab.termination_manager.reset_items(), in_step)]),
            Stage("reset", reset),
            Stage("events", only(events, in_step)),
            Stage("objects", only(objects, in_step)),
            Stage("forward kinematics", self._forward_kinematics()),
            # From here on items read the bodies of new episodes.
            Stage("commands", commands),
            Stage("log", [*curriculum, log]),
            Stage("sensors", observed),
            Stage("observations", observe),
        ]
        if self.defers_bodies and not self._reads_bodies([item for stage in after_physics for item in stage.items]):
            lab.sim.leave_bodies()
        return [Stage("actions", actions), Stage("physics", [self._physics(apply)]), *self._counting(after_physics)]

    # -- the items of stages

    def _actions(self) -> tuple[list[Item], list[Section | HostFunction]]:
        """Items that run once before the physics, and those that run before each physics step."""
        manager = self._lab.action_manager
        apply, process = manager.apply_items(), manager.process_items()
        # Actions may be processed by one thread for each number. The count then takes part in that kernel's layout
        # (one of its threads does it), so that the two are not cut into two kernels.
        parts = int(any(isinstance(item, Section) and item.parts for item in process))
        apply += [item for m in self._custom for item in m.substep_items()]
        process += [item for m in self._custom for item in m.action_items()]
        count = count_section(self._context, parts)
        return [count, *process, *self._lab.recorder_manager.pre_step_items()], apply

    def _outcome(self) -> list[Item]:
        """Items that find out which episodes end, from the state after the physics."""
        after = [item for m in self._custom for item in m.physics_items()]
        return [self._safety.after_physics(), *after, *self._lab.termination_manager.compute_items()]

    def _rewards(self) -> list[Item]:
        """Rewards and metrics. They follow terminations, as rewards of termination read which episodes end."""
        items = [*self._lab.reward_manager.compute_items(), *self._lab.metrics_manager.compute_items()]
        return items + [item for m in self._custom for item in m.reward_items()]

    def _ended(self) -> list[Item]:
        """Items that read sums and states of the episodes that ended, before the reset clears them."""
        context = self._context
        items = only(self._lab.curriculum_manager.compute_items(), context.within_step, context.is_finite)
        own = [item for m in self._custom for item in m.log_items()]
        return items + only(own, context.within_step, context.is_reset)

    def _reset(self) -> list[Item]:
        """Items that begin new episodes in the environments of the reset mask."""
        lab, context = self._lab, self._context
        return [
            *lab.recorder_manager.pre_reset_items(),
            *lab.reward_manager.reset_items(),
            *lab.metrics_manager.reset_items(),
            self._safety.begin_reset(),
            *scenery_items(lab.scene, context),
            # Before the events, which override it: what nobody resets must not go on from the last episode.
            *self._default_reset_items(),
            *lab.event_manager.reset_items(),
            # After the events, as spawned objects keep a distance from the positions that robots are reset to.
            *lab.object_manager.reset_items(),
            *lab.action_manager.reset_items(),
            *lab.command_manager.reset_items(),
            *lab.observation_manager.reset_items(),
            *only([item for m in self._custom for item in m.reset_items()], context.is_reset),
            # Class terms read the states that the events have set, and the length of the episode that ended.
            *self._reset_classes(),
            self._safety.end_reset(),
        ]

    def _sensor_resets(self, later: Sequence[Item]) -> list[Item]:
        """Launches that reset sensors, beside the rest of the step where that does not read what they write.

        Args:
            later: The items that run after them.
        """
        items, functions = list[Item](), self._context.scope.functions
        for item in sensor_items(self._lab.scene, self._context, "launch_reset"):
            if isinstance(item, KernelLaunches) and item.fields is not None:
                is_read = any(may_use(other, item.fields, functions) for other in later)
                item = dataclasses.replace(item, concurrent=not is_read)
            items.append(item)
        return items

    def _default_reset_items(self) -> list[Item]:
        """The item that brings assets to their default state that neither an event nor a pool resets."""
        events = [term for _, term in self._lab.event_manager.items()]
        pooled = [name for pool in self._lab.object_manager.pools.values() for name in pool.names]
        return default_reset_items(self._context, events, pooled, self._lab.cfg.keep_at_reset)

    def _reset_classes(self) -> list[Item]:
        """Items that reset class terms and torch action terms, manager by manager."""
        managers = (
            self._lab.observation_manager,
            self._lab.action_manager,
            self._lab.reward_manager,
            self._lab.metrics_manager,
            self._lab.curriculum_manager,
            self._lab.command_manager,
            self._lab.event_manager,
            self._lab.termination_manager,
        )
        return [item for manager in managers for item in manager.reset_instance_items()]

    def _forward_kinematics(self) -> list[Item]:
        return [*self._safety.forward(deferred=self.defers_bodies), *self._lab.recorder_manager.post_reset_items()]

    def _observe(self) -> list[Item]:
        before = [item for m in self._custom for item in m.observation_items()]
        items = [*before, *self._lab.observation_manager.compute_items()]
        return only(items, self._context.within_step_or_reset)

    def _final_observations(self) -> list[Item]:
        """Items that copy the last observations of episodes that end, where ``compute_final_obs`` is set."""
        if not self._lab.cfg.compute_final_obs:
            return []
        copies, scope = [], self._context.scope
        compute = self._lab.observation_manager.compute_items(where_reset=True)
        for name, buffer in self._lab.observation_manager.flat_buffers().items():
            source = scope.name(f"obs_{name}", buffer)
            target = scope.name(f"final_{name}", self._lab.outputs.array(f"final.{name}"))
            copy = code("{}[env, i] = {}[env, i]", target, source)
            copies += block(code("for i in range({}.shape[1]):", target), [copy])
        keep = Section("final_observations", copies).only(self._context.is_reset)
        return only([*compute, keep], self._context.within_step)

    # -- the physics

    def _physics(self, apply: Sequence[Section | HostFunction]) -> KernelLaunches | HostFunction:
        """The physics steps, each after the action terms that compute targets from the state."""
        steps, sim = self._lab.cfg.decimation, self._lab.sim
        what = f"{type(sim.solver).__name__}, {steps} physics steps"
        if not apply:
            return KernelLaunches(what, lambda: sim.launch(steps))
        parts = [self._apply_part(index, item) for index, item in enumerate(apply)]
        what = f"{what}, before each: {', '.join(t for item in apply for t in item.terms)}"
        if all(isinstance(item, Section) for item in apply):
            return KernelLaunches(what, lambda: sim.launch(steps, parts[0]))

        def run() -> None:
            for _ in range(steps):
                for part in parts:
                    part()
                sim.step(1)

        classes = ", ".join(t for item in apply if isinstance(item, HostFunction) for t in item.terms)
        return HostFunction(what, run, f"torch action terms: {classes}", [t for item in apply for t in item.terms])

    def _apply_part(self, index: int, item: Section | HostFunction) -> Callable[[], None]:
        if isinstance(item, HostFunction):
            return item.function
        return fuse(
            f"step_apply_{index}" if index else "step_apply",
            [item],
            self._context.scope,
            self._lab.num_envs,
            self._lab.device,
        ).launch

    # -- what depends on all items

    def _can_defer_bodies(self, readers: list[Item]) -> bool:
        """Whether nothing needs the bodies between the reset and the next physics step, which computes them anyway.

        Args:
            readers: All that runs in between, from forward kinematics to the end of the step and, in the next one, up
                to the physics.
        """
        sim, solver = self._lab.sim, self._lab.sim.cfg.solver
        if not (solver.finds_contacts and solver.reduced_coordinates and solver.in_place):
            return False  # the solver, or Newton's collision pipeline, starts from body poses
        if sim.turns_wrenches:
            return False
        return not self._reads_bodies(readers)

    def _reads_bodies(self, items: Sequence[Item]) -> bool:
        """Whether an item may read poses or velocities of bodies, such as those of a root that does not float."""
        all_float = all(a.layout.floating for a in self._lab.scene.articulations.values())
        fields = _BODY_FIELDS if all_float else _BODY_FIELDS | _ROOT_FIELDS
        return any(may_use(item, fields, self._context.scope.functions) for item in items)

    def _counting(self, stages: list[Stage]) -> list[Stage]:
        """Let the first host function after the physics count the step: torch terms see a count that includes it."""
        for index, stage in enumerate(stages):
            for place, item in enumerate(stage.items):
                if isinstance(item, HostFunction):
                    first = dataclasses.replace(item, function=partial(self._count_and_run, item.function))
                    items = [*stage.items[:place], first, *stage.items[place + 1 :]]
                    return [*stages[:index], Stage(stage.name, items), *stages[index + 1 :]]
        return stages

    def _count_and_run(self, function: Callable[[], None]) -> None:
        self._lab.count_step()
        function()
