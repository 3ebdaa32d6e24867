# SPDX-License-Identifier: Apache-2.0
"""Torch actuators: a control law of your own, called with tensors before every physics step."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol

import newton
import torch
import warp as wp
from newton.actuators import ClampingMaxEffort, DriveBase

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.matching import match_names

from .actuator_cfg import ActuatorCfg
from .explicit_actuators import IdealPDActuatorCfg, Law, Part

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["JointGroup", "TorchActuatorCfg", "TorchDrive", "TorchLaw"]


class TorchLaw(Protocol):
    """A control law of a group of joints; all tensors have the shape ``(num_envs, num_joints)``."""

    def compute(
        self,
        pos_target: torch.Tensor,
        vel_target: torch.Tensor,
        effort_target: torch.Tensor,
        pos: torch.Tensor,
        vel: torch.Tensor,
    ) -> torch.Tensor:
        """Efforts of the next physics step [N or N m] from targets, positions [m or rad] and velocities."""

    def reset(self, env_ids: torch.Tensor) -> None:
        """Forget the past of environments whose episode begins, int64."""


@dataclass(frozen=True)
class JointGroup:
    """The joints of a law, and their numbers in the model; tensors have the shape ``(num_envs, num_joints)``."""

    names: list[str]
    """Names of the joints."""
    ids: list[int]
    """Their indices in the articulation."""
    num_envs: int
    """Number of environments."""
    device: str
    """Torch device."""
    stiffness: torch.Tensor
    """Position gains [N/m or N m/rad]."""
    damping: torch.Tensor
    """Velocity gains [N s/m or N m s/rad]."""
    effort_limit: torch.Tensor
    """Largest efforts [N or N m]."""
    velocity_limit: torch.Tensor
    """Rated speeds [m/s or rad/s]."""
    armature: torch.Tensor
    """Inertias added to the joints [kg or kg m^2]."""
    friction: torch.Tensor
    """Coulomb friction of the joints [N or N m]."""
    viscous_friction: torch.Tensor
    """Passive damping of the joints [N s/m or N m s/rad]."""


class _Slot:
    """Place of a law that is made when the model is there; the builder's copies share it."""

    def __init__(self, name: str):
        self.name = name
        self.numbers: list[dict[str, float]] = []  # of each joint
        self.law: TorchLaw | None = None

    @property
    def joints(self) -> int:
        return len(self.numbers)

    def __deepcopy__(self, memo: object) -> _Slot:
        return self

    def __lt__(self, other: object) -> bool:  # Newton sorts the arguments of drives
        return id(self) < id(other)


class TorchDrive(DriveBase):
    """Newton's drive that calls a law with the tensors of all environments.

    Attributes:
        slot: Where the law is.
    """

    SHARED_PARAMS: ClassVar[set[str]] = {"slot"}

    @dataclass
    class State(DriveBase.State):
        """State of the law, which the law itself keeps."""

        drive: TorchDrive | None = None

        def reset(self, mask: wp.array | None = None) -> None:
            """Tell the law which environments begin an episode."""
            if self.drive is not None:
                self.drive.reset(mask)

    @classmethod
    def resolve_arguments(cls, args: dict[str, object]) -> dict[str, object]:
        """The slot."""
        return {"slot": args["slot"]}

    def __init__(self, slot: _Slot):
        self.slot = slot

    def is_stateful(self) -> bool:
        """True: the law is told of resets."""
        return True

    def is_graphable(self) -> bool:
        """False: a law may read numbers of the device."""
        return False

    def state(self, num_actuators: int, device: wp.Device) -> State:
        """The state through which resets come."""
        return TorchDrive.State(drive=self)

    def reset(self, mask: wp.array | None) -> None:
        """Pass on the environments of a mask of degrees of freedom."""
        if self.slot.law is None:
            return
        rows = None if mask is None else wp.to_torch(mask).view(-1, self.slot.joints)[:, 0]
        ids = torch.arange(self._num_envs) if rows is None else rows.nonzero().flatten()
        if len(ids):
            self.slot.law.reset(ids)

    def finalize(self, device: wp.Device, num_actuators: int) -> None:
        """Take the number of environments."""
        self._num_envs = num_actuators // self.slot.joints

    def compute(  # type: ignore[no-untyped-def]  # Newton's signature, of which the arrays are used
        self, positions, velocities, target_pos, target_vel, feedforward, pos_indices, vel_indices,
        target_pos_indices, target_vel_indices, forces, state, dt, device=None, *, custom_inputs=None,
    ) -> None:  # fmt: skip
        """Call the law and write its efforts to ``forces``."""
        law, shape = self.slot.law, (self._num_envs, self.slot.joints)
        if law is None:  # a trial step before the law is there
            forces.zero_()
            return

        def read(array: wp.array, indices: wp.array) -> torch.Tensor:
            return wp.to_torch(array)[wp.to_torch(indices.view(wp.int32)).long()].view(shape)

        feed = torch.zeros(shape, device=wp.device_to_torch(forces.device))
        with torch.no_grad():
            effort = law.compute(
                read(target_pos, target_pos_indices),
                read(target_vel, target_vel_indices),
                feed if feedforward is None else read(feedforward, target_vel_indices),
                read(positions, pos_indices),
                read(velocities, vel_indices),
            )
        if tuple(effort.shape) != shape:
            raise ValueError(f"{self.slot.name} returned efforts of the shape {tuple(effort.shape)}, must be {shape}")
        wp.to_torch(forces).copy_(effort.reshape(-1))


