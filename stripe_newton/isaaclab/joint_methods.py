# SPDX-License-Identifier: Apache-2.0
"""Methods and properties of an articulation's joints by Isaac Lab's names."""

from __future__ import annotations

from functools import cached_property

import torch

from stripe_newton import assets as native
from stripe_newton.assets.articulation import JointIds, JointValues
from stripe_newton.assets.root_writer import EnvIds

from .actuator_groups import ActuatorGroup

__all__ = ["JointMethods"]


class JointMethods(native.Articulation):
    """Isaac Lab's methods of joints, and its groups of actuators."""

    has_debug_vis_implementation = False

    @cached_property
    def actuators(self) -> dict[str, ActuatorGroup]:
        """Groups of actuators by name."""
        return {name: ActuatorGroup(cfg, self.native_data) for name, cfg in self.cfg.actuators.items()}

    @property
    def is_initialized(self) -> bool:
        """Whether the scene is built."""
        return "_data" in self.__dict__

    def set_debug_vis(self, debug_vis: bool) -> bool:
        """Do nothing: an articulation draws no markers. Returns False, as in Isaac Lab."""
        return False

    def write_joint_velocity_limit_to_sim(
        self, limits: JointValues, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set the speeds that joints are held to after each physics step [m/s or rad/s]."""
        sim = self._sim
        dofs = self.layout.dofs
        self._assign(sim.per_env(sim.velocity_limit)[:, dofs.start : dofs.stop], limits, joint_ids, env_ids)
        sim.limit_velocities()
        self._assign(self.native_data.joint_vel_limits, limits, joint_ids, env_ids)

    def write_joint_viscous_friction_coefficient_to_sim(
        self, friction: JointValues, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """Set the passive damping of the joints [N s/m or N m s/rad]."""
        self._change(
            self.native_data.joint_viscous_friction_coeff, friction, joint_ids, env_ids, "JOINT_DOF_FORCE_PROPERTIES"
        )

    def write_joint_friction_to_sim(
        self, friction: JointValues, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """An older name of ``write_joint_friction_coefficient_to_sim``."""
        self.write_joint_friction_coefficient_to_sim(friction, joint_ids, env_ids)

    def write_joint_limits_to_sim(
        self, limits: torch.Tensor, joint_ids: JointIds = None, env_ids: EnvIds = None
    ) -> None:
        """An older name of ``write_joint_position_limit_to_sim``."""
        self.write_joint_position_limit_to_sim(limits, joint_ids, env_ids)
