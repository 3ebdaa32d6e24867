# SPDX-License-Identifier: Apache-2.0
"""Torch targets: a law of your own in torch that changes the targets of the solver's drives before a physics step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Protocol

import torch

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.matching import match_names

from .actuator_cfg import ActuatorCfg, ImplicitActuatorCfg
from .torch_actuators import JointGroup, joint_group, law_name

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["ChangedTargets", "TargetLaw", "Targets", "TorchTargetsCfg"]

Targets = tuple[torch.Tensor, torch.Tensor, torch.Tensor]
"""Position targets [m or rad], velocity targets [m/s or rad/s] and efforts [N or N m], ``(num_envs, num_joints)``."""


class TargetLaw(Protocol):
    """Changes the targets of a group of joints; all tensors have the shape ``(num_envs, num_joints)``."""

    def compute(
        self,
        pos_target: torch.Tensor,
        vel_target: torch.Tensor,
        effort_target: torch.Tensor,
        pos: torch.Tensor,
        vel: torch.Tensor,
    ) -> Targets:
        """Targets of the next physics step from those that were set, positions [m or rad] and velocities."""

    def reset(self, env_ids: torch.Tensor) -> None:
        """Forget the past of environments whose episode begins, int64."""


class ChangedTargets:
    """Shows the solver other targets during a physics step than those that were set.

    The targets in the control's arrays are those of the caller before and after it: a policy's targets hold for all
    physics steps of a step of the environment, and the law begins with them each time.
    """

    def __init__(self, sim: Simulation, law: TargetLaw, name: str, dofs: Sequence[int]):
        """Take the arrays of a simulation.

        Args:
            sim: The simulation.
            law: The law.
            name: Its name, for messages.
            dofs: Degrees of freedom of an environment.

        Raises:
            ValueError: a CUDA graph would be recorded, or a degree of freedom is that of a ball joint.
        """
        if sim.device != "cpu" and sim.cfg.use_cuda_graph:
            raise ValueError(
                f"actuator '{name}' changes targets in torch, which cannot be part of a CUDA graph: set "
                "SimulationCfg(use_cuda_graph=False)"
            )
        coords = sim.actuation.drives.coord.numpy()[list(dofs)].tolist()
        if min(coords) < 0:
            raise ValueError(f"actuator '{name}': it cannot change targets of a ball joint")
        self._law, self._name = law, name
        dof_rows, coord_rows = (torch.tensor(rows, device=sim.device) for rows in (dofs, coords))
        control, state = sim.control, sim.state
        self._targets = [
            (sim.per_env(control.joint_target_q), coord_rows),
            (sim.per_env(control.joint_target_qd), dof_rows),
            (sim.per_env(control.joint_act), dof_rows),
        ]
        self._joints = [(sim.per_env(state.joint_q), coord_rows), (sim.per_env(state.joint_qd), dof_rows)]
        self._set: list[torch.Tensor] = []

    def change(self) -> None:
        """Ask the law and write its targets, before a physics step.

        Raises:
            ValueError: the law returns tensors of another shape.
        """
        self._set = [array[:, rows] for array, rows in self._targets]
        with torch.no_grad():
            given = [tensor.clone() for tensor in self._set]  # a law may change its arguments in place
            changed = self._law.compute(*given, *(array[:, rows] for array, rows in self._joints))
        for (array, rows), target, before in zip(self._targets, changed, self._set, strict=True):
            if target.shape != before.shape:
                shapes = f"{tuple(target.shape)}, must be {tuple(before.shape)}"
                raise ValueError(f"{self._name} returned targets of the shape {shapes}")
            array[:, rows] = target

    def restore(self) -> None:
        """Write the targets that were set, after the physics step."""
        for (array, rows), target in zip(self._targets, self._set, strict=True):
            array[:, rows] = target

    def reset(self, env_ids: torch.Tensor) -> None:
        """Tell the law which environments begin an episode."""
        self._law.reset(env_ids)


@configclass
class ChangesTargets(ImplicitActuatorCfg):
    """Mix-in of configs whose drives in the solver follow targets that a law in torch changes."""

    def calls_law(self) -> bool:
        """Whether there is a law, rather than the drive alone."""
        return True

    def law_name(self) -> str:
        """Name of the law, for messages."""
        raise NotImplementedError

    def make_law_of(self, group: JointGroup) -> TargetLaw:
        """The law of a group of joints."""
        raise NotImplementedError

    def bind(self, sim: Simulation, names: Sequence[str], dofs: Sequence[int]) -> None:
        super().bind(sim, names, dofs)
        if not self.calls_law():
            return
        ids, own = match_names(self.joint_names_expr, names, what="joint")
        rows = [dofs[i] for i in ids]
        law = self.make_law_of(joint_group(sim, own, ids, rows))
        sim.actuation.changed_targets.append(ChangedTargets(sim, law, self.law_name(), rows))
        law.reset(torch.arange(sim.num_envs, device=sim.device))


@configclass
class TorchTargetsCfg(ChangesTargets):
    """A drive inside the solver whose targets a law of your own in torch changes before every physics step.

    The gains are integrated implicitly, as those of :class:`ImplicitActuatorCfg`. It cannot be part of a CUDA graph:
    set ``SimulationCfg(use_cuda_graph=False)`` on a GPU.
    """

    make_law: Callable[[ActuatorCfg, JointGroup], TargetLaw] = MISSING
    """Makes the law of a group of joints when the scene is built, such as a class ``MyLaw(cfg, group)``."""

    def law_name(self) -> str:
        return law_name(self.make_law)

    def make_law_of(self, group: JointGroup) -> TargetLaw:
        return self.make_law(self, group)
