# SPDX-License-Identifier: Apache-2.0
"""``root_physx_view`` of the Isaac Lab dialect: what tasks read from PhysX's view of an asset, from Newton's arrays.

As in PhysX, quaternions are (x, y, z, w), tensors are copies, and properties are on the CPU whatever the device.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace
from typing import TYPE_CHECKING, NoReturn

import newton
import torch
import warp as wp

if TYPE_CHECKING:
    from stripe_newton.assets import Articulation, BoundAsset

__all__ = ["ArticulationView", "RigidBodyView"]

Indices = Sequence[int] | torch.Tensor | None


class _BodyProperties:
    """Masses, inertias, centres of mass and materials of the bodies of an asset."""

    def __init__(self, asset: BoundAsset):
        self._asset, self._sim, self._layout = asset, asset._sim, asset.layout
        builder, collides = self._sim.template, newton.ShapeFlags.COLLIDE_SHAPES
        flags = builder.shape_flags
        self._shapes = [s for b in asset.layout.bodies for s in builder.body_shapes[b] if flags[s] & collides]

    def __getattr__(self, name: str) -> NoReturn:
        there = ", ".join(n for n in dir(type(self)) if not n.startswith("_"))
        raise AttributeError(f"the Isaac Lab dialect's root_physx_view has no '{name}'; it has {there}")

    @property
    def count(self) -> int:
        """Number of environments."""
        return self._sim.num_envs

    @property
    def max_shapes(self) -> int:
        """Number of colliders."""
        return len(self._shapes)

    @property
    def prim_paths(self) -> list[str]:
        """Prim path in each environment."""
        return [self._in_env(self._layout.path, env) for env in range(self.count)]

    @staticmethod
    def _in_env(path: str, env: int) -> str:
        return path.replace("/envs/env_0", f"/envs/env_{env}", 1)

    # -- bodies

    def get_masses(self) -> torch.Tensor:
        """Masses [kg], shape ``(count, bodies)``."""
        return self._asset.native_data.body_mass.cpu().clone()

    def set_masses(self, data: torch.Tensor, indices: Indices = None) -> None:
        """Set the masses of some environments; inertias stay."""
        model, ids = self._sim.model, self._ids(indices)
        values = data.to(self._sim.device)[ids]
        self._rows(model.body_mass)[ids] = values
        self._rows(model.body_inv_mass)[ids] = torch.where(values > 0.0, 1.0 / values, torch.zeros_like(values))
        self._sim.notify(newton.ModelFlags.BODY_INERTIAL_PROPERTIES)

    def get_inv_masses(self) -> torch.Tensor:
        """Inverse masses [1/kg], shape ``(count, bodies)``."""
        return self._rows(self._sim.model.body_inv_mass).cpu()

    def get_inertias(self) -> torch.Tensor:
        """Inertias about the centres of mass in the bodies' frames [kg m^2], shape ``(count, bodies, 9)``."""
        return self._asset.native_data.body_inertia.flatten(-2).cpu().clone()

    def set_inertias(self, data: torch.Tensor, indices: Indices = None) -> None:
        """Set the inertias of some environments."""
        model, ids = self._sim.model, self._ids(indices)
        values = data.to(self._sim.device)[ids].unflatten(-1, (3, 3))
        self._rows(model.body_inertia)[ids] = values
        self._rows(model.body_inv_inertia)[ids] = torch.linalg.pinv(values)
        self._sim.notify(newton.ModelFlags.BODY_INERTIAL_PROPERTIES)

    def get_coms(self) -> torch.Tensor:
        """Centres of mass in the bodies' frames [m], with identity quaternions, shape ``(count, bodies, 7)``."""
        center = self._asset.native_data.body_com_pos_b.cpu()
        return torch.cat((center, torch.tensor([0.0, 0.0, 0.0, 1.0]).expand(*center.shape[:-1], 4)), dim=-1)

    def set_coms(self, data: torch.Tensor, indices: Indices = None) -> None:
        """Set the centres of mass of some environments; orientations have no effect."""
        ids = self._ids(indices)
        self._rows(self._sim.model.body_com)[ids] = data.to(self._sim.device)[ids][..., :3]
        self._sim.notify(newton.ModelFlags.BODY_INERTIAL_PROPERTIES)

    # -- colliders

    def get_material_properties(self) -> torch.Tensor:
        """Static and dynamic friction, which are one number here, and restitution: ``(count, max_shapes, 3)``."""
        friction, restitution = (self._of_shapes(name)[:, self._shapes] for name in ("mu", "restitution"))
        return torch.stack((friction, friction, restitution), dim=-1).cpu()

    def set_material_properties(self, data: torch.Tensor, indices: Indices = None) -> None:
        """Set dynamic friction and restitution of some environments; static friction has no effect."""
        ids = self._ids(indices)
        values = data.to(self._sim.device)[ids]
        shapes = torch.tensor(self._shapes, device=self._sim.device)
        self._of_shapes("mu")[ids.unsqueeze(1), shapes] = values[..., 1]
        self._of_shapes("restitution")[ids.unsqueeze(1), shapes] = values[..., 2]
        self._sim.notify(newton.ModelFlags.SHAPE_PROPERTIES)

    def _of_shapes(self, name: str) -> torch.Tensor:
        sim = self._sim
        return sim.per_env(getattr(sim.model, f"shape_material_{name}"), sim.shared_shape_count)

    # -- helpers

    def _rows(self, array: wp.array) -> torch.Tensor:
        """A view of the bodies' rows of an array of the model."""
        return self._sim.per_env(array)[:, self._layout.body_slice]

    def _ids(self, indices: Indices) -> torch.Tensor:
        return self._asset.env_indices(None if indices is None else torch.as_tensor(indices).to(self._sim.device))