@configclass
class CallsTorchLaw(IdealPDActuatorCfg):
    """Mix-in of configs whose joints are driven by a law in torch."""

    def calls_law(self) -> bool:
        """Whether the law in torch drives the joints, rather than that of the config's base."""
        return True

    def law_name(self) -> str:
        """Name of the law, for messages."""
        raise NotImplementedError

    def make_law_of(self, group: JointGroup) -> TorchLaw:
        """The law of a group of joints."""
        raise NotImplementedError

    def _needs(self) -> tuple[str, ...]:
        if not self.calls_law():
            return super()._needs()
        limit = ("effort_limit_sim",) if self.effort_limit_sim is not None else ()
        return ("stiffness", "damping", "effort_limit", *limit)

    def _law(self) -> Law:
        if not self.calls_law():
            return super()._law()
        slot = _Slot(self.law_name())

        def law(joint: dict[str, float]) -> Part:
            slot.numbers.append(joint)
            return TorchDrive, {"slot": slot}

        return law

    def _limits(self, joint: dict[str, float]) -> list[Part]:
        if not self.calls_law():
            return super()._limits(joint)
        limit = joint.get("effort_limit_sim")
        return [] if limit is None else [(ClampingMaxEffort, {"max_effort": limit})]

    def _delay(self) -> int:
        return 0 if self.calls_law() else super()._delay()

    def bind(self, sim: Simulation, names: Sequence[str], dofs: Sequence[int]) -> None:
        if not self.calls_law():
            super().bind(sim, names, dofs)
            return
        ids, own = match_names(self.joint_names_expr, names, what="joint")
        rows = [dofs[i] for i in ids]
        drives = {a.indices.numpy()[0]: a.drive for a in sim.model.actuators if isinstance(a.drive, TorchDrive)}
        slot = drives[rows[0]].slot
        given = ("stiffness", "damping", "effort_limit")  # what the config says, as the model's drives are off
        numbers = {k: torch.tensor([joint[k] for joint in slot.numbers], device=sim.device) for k in given}
        own_rows = {k: values.repeat(sim.num_envs, 1) for k, values in numbers.items()}
        slot.law = self.make_law_of(joint_group(sim, own, ids, rows, **own_rows))
        slot.law.reset(torch.arange(sim.num_envs, device=sim.device))


def joint_group(
    sim: Simulation, names: list[str], ids: list[int], rows: Sequence[int], **given: torch.Tensor
) -> JointGroup:
    """The joints of a law, with the numbers of the model but for those that are given.

    Args:
        sim: The simulation.
        names: Names of the joints.
        ids: Their indices in the articulation.
        rows: Their degrees of freedom in an environment.
        given: Tensors of the group by name, shape ``(num_envs, num_joints)``.
    """
    model: newton.Model = sim.model
    arrays = {
        "stiffness": model.joint_target_ke,
        "damping": model.joint_target_kd,
        "effort_limit": model.joint_effort_limit,
        "velocity_limit": model.joint_velocity_limit,
        "armature": model.joint_armature,
        "friction": model.joint_friction,
        "viscous_friction": model.joint_damping,
    }
    found = {k: sim.per_env(array)[:, list(rows)].clone() for k, array in arrays.items() if k not in given}
    return JointGroup(names, ids, sim.num_envs, sim.device, **found, **given)


def law_name(make_law: Callable[..., object]) -> str:
    """Name of what makes a law, for messages."""
    return getattr(make_law, "__name__", type(make_law).__name__)


@configclass
class TorchActuatorCfg(CallsTorchLaw):
    """A control law of your own in torch, evaluated before every physics step.

    It cannot be part of a CUDA graph: set ``SimulationCfg(use_cuda_graph=False)`` on a GPU. ``stiffness``, ``damping``
    and ``effort_limit`` are what the law is given. The effort that it returns is applied as it is, within
    ``effort_limit_sim`` where that is set.
    """

    make_law: Callable[[ActuatorCfg, JointGroup], TorchLaw] = MISSING
    """Makes the law of a group of joints when the scene is built, such as a class ``MyLaw(cfg, group)``."""

    def law_name(self) -> str:
        return law_name(self.make_law)

    def make_law_of(self, group: JointGroup) -> TorchLaw:
        return self.make_law(self, group)
