# SPDX-License-Identifier: Apache-2.0
"""Worlds and actions that are not finite."""

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
from stripe_newton.fusion import Captured, Item, Section
from stripe_newton.managers import ManagerContext
from stripe_newton.sim import Simulation
from stripe_newton.sim.host_flags import HostFlags

__all__ = ["Safety"]


class Safety:
    """Finds worlds whose state is not finite, gives them a finite one, and clears what they left behind."""

    def __init__(self, sim: Simulation, context: ManagerContext):
        self._sim, self._context = sim, context
        self._actions, self._worlds = HostFlags(1, context.device), HostFlags(1, context.device)
        self._reported = 0
        context.arrays["actions.nonfinite"] = self._actions.array
        scope = context.scope
        self.nonfinite = context.array("nonfinite", wp.bool)
        """Worlds that were not finite after the physics, bool, shape ``(num_envs,)``."""
        scope.name("nonfinite", self.nonfinite)
        scope.name("nonfinite_worlds", self._worlds.array)
        self._bad_actions = scope.name("nonfinite_actions", self._actions.array)
        self._world_mask = wp.zeros(context.num_envs + 1, dtype=wp.bool, device=context.device)
        scope.name("world_mask", self._world_mask)
        self._per_env = sim.model.articulation_count // context.num_envs
        scope.name("articulation_mask", sim.articulation_mask.reshape((context.num_envs, self._per_env)))
        self._checked: list[tuple[str, str]] = []
        state = sim.state
        for name in ("joint_q", "joint_qd"):
            array = getattr(state, name)
            if array is not None and array.size:
                rows = scope.name(f"world_{name}", _rows(sim, array))
                first = scope.name(f"initial_{name}", wp.clone(_rows(sim, array)))
                self._checked.append((rows, first))
        observed = sim.observables
        left = {"previous_joint_qd": sim.previous_joint_qd, "joint_f": sim.control.joint_f}
        left["computed_effort"] = sim.actuation.computed_effort
        left |= {n: getattr(observed, n, None) for n in ("qfrc_actuator", "body_qdd", "body_parent_f")}
        self._cleared = [scope.name(f"world_{n}", _rows(sim, a)) for n, a in left.items() if a is not None and a.size]

    @property
    def worlds(self) -> int:
        """Worlds that were found, as far as the device has told."""
        return self._worlds[0]

    def raise_for_actions(self) -> None:
        """Raise if actions were not finite since the last call, as far as the device has told.

        Raises:
            ValueError: with their number.
        """
        count, self._reported = self._actions[0] - self._reported, self._actions[0]
        if count > 0:
            raise ValueError(
                f"{count} numbers in the actions were not finite and were set to 0; look at the policy, or set "
                "nonfinite_actions='clamp'"
            )

    def begin(self, mask: torch.Tensor) -> None:
        """Mark environments as ended from outside of a step."""
        wp.to_torch(self._context.moved)[:] = mask
        wp.to_torch(self.nonfinite).zero_()

    def make_finite(self, actions: torch.Tensor) -> None:
        """Make actions finite, in place, and count those that were not: one kernel."""
        flat = wp.from_torch(actions.view(-1))
        wp.launch(make_actions_finite, dim=flat.shape, inputs=[flat, self._actions.array], device=flat.device)

    def actions(self, array: str, size: int) -> Section:
        """Make actions finite, in place, and count those that were not."""
        function = self._context.scope.function(finite_action)
        line = f"    {array}[env, i] = {function}({array}[env, i], {self._bad_actions})"
        return Section("finite_actions", [f"for i in range({array}.shape[1]):", line])

    def after_physics(self) -> Section:
        """Count the step of the episode and look at the world."""
        function = self._context.scope.function
        finite, restore, clear = function(row_is_finite), function(restore_row), function(clear_row)
        checks = " and ".join(f"{finite}({rows}[env])" for rows, _ in self._checked)
        body = [
            "episode.length[env] = episode.length[env] + wp.int64(1)",
            f"finite = {checks}",
            "nonfinite[env] = not finite",
            "if not finite:",
            *(f"    {restore}({rows}[env], {first}[env])" for rows, first in self._checked),
            *(f"    {clear}({rows}[env])" for rows in self._cleared),
            "    wp.atomic_add(nonfinite_worlds, 0, 1)",
        ]
        return Section("after_physics", body, condition="stepping[0] != 0")

    def begin_reset(self) -> Section:
        """Targets of all assets back to their defaults, wrenches removed."""
        context, body = self._context, []
        function = context.scope.function
        for name in context.entity_names():
            struct = context.scope.name(name, context.entity(name).data.struct)
            body.append(f"{function(reset_targets)}(env, {struct})")
            if self._sim.external_wrench is not None:
                body.append(f"{function(clear_wrench)}(env, {struct})")
        return Section("targets", body, where_reset=True)

    def end_reset(self) -> Section:
        """The episode starts."""
        return Section("episode_start", ["episode.length[env] = wp.int64(0)"], where_reset=True)

    def forward(self, later: bool = False) -> list[Item]:
        """Bodies follow the joints where those were written, and the solver forgets the episodes that ended.

        Args:
            later: Leave the bodies to :meth:`Simulation.flush`, as nothing in the rest of the step reads them.
        """
        body = [
            *(f"articulation_mask[env, {a}] = moved[env] or reset[env]" for a in range(self._per_env)),
            "world_mask[env] = reset[env]",
        ]
        items: list[Item] = [Section("masks", body)]
        if not later:
            items.append(Captured("forward kinematics", self._sim.forward_masked))
        clear = Captured(
            "solver memory cleared",
            lambda: self._sim.clear_masked(self._world_mask, self._context.reset),
            beside=True,
        )
        return [*items, clear]


def _rows(sim: Simulation, array: wp.array) -> wp.array:
    """A flat array as floats, one row a world."""
    return wp.from_torch(sim.per_env(array).flatten(1), dtype=wp.float32)
