# SPDX-License-Identifier: Apache-2.0
"""Articulation: a robot, or anything else with joints, in every environment."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING

import newton
import torch

from stripe_newton.actuators import ActuatorCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.matching import match_names, match_values

from .articulation_data import ArticulationData
from .asset_base import AssetBase, AssetBaseCfg, AssetInitialStateCfg, BoundAsset, EnvIds
from .dynamics import ArticulationDynamics
from .fixed_tendons import FixedTendons
from .joint_order import JointOrder, order_joints
from .layout import Layout
from .rigid_object import RigidObjectCfg

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["Articulation", "ArticulationCfg"]

JointIds = Sequence[int] | torch.Tensor | slice | None
"""Joints by index; ``None`` means all."""

JointValues = torch.Tensor | float
"""A number for all, or numbers of shape ``(n, joints)``."""


def _articulation(cfg: ArticulationCfg) -> Articulation:
    return Articulation(cfg)


@configclass
class ArticulationCfg(AssetBaseCfg):
    """A robot, or anything else with joints."""

    @configclass
    class InitialStateCfg(RigidObjectCfg.InitialStateCfg):
        """State at the start of an episode."""

        joint_pos: dict[str, float] | None = {".*": 0.0}
        """Joint positions by name expression [m or rad]; ``None`` keeps the file's."""
        joint_vel: dict[str, float] = {".*": 0.0}
        """Joint velocities by name expression [m/s or rad/s]."""

        def problems(self) -> Iterator[tuple[str, str]]:
            yield from AssetInitialStateCfg.problems(self)
            for name in ("joint_pos", "joint_vel"):
                for key, value in (getattr(self, name) or {}).items():
                    if not math.isfinite(value):
                        yield f"{name}[{key!r}]", f"is {value}, must be finite"

    class_type: Callable[..., AssetBase] | None = _articulation
    """Class that the scene makes of this config."""
    init_state: InitialStateCfg = InitialStateCfg()
    """State at the start of an episode."""
    articulation_root_prim_path: str | None = None
    """Path of the articulation root below ``prim_path``, with a leading slash; needed where the asset has several."""
    soft_joint_pos_limit_factor: float = 1.0
    """Share of the range between the joint limits that the soft limits cover."""
    actuators: dict[str, ActuatorCfg] = {}
    """Actuators by name of the group; joints in no group keep the drives of the file."""
    joint_order: JointOrder = "file"
    """Order of joints and bodies: that of the ``"file"``; ``"breadth_first"``, by the depth in the tree, then the order
    of the parents, then the name, as Isaac Lab has the joints of most robots; or names of joints in their order."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not 0.0 < self.soft_joint_pos_limit_factor <= 1.0:
            yield "soft_joint_pos_limit_factor", f"is {self.soft_joint_pos_limit_factor}, must be in (0, 1]"


class Articulation(BoundAsset):
    """An articulation in every environment; its state is in :attr:`data`.

    Create it in ``_setup_scene``, or by a field of the scene config. Targets are set by
    ``set_joint_*_target`` and act from the next physics step until changed.
    """

    cfg: ArticulationCfg
    _data: ArticulationData

    def arrange(self, builder: newton.ModelBuilder) -> None:
        """Bring joints and bodies into the order that the config asks for."""
        order_joints(builder, self.path, self.cfg.joint_order)

    def prepare(self, layouts: Sequence[Layout], builder: newton.ModelBuilder) -> None:
        """Find the articulation and write initial state and actuators onto the builder of one environment.

        Raises:
            ConfigError: everything in the config that does not fit the articulation, at once.
        """
        cfg = self.cfg
        self.layout = layout = self._find_layout(layouts, cfg.articulation_root_prim_path)
        self._place_root(builder)
        problems = [*self._write_joint_state(builder), *self._write_actuators(builder)]
        # Targets begin at the initial state: a drive would otherwise pull to zero before the first action. The zip ends
        # with the shorter range, as a ball joint has more coordinates than degrees of freedom.
        for coord, dof in zip(layout.coords, layout.dofs, strict=False):
            builder.joint_target_q[coord] = builder.joint_q[coord]
            builder.joint_target_qd[dof] = builder.joint_qd[dof]
        if problems:
            raise ConfigError([f"articulation '{cfg.prim_path}': {p}" for p in problems])

    def _write_joint_state(self, builder: newton.ModelBuilder) -> Iterator[str]:
        """Write initial positions and velocities; yields what does not fit."""
        layout, names = self.layout, self.layout.joint_names
        for field, array, rows in (
            ("joint_pos", builder.joint_q, layout.coords),
            ("joint_vel", builder.joint_qd, layout.dofs),
        ):
            values = getattr(self.cfg.init_state, field)
            # A ball joint has more coordinates than names: the default for all joints then leaves the file's.
            if not values or not names or (len(rows) != len(names) and set(values) == {".*"}):
                continue
            try:
                for i, value in match_values(values, names, what="joint").items():
                    array[rows[i]] = value
            except ValueError as error:
                yield f"init_state.{field}: {error}"

    def _write_actuators(self, builder: newton.ModelBuilder) -> Iterator[str]:
        """Write the actuator groups; yields what does not fit."""
        layout, names = self.layout, self.layout.joint_names
        owners: dict[int, str] = {}
        self._velocity_limits: dict[int, float] = {}
        for group, actuator in self.cfg.actuators.items():
            try:
                ids = actuator.apply(builder, names, layout.dofs)
                self._velocity_limits |= actuator.limited_velocities(names)
            except ValueError as error:
                yield f"actuators.{group}: {error}"
                continue
            twice = next((i for i in ids if i in owners), None)
            if twice is not None:
                yield f"actuators.{group}: joint '{names[twice]}' is in group '{owners[twice]}' too"
            owners.update(dict.fromkeys(ids, group))

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        self._data = ArticulationData(sim, self.layout, self.cfg.soft_joint_pos_limit_factor)
        start, origins = self.cfg.init_state, torch.from_numpy(sim.env_origins).to(sim.device)
        self._data.set_defaults(start.lin_vel, start.ang_vel, origins)
        self._data.default_joint_pos = self._data.joint_pos.clone()
        self._data.default_joint_vel = self._data.joint_vel.clone()
        for actuator in self.cfg.actuators.values():
            actuator.bind(sim, self.layout.joint_names, self.layout.dofs)
        if self._velocity_limits:
            rows = torch.tensor([self.layout.dofs[i] for i in self._velocity_limits], device=sim.device)
            values = torch.tensor(list(self._velocity_limits.values()), device=sim.device)
            sim.per_env(sim.velocity_limit)[:, rows] = values
            sim.limit_velocities()

    # -- what it is

    @property
    def data(self) -> ArticulationData:
        """State of the articulation."""
        return self._data

    @property
    def native_data(self) -> ArticulationData:
        return self._data

    @cached_property
    def dynamics(self) -> ArticulationDynamics:
        """Jacobians, mass matrices, gravity compensation and joint wrenches."""
        return ArticulationDynamics(self._sim, self.layout)

    @cached_property
    def fixed_tendons(self) -> FixedTendons:
        """Fixed tendons of its file."""
        return FixedTendons(self._sim, self.layout)

    @property
    def is_fixed_base(self) -> bool:
        """Whether the root is fixed to the world."""
        return not self.layout.floating

    @property
    def num_joints(self) -> int:
        """Number of degrees of freedom, without those of a free root."""
        return len(self.layout.joint_names)

    @property
    def joint_names(self) -> list[str]:
        """Names, one a degree of freedom; a joint with several gives ``name:0``, ``name:1``, ..."""
        return list(self.layout.joint_names)

    def find_joints(
        self, name_keys: str | Sequence[str], joint_subset: Sequence[str] | None = None, preserve_order: bool = False
    ) -> tuple[list[int], list[str]]:
        """Indices and names of the joints that match regular expressions.

        Args:
            name_keys: Expressions that must match the whole name.
            joint_subset: Search among these names alone; indices are then into this list.
            preserve_order: In the order of the expressions.

        Raises:
            ValueError: if an expression matches nothing; the message lists what there is.
        """
        names = self.layout.joint_names if joint_subset is None else joint_subset
        return match_names(name_keys, names, preserve_order, f"joint of '{self.cfg.prim_path}'")

    # -- targets

    def set_joint_position_target(
        self, target: torch.Tensor, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Position targets [m or rad], shape ``(n, joints)``."""
        self._assign(self._data.joint_pos_target, target, joint_ids, env_ids)

    def set_joint_velocity_target(
        self, target: torch.Tensor, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Velocity targets [m/s or rad/s], shape ``(n, joints)``."""
        self._assign(self._data.joint_vel_target, target, joint_ids, env_ids)

    def set_joint_effort_target(self, target: torch.Tensor, joint_ids: JointIds = None, env_ids: EnvIds = None) -> None:
        """Effort targets [N or N m], shape ``(n, joints)``; they add to the drives."""
        self._assign(self._data.joint_effort_target, target, joint_ids, env_ids)

    # -- state

    def write_joint_state_to_sim(
        self, position: torch.Tensor, velocity: torch.Tensor, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set joint positions [m or rad] and velocities [m/s or rad/s], shape ``(n, joints)``."""
        self.write_joint_position_to_sim(position, joint_ids, env_ids)
        self.write_joint_velocity_to_sim(velocity, joint_ids, env_ids)

    def write_joint_position_to_sim(
        self, position: torch.Tensor, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set joint positions [m or rad], shape ``(n, joints)``."""
        self._assign(self._data.joint_pos, position, joint_ids, env_ids)

    def write_joint_velocity_to_sim(
        self, velocity: torch.Tensor, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set joint velocities [m/s or rad/s], shape ``(n, joints)``; accelerations restart from zero."""
        self._assign(self._data.joint_vel, velocity, joint_ids, env_ids)
        # Else the next acceleration would be the difference between two episodes.
        self._assign(self._data._previous_vel, velocity, joint_ids, env_ids)

    # -- properties

    def write_joint_stiffness_to_sim(
        self, stiffness: JointValues, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set the position gains, implicit or explicit [N/m or N m/rad]."""
        self._change(self._data.joint_stiffness, stiffness, joint_ids, env_ids, "JOINT_DOF_FORCE_PROPERTIES")

    def write_joint_damping_to_sim(
        self, damping: JointValues, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set the velocity gains, implicit or explicit [N s/m or N m s/rad]."""
        self._change(self._data.joint_damping, damping, joint_ids, env_ids, "JOINT_DOF_FORCE_PROPERTIES")

    def write_joint_effort_limit_to_sim(
        self, limits: JointValues, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set the largest efforts [N or N m]."""
        self._change(self._data.joint_effort_limits, limits, joint_ids, env_ids, "JOINT_DOF_FORCE_PROPERTIES")

    def write_joint_armature_to_sim(
        self, armature: JointValues, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set the inertia added to the joints [kg or kg m^2]."""
        self._change(self._data.joint_armature, armature, joint_ids, env_ids, "JOINT_DOF_INERTIAL_PROPERTIES")

    def write_joint_friction_coefficient_to_sim(
        self, friction: JointValues, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set the Coulomb friction of the joints [N or N m]."""
        self._change(self._data.joint_friction_coeff, friction, joint_ids, env_ids, "JOINT_DOF_FORCE_PROPERTIES")

    def write_joint_position_limit_to_sim(
        self, limits: torch.Tensor, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set lower and upper limits [m or rad], shape ``(n, joints, 2)``."""
        self._assign(self._data._lower, limits[..., 0], joint_ids, env_ids)
        self._change(self._data._upper, limits[..., 1], joint_ids, env_ids, "JOINT_DOF_FORCE_PROPERTIES")

    # -- episodes

    def reset(self, env_ids: EnvIds = None) -> None:
        """Remove external forces and bring the targets back to the default joint state."""
        ids = self.env_indices(env_ids)
        data = self._data
        data.joint_pos_target[ids] = data.default_joint_pos[ids]
        data.joint_vel_target[ids] = data.default_joint_vel[ids]
        data.joint_effort_target[ids] = 0.0
        self._clear_wrench(ids)

    def _assign(self, buffer: torch.Tensor, value: JointValues, joint_ids: JointIds, env_ids: EnvIds) -> None:
        """``buffer[env_ids, joint_ids] = value``; without ids a plain copy."""
        if joint_ids is None and env_ids is None:
            buffer[:] = value
        elif env_ids is None:
            buffer[:, joint_ids] = value
        elif joint_ids is None:
            buffer[self.env_indices(env_ids)] = value
        else:
            columns = torch.arange(buffer.shape[1], device=self.device)[joint_ids]
            buffer[self.env_indices(env_ids).unsqueeze(1), columns] = value

    def _change(
        self, buffer: torch.Tensor, value: JointValues, joint_ids: JointIds, env_ids: EnvIds, flag: str
    ) -> None:
        self._assign(buffer, value, joint_ids, env_ids)
        self._sim.refresh_drives()  # solvers without drive modes see masked copies of the gains
        self._sim.notify(newton.ModelFlags[flag])