class RigidBodyView(_BodyProperties):
    """View of a rigid body in every environment; values of the body have no axis of bodies."""

    def get_transforms(self) -> torch.Tensor:
        """Poses, shape ``(count, 7)``."""
        return self._asset.native_data.root_pose_w.clone()

    def get_velocities(self) -> torch.Tensor:
        """Linear velocities of the centres of mass and angular velocities, shape ``(count, 6)``."""
        return self._asset.native_data.root_vel_w.clone()

    def get_coms(self) -> torch.Tensor:
        return super().get_coms().squeeze(1)

    def set_coms(self, data: torch.Tensor, indices: Indices = None) -> None:
        super().set_coms(data.unsqueeze(1) if data.dim() == 2 else data, indices)

    def get_inertias(self) -> torch.Tensor:
        return super().get_inertias().squeeze(1)

    def set_inertias(self, data: torch.Tensor, indices: Indices = None) -> None:
        super().set_inertias(data.unsqueeze(1) if data.dim() == 2 else data, indices)


_DOF_PROPERTIES = {
    "stiffnesses": "joint_stiffness",
    "dampings": "joint_damping",
    "armatures": "joint_armature",
    "max_forces": "joint_effort_limit",
    "friction_coefficients": "joint_friction_coefficient",
}
"""Names of PhysX, and of the asset's methods ``write_..._to_sim``."""


