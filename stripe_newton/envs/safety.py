# SPDX-License-Identifier: Apache-2.0
"""Safety: finds worlds and actions that are not finite, makes them finite and counts them."""

from __future__ import annotations

import torch
import warp as wp

from stripe_kernels.episode import (
    clear_row,
    clear_wrench,
    finite_action,
    make_actions_finite,
    reset_targets,
    restore_row,
    row_is_finite,
)
from stripe_newton.fusion import Code, Item, KernelLaunches, Name, Section, block, code
from stripe_newton.managers import ManagerContext
from stripe_newton.sim import Simulation
from stripe_newton.sim.host_flags import HostFlags

__all__ = ["Safety"]


class Safety:
    """Finds worlds whose state is not finite, restores their initial state and ends their episodes.

    Its items are part of a step. Without them a single diverged world would send NaN through sensors, rewards and
    running statistics to the policy, and from there to all worlds.
    """

    def __init__(self, sim: Simulation, context: ManagerContext):
        self._sim, self._context = sim, context
        self._actions, self._worlds = HostFlags(1, context.device), HostFlags(1, context.device)
        self._reported = 0
        context.arrays["actions.nonfinite"] = self._actions.array
        scope = context.scope
        self._worlds_name = scope.name("nonfinite_worlds", self._worlds.array)
        self._actions_name = scope.name("nonfinite_actions", self._actions.array)
        self._per_env = sim.model.articulation_count // context.num_envs
        masks = sim.articulation_mask.reshape((context.num_envs, self._per_env))
        self._articulation_mask = scope.name("articulation_mask", masks)
        self._checked: list[tuple[Name, Name]] = []
        """Arrays of the state that must be finite, each with a copy of its initial values."""
        for name, array in {"joint_q": sim.state.joint_q, "joint_qd": sim.state.joint_qd}.items():
            if array is not None and array.size:
                rows = scope.name(f"world_{name}", _rows(sim, array))
                first = scope.name(f"initial_{name}", wp.clone(_rows(sim, array)))
                self._checked.append((rows, first))
        observed = sim.observables
        # Derived quantities of such a world are not finite either, and rewards and sensors of this step read them.
        left = {"previous_joint_qd": sim.previous_joint_qd, "joint_f": sim.control.joint_f}
        left["computed_effort"] = sim.actuation.computed_effort
        left |= {n: getattr(observed, n, None) for n in ("qfrc_actuator", "body_qdd", "body_parent_f")}
        self._cleared = [scope.name(f"world_{n}", _rows(sim, a)) for n, a in left.items() if a is not None and a.size]

    @property
    def nonfinite(self) -> torch.Tensor:
        """Worlds that were not finite after the physics, bool, shape ``(num_envs,)``."""
        return self._context.torch(self._context.nonfinite)

    @property
    def worlds(self) -> int:
        """Number of worlds found so far, as of the last report from the device."""
        return self._worlds[0]

    def raise_for_actions(self) -> None:
        """Raise if the device has reported actions that were not finite since the last call.

        Raises:
            ValueError: with their number.
        """
        count, self._reported = self._actions[0] - self._reported, self._actions[0]
        if count > 0:
            raise ValueError(
                f"{count} numbers in the actions were not finite and were set to 0; look at the policy, or set "
                "nonfinite_actions='clamp'"
            )

    def begin_reset_from_outside(self) -> None:
        """Prepare the masks for a call of ``reset()``, rather than a reset within a step."""
        self._context.torch(self._context.moved)[:] = self._context.reset_mask.tensor
        self.nonfinite.zero_()

    def make_finite(self, actions: torch.Tensor) -> None:
        """Make actions finite, in place, and count those that were not: one kernel."""
        flat = wp.from_torch(actions.view(-1))
        wp.launch(make_actions_finite, dim=flat.shape, inputs=[flat, self._actions.array], device=flat.device)

    # -- items

    def actions(self, actions: Code) -> Section:
        """Make an array of actions finite, in place, and count those that were not."""
        number = code("{}[env, i]", actions)
        line = code("{} = {}", number, self._context.scope.call(finite_action, number, self._actions_name))
        return Section("finite_actions", block(code("for i in range({}.shape[1]):", actions), [line]))

    def after_physics(self) -> Section:
        """Count the step in the episode's length, check the state of the world, restore it where it is not finite."""
        context, call = self._context, self._context.scope.call
        checks = [call(row_is_finite, code("{}[env]", rows)) for rows, _ in self._checked]
        restore = [call(restore_row, code("{}[env]", rows), code("{}[env]", first)) for rows, first in self._checked]
        restore += [call(clear_row, code("{}[env]", rows)) for rows in self._cleared]
        restore.append(code("wp.atomic_add({}, 0, 1)", self._worlds_name))
        body = [
            context.code("{episode.length}[env] = {episode.length}[env] + wp.int64(1)"),
            code(f"finite = {' and '.join(['{}'] * len(checks))}", *checks),
            context.code("{nonfinite}[env] = not finite"),
            *block(code("if not finite:"), restore),
        ]
        return Section("after_physics", body).only(context.within_step)

    def begin_reset(self) -> Section:
        """Set the targets of all assets to their defaults and remove external wrenches, where an episode begins."""
        context, body = self._context, list[Code]()
        for name in context.entity_names():
            struct = context.scope.name(name, context.asset(name).native_data.struct)
            body.append(context.scope.call(reset_targets, "env", struct))
            if self._sim.external_wrench is not None:
                body.append(context.scope.call(clear_wrench, "env", struct))
        return Section("targets", body).only(context.is_reset)

    def end_reset(self) -> Section:
        """Set the length of the new episode to 0. It ends a reset, as reset terms may read the old length."""
        line = self._context.code("{episode.length}[env] = wp.int64(0)")
        return Section("episode_start", [line]).only(self._context.is_reset)

    def forward(self, deferred: bool = False) -> list[Item]:
        """Forward kinematics where joints were written, and cleared solver memory where an episode began.

        Args:
            deferred: Leave forward kinematics to :meth:`Simulation.flush`, as the rest of the step reads no body.
        """
        follows = self._context.code("{moved}[env] or {reset}[env]")
        lines = [code("{}[env, {}] = {}", self._articulation_mask, a, follows) for a in range(self._per_env)]
        items: list[Item] = [Section("masks", lines)]
        if not deferred:
            items.append(KernelLaunches("forward kinematics", self._sim.forward_masked))
        # It may run beside the items that follow: only the physics of the next step reads the solver's memory.
        clear = KernelLaunches("solver memory cleared", self._clear_solver, concurrent=True, fields=frozenset())
        return [*items, clear]

    def _clear_solver(self) -> None:
        self._sim.clear_solver(self._context.reset_mask)


def _rows(sim: Simulation, array: wp.array) -> wp.array:
    """A flat array as floats, one row a world."""
    return wp.from_torch(sim.per_env(array).flatten(1), dtype=wp.float32)
