# SPDX-License-Identifier: Apache-2.0
"""Scene controller: changes a built scene, by targets, resets and dynamics."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import newton
import torch

from stripe_newton.assets import Articulation, BoundAsset

from .scene_contents import SceneContents

if TYPE_CHECKING:
    from stripe_newton.assets.asset_base import EnvIds

__all__ = ["SceneController"]

Range = tuple[float, float] | None
"""Bounds of a uniform distribution; ``None`` leaves the quantity alone."""


class SceneController:
    """Changes the state and the dynamics of a built scene, everywhere or in some environments."""

    def __init__(self, scene: SceneContents):
        self._scene = scene
        self._defaults: dict[str, torch.Tensor] = {}

    def apply_actions(self, targets: Mapping[str, Mapping[str, torch.Tensor]] | None = None) -> None:
        """Set joint targets and hand over what assets have pending; call it before a physics step.

        Args:
            targets: By articulation, then by ``"position"``, ``"velocity"`` or ``"effort"``, tensors of shape
                ``(num_envs, num_joints)`` in the units of ``set_joint_*_target``.

        Raises:
            KeyError: for an articulation or a kind of target that does not exist.
        """
        for name, kinds in (targets or {}).items():
            if name not in self._scene.articulations:
                raise KeyError(
                    f"no articulation '{name}'; the scene has {', '.join(self._scene.articulations) or 'none'}"
                )
            for kind, value in kinds.items():
                if kind not in ("position", "velocity", "effort"):
                    raise KeyError(f"no target '{kind}' of '{name}'; there are position, velocity and effort")
                getattr(self._scene.articulations[name], f"set_joint_{kind}_target")(value)
        # Targets are written at once, so this does nothing for assets of this package; a subclass may gather its own.
        for asset in self._scene.assets:
            asset.write_data_to_sim()

    def reset_robots(self, env_ids: EnvIds = None, to_default: bool = True) -> None:
        """Begin new episodes: default state, targets and external forces cleared, solver memory cleared.

        Args:
            env_ids: Environments, default all.
            to_default: Also write the default state of articulations and rigid objects.
        """
        scene, sim = self._scene, self._scene.sim
        mask = self.mask(env_ids)
        ids = mask.nonzero().squeeze(-1) if env_ids is not None else None
        for asset in scene.assets:
            asset.reset(ids)
        for sensor in scene.sensors.values():
            sensor.reset(ids)
        if to_default:
            bound: list[BoundAsset] = [*scene.articulations.values(), *scene.rigid_objects.values()]
            for asset in bound:
                rows = asset.env_indices(ids)
                state = asset.data.default_root_state[rows].clone()
                state[:, :3] += scene.env_origins[rows]
                asset.write_root_state_to_sim(state, rows)
                if isinstance(asset, Articulation):
                    joints = asset.data.default_joint_pos[rows], asset.data.default_joint_vel[rows]
                    asset.write_joint_state_to_sim(*joints, env_ids=rows)
        sim.clear_solver(mask)

    def mask(self, env_ids: EnvIds = None) -> torch.Tensor:
        """``env_ids`` as a mask: bool, shape ``(num_envs,)``."""
        if env_ids is None:
            return torch.ones(self._scene.num_envs, dtype=torch.bool, device=self._scene.device)
        mask = torch.zeros(self._scene.num_envs, dtype=torch.bool, device=self._scene.device)
        mask[torch.as_tensor(env_ids, device=mask.device) if not isinstance(env_ids, slice) else env_ids] = True
        return mask

    def randomize_dynamics(
        self,
        env_ids: EnvIds = None,
        *,
        mass_scale: Range = None,
        friction: Range = None,
        stiffness_scale: Range = None,
        damping_scale: Range = None,
        armature_scale: Range = None,
        generator: torch.Generator | None = None,
    ) -> None:
        """Draw new dynamics, uniformly within the given ranges, always from the values the model was built with.

        Args:
            env_ids: Environments, default all.
            mass_scale: Factor on each body's mass and inertia.
            friction: Friction coefficient of each shape in the environments.
            stiffness_scale: Factor on each drive's position gain.
            damping_scale: Factor on each drive's velocity gain.
            armature_scale: Factor on each joint's armature.
            generator: Source of randomness, default torch's.

        Raises:
            ValueError: for a range that is reversed or would make a quantity negative.
        """
        flags = newton.ModelFlags
        rows = self.mask(env_ids).nonzero().squeeze(-1)

        def draw(bounds: tuple[float, float], like: torch.Tensor, what: str) -> torch.Tensor:
            low, high = bounds
            if not 0.0 <= low <= high:
                raise ValueError(f"{what}: range {bounds} must be (low, high) with 0 <= low <= high")
            unit = torch.rand(like.shape[:2], generator=generator, device=like.device)
            return low + (high - low) * unit

        changed = 0
        if mass_scale is not None:
            mass, default = self._field("body_mass")
            scale = draw(mass_scale, default[rows], "mass_scale")
            mass[rows] = default[rows] * scale
            for name, power in (("body_inv_mass", -1), ("body_inertia", 1), ("body_inv_inertia", -1)):
                field, default = self._field(name)
                factor = scale**power
                field[rows] = default[rows] * factor.view(*factor.shape, *[1] * (default.dim() - 2))
            changed |= flags.BODY_INERTIAL_PROPERTIES
        if friction is not None:
            field, default = self._field("shape_material_mu")
            field[rows] = draw(friction, default[rows], "friction")
            changed |= flags.SHAPE_PROPERTIES
        for name, bounds, flag in (
            ("joint_target_ke", stiffness_scale, flags.JOINT_DOF_FORCE_PROPERTIES),
            ("joint_target_kd", damping_scale, flags.JOINT_DOF_FORCE_PROPERTIES),
            ("joint_armature", armature_scale, flags.JOINT_DOF_INERTIAL_PROPERTIES),
        ):
            if bounds is not None:
                field, default = self._field(name)
                field[rows] = default[rows] * draw(bounds, default[rows], name)
                changed |= flag
        if changed:
            self._scene.sim.refresh_drives()
            self._scene.sim.notify(changed)

    @property
    def randomized(self) -> list[str]:
        """Fields of the model that were randomised."""
        return list(self._defaults)

    def track(self, name: str) -> None:
        """Remember a field of the model as it was built, before it is changed elsewhere."""
        self._field(name)

    def field(self, name: str) -> tuple[torch.Tensor, torch.Tensor]:
        """A field of the model by environment, the model's memory, and its values as the model was built.

        Shapes are ``(num_envs, n, ...)``. The field counts among :attr:`randomized` from then on.
        """
        return self._field(name)

    def _field(self, name: str) -> tuple[torch.Tensor, torch.Tensor]:
        """A field of the model by environment, and its values as built."""
        sim = self._scene.sim
        shared = sim.shared_shape_count if name.startswith("shape") else 0
        array = getattr(sim.model, name)
        if name == "gravity":  # its last entry is for what belongs to no environment
            array = array[: sim.num_envs]
        field = sim.per_env(array, shared)
        # Cloned at the first call, before anything changed: what is drawn always starts from the values as built.
        return field, self._defaults.setdefault(name, field.clone())