class ArticulationView(_BodyProperties):
    """View of an articulation in every environment."""

    _asset: Articulation

    @property
    def max_links(self) -> int:
        """Number of bodies."""
        return self._asset.num_bodies

    @property
    def max_dofs(self) -> int:
        """Number of degrees of freedom of the joints."""
        return self._asset.num_joints

    @property
    def max_fixed_tendons(self) -> int:
        """Number of fixed tendons."""
        return len(self._asset.fixed_tendons)

    @property
    def link_paths(self) -> list[list[str]]:
        """Paths of the bodies in each environment."""
        labels = [self._sim.template.body_label[b] for b in self._layout.bodies]
        return [[self._in_env(label, env) for label in labels] for env in range(self.count)]

    @property
    def dof_paths(self) -> list[list[str]]:
        """Names of the joints below the articulation's path, in each environment."""
        return [[f"{path}/{name}" for name in self._asset.joint_names] for path in self.prim_paths]

    @property
    def shared_metatype(self) -> SimpleNamespace:
        """Numbers and names that all environments share."""
        asset = self._asset
        return SimpleNamespace(
            link_count=asset.num_bodies,
            dof_count=asset.num_joints,
            link_names=asset.body_names,
            dof_names=asset.joint_names,
            fixed_base=asset.is_fixed_base,
        )

    # -- dynamics

    def get_jacobians(self) -> torch.Tensor:
        """Jacobians to the centres of mass, world frame, shape ``(count, links, 6, columns)``.

        Where the base is fixed it has no rows, else there are six columns of the root before those of the joints.
        """
        found = self._asset.dynamics.jacobians()
        return found[:, 1:] if self._asset.is_fixed_base else found

    def get_generalized_mass_matrices(self) -> torch.Tensor:
        """Joint-space inertia, shape ``(count, columns, columns)``."""
        return self._asset.dynamics.mass_matrices()

    def get_gravity_compensation_forces(self) -> torch.Tensor:
        """Efforts that hold the bodies against gravity, shape ``(count, columns)``."""
        return self._asset.dynamics.gravity_compensation()

    def get_link_incoming_joint_force(self) -> torch.Tensor:
        """Wrenches of the joints on their child bodies, in the joints' frames, shape ``(count, links, 6)``."""
        return self._asset.dynamics.incoming_joint_wrenches()

    # -- state

    def get_link_transforms(self) -> torch.Tensor:
        """Poses of the bodies, shape ``(count, links, 7)``."""
        return self._asset.native_data.body_pose_w.clone()

    def get_link_velocities(self) -> torch.Tensor:
        """Linear velocities of the centres of mass and angular velocities, shape ``(count, links, 6)``."""
        return self._asset.native_data.body_vel_w.clone()

    def get_root_transforms(self) -> torch.Tensor:
        """Poses of the roots, shape ``(count, 7)``."""
        return self._asset.native_data.root_pose_w.clone()

    def get_root_velocities(self) -> torch.Tensor:
        """Velocities of the roots, shape ``(count, 6)``."""
        return self._asset.native_data.root_vel_w.clone()

    def get_dof_positions(self) -> torch.Tensor:
        """Joint positions [m or rad], shape ``(count, dofs)``."""
        return self._asset.native_data.joint_pos.clone()

    def get_dof_velocities(self) -> torch.Tensor:
        """Joint velocities [m/s or rad/s], shape ``(count, dofs)``."""
        return self._asset.native_data.joint_vel.clone()

    # -- properties of the joints

    def get_dof_limits(self) -> torch.Tensor:
        """Lower and upper limits [m or rad], shape ``(count, dofs, 2)``."""
        return self._asset.native_data.joint_pos_limits.cpu()

    def set_dof_limits(self, data: torch.Tensor, indices: Indices = None) -> None:
        """Set the limits of some environments."""
        ids = self._ids(indices)
        self._asset.write_joint_position_limit_to_sim(data.to(self._sim.device)[ids], env_ids=ids)

    def get_dof_stiffnesses(self) -> torch.Tensor:
        """Position gains, shape ``(count, dofs)``."""
        return self._asset.native_data.joint_stiffness.cpu().clone()

    def get_dof_dampings(self) -> torch.Tensor:
        """Velocity gains, shape ``(count, dofs)``."""
        return self._asset.native_data.joint_damping.cpu().clone()

    def get_dof_armatures(self) -> torch.Tensor:
        """Inertia added to the joints, shape ``(count, dofs)``."""
        return self._asset.native_data.joint_armature.cpu().clone()

    def get_dof_max_forces(self) -> torch.Tensor:
        """Largest efforts, shape ``(count, dofs)``."""
        return self._asset.native_data.joint_effort_limits.cpu().clone()

    def get_dof_max_velocities(self) -> torch.Tensor:
        """Rated speeds, shape ``(count, dofs)``."""
        return self._asset.native_data.joint_vel_limits.cpu().clone()

    def get_dof_friction_coefficients(self) -> torch.Tensor:
        """Coulomb friction [N or N m], shape ``(count, dofs)``."""
        return self._asset.native_data.joint_friction_coeff.cpu().clone()

    def get_dof_friction_properties(self) -> torch.Tensor:
        """Static and dynamic friction, which are one number here, and viscous friction: ``(count, dofs, 3)``."""
        friction = self.get_dof_friction_coefficients()
        model = self._sim.model
        viscous = self._sim.per_env(model.joint_damping)[:, self._layout.dofs.start : self._layout.dofs.stop].cpu()
        return torch.stack((friction, friction, viscous), dim=-1)


def _setter(name: str, method: str) -> None:
    def set_values(self: ArticulationView, data: torch.Tensor, indices: Indices = None) -> None:
        ids = self._ids(indices)
        getattr(self._asset, f"write_{method}_to_sim")(data.to(self._sim.device)[ids], env_ids=ids)

    set_values.__name__, set_values.__doc__ = f"set_dof_{name}", f"Set :meth:`get_dof_{name}` of some environments."
    setattr(ArticulationView, f"set_dof_{name}", set_values)


for _name, _method in _DOF_PROPERTIES.items():
    _setter(_name, _method)
