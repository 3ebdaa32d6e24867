# SPDX-License-Identifier: Apache-2.0
"""Scene controller: changes a built scene, by targets, resets and dynamics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
import warp as wp

from stripe_kernels import dynamics
from stripe_kernels.episode import seed_streams
from stripe_kernels.mdp.randomization import KEEP
from stripe_kernels.model_data import BodyModelData, JointModelData, ShapeModelData
from stripe_newton.assets import Articulation, BoundAsset
from stripe_newton.assets.layout import Layout
from stripe_newton.fusion.warp_types import Struct, dtype_of
from stripe_newton.sim.model_update import model_flags

from .model_fields import MODEL_FIELDS
from .scene_contents import SceneContents

if TYPE_CHECKING:
    from stripe_newton.assets.asset_base import EnvIds

__all__ = ["SceneController"]

Bounds = tuple[float, float]
Range = Bounds | None
"""Bounds of a uniform distribution; ``None`` leaves the quantity alone."""

_MASSES = ("mass", "inv_mass", "inertia", "inv_inertia")
_LIMITS = ("lower", "upper")


class SceneController:
    """Changes the state and the dynamics of a built scene, everywhere or in some environments."""

    def __init__(self, scene: SceneContents):
        self._scene = scene
        self._defaults: dict[str, torch.Tensor] = {}
        self.process_actions: Callable[[torch.Tensor], object] | None = None
        """Function that sets targets from a policy's actions: that of the scene's action manager, if it has one."""
        self.randomize_by_events: Callable[[Sequence[int] | torch.Tensor | None], None] | None = None
        """Function that runs the events that change the dynamics, if the scene has an event manager with such terms."""

    def apply_actions(
        self, actions: torch.Tensor | Mapping[str, Mapping[str, torch.Tensor]] | None = None, kind: str = "position"
    ) -> None:
        """Set joint targets and hand over what assets have pending; call it before a physics step.

        Args:
            actions: A tensor of actions as a policy gives them, shape ``(num_envs, num_actions)``, where the scene has
                an action manager; else targets of the joints of the only articulation, ``(num_envs, num_joints)``. Or
                a dict by articulation, then by ``"position"``, ``"velocity"`` or ``"effort"``, of such targets.
            kind: Kind of the targets, if ``actions`` is a tensor of them. Units are those of ``set_joint_*_target``.

        Raises:
            KeyError: for an articulation or a kind of target that does not exist, or if not one articulation alone is
                there for a tensor.
        """
        if isinstance(actions, torch.Tensor) and self.process_actions is not None:
            self.process_actions(actions)
        elif isinstance(actions, torch.Tensor):
            robots = list(self._scene.articulations)
            if len(robots) != 1:
                raise KeyError(f"the scene has {', '.join(robots) or 'no articulation'}; give a dict by name")
            self._set_targets(robots[0], {kind: actions})
        else:
            for name, kinds in (actions or {}).items():
                self._set_targets(name, kinds)
        # Targets are written at once, so this does nothing for assets of this package; a subclass may gather its own.
        for asset in self._scene.assets:
            asset.write_data_to_sim()

    def _set_targets(self, name: str, kinds: Mapping[str, torch.Tensor]) -> None:
        robots = self._scene.articulations
        if name not in robots:
            raise KeyError(f"no articulation '{name}'; the scene has {', '.join(robots) or 'none'}")
        for kind, value in kinds.items():
            if kind not in ("position", "velocity", "effort"):
                raise KeyError(f"no target '{kind}' of '{name}'; there are position, velocity and effort")
            getattr(robots[name], f"set_joint_{kind}_target")(value)

    def reset_robots(self, env_ids: EnvIds = None, to_default: bool = True) -> None:
        """Begin new episodes: default state, targets and external forces cleared, solver memory cleared.

        Args:
            env_ids: Environments, default all.
            to_default: Also write the default state of all assets with bodies.
        """
        scene, sim = self._scene, self._scene.sim
        mask = self.mask(env_ids)
        # The mask as indices, for torch code: given indices are taken over without a wait for the device.
        ids = None if env_ids is None else self._indices(env_ids)
        for asset in scene.assets:
            asset.reset(ids)
        for sensor in scene.sensors.values():
            sensor.reset(ids)
        if to_default:
            # Of all assets, also those that a script or an environment keeps to itself, without a name in the scene.
            for asset in scene.assets:
                if not isinstance(asset, BoundAsset):
                    continue
                rows = asset.env_indices(ids)
                state = asset.native_data.default_root_state[rows].clone()
                state[:, :3] += scene.env_origins[rows]
                asset.write_native_root_state(state[:, :7], state[:, 7:], rows)
                if isinstance(asset, Articulation):
                    joints = asset.native_data.default_joint_pos[rows], asset.native_data.default_joint_vel[rows]
                    asset.write_joint_state_to_sim(*joints, env_ids=rows)
        sim.clear_solver(mask)

    def mask(self, env_ids: EnvIds = None) -> torch.Tensor:
        """``env_ids`` as a mask: bool, shape ``(num_envs,)``."""
        if env_ids is None:
            return torch.ones(self._scene.num_envs, dtype=torch.bool, device=self._scene.device)
        mask = torch.zeros(self._scene.num_envs, dtype=torch.bool, device=self._scene.device)
        mask[self._indices(env_ids)] = True
        return mask

    def _indices(self, env_ids: Sequence[int] | torch.Tensor | slice) -> torch.Tensor:
        """Environments as indices from 0 on, int64, shape ``(n,)``."""
        every = torch.arange(self._scene.num_envs, device=self._scene.device)
        return every[env_ids if isinstance(env_ids, slice) else torch.as_tensor(env_ids, device=every.device)]

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

        Without a range the scene's events say what is drawn, those of all modes that change the model.

        The draws are those of the events ``randomize_rigid_body_mass``, ``randomize_rigid_body_material``,
        ``randomize_actuator_gains`` and ``randomize_joint_parameters`` of :mod:`stripe_kernels.mdp`, for all bodies,
        shapes and joints.

        Args:
            env_ids: Environments, default all.
            mass_scale: Factor on each body's mass and inertia; a body that has mass keeps at least 1e-6 kg.
            friction: Friction coefficient of each shape in the environments.
            stiffness_scale: Factor on each drive's position gain.
            damping_scale: Factor on each drive's velocity gain.
            armature_scale: Factor on each joint's armature.
            generator: Source of randomness, default torch's on the CPU.

        Raises:
            ValueError: for a range that is reversed or would make a quantity negative, or if there is neither a range
                nor an event.
        """
        ranges = {
            "mass_scale": mass_scale,
            "friction": friction,
            "stiffness_scale": stiffness_scale,
            "damping_scale": damping_scale,
            "armature_scale": armature_scale,
        }
        given = {name: bounds for name, bounds in ranges.items() if bounds is not None}
        for name, (low, high) in given.items():
            if not 0.0 <= low <= high < math.inf:
                raise ValueError(f"{name}: range {(low, high)} must be (low, high) with 0 <= low <= high, both finite")
        if not given:
            if self.randomize_by_events is None:
                text = f"no event of the scene changes dynamics; give a range: {', '.join(ranges)}"
                raise ValueError(f"randomize_dynamics: {text}")
            self.randomize_by_events(None if env_ids is None else self._indices(env_ids))
            return
        sim = self._scene.sim
        with wp.ScopedDevice(sim.device):
            draw = _Draw(self, self.mask(env_ids), generator)
            if mass_scale is not None:
                draw.launch(dynamics.scale_masses, BodyModelData, _MASSES, mass_scale)
            if friction is not None:
                draw.launch(dynamics.set_friction, ShapeModelData, ("friction",), friction)
            gains = {"stiffness": stiffness_scale, "damping": damping_scale}
            scaled = [name for name, bounds in gains.items() if bounds is not None]
            if scaled:
                draw.launch(dynamics.scale_gains, JointModelData, scaled, *(b or KEEP for b in gains.values()))
            if armature_scale is not None:
                # The event reads the limits, too, and writes them back as they are.
                draw.launch(dynamics.scale_armatures, JointModelData, ("armature",), armature_scale, reads=_LIMITS)
        sim.refresh_drives()
        sim.notify(model_flags(draw.changed))

    @property
    def randomized(self) -> list[str]:
        """Fields of the model that were randomised."""
        return list(self._defaults)

    def track(self, name: str) -> None:
        """Remember a field of the model as it was built, before it is changed elsewhere."""
        self.field(name)

    def field(self, name: str) -> tuple[torch.Tensor, torch.Tensor]:
        """A field of the model by environment, the model's memory, and its values as the model was built.

        Shapes are ``(num_envs, n, ...)``. The field counts among :attr:`randomized` from then on.
        """
        field = self._by_env(name)
        # Cloned at the first call, before anything changed: what is drawn always starts from the values as built.
        return field, self._defaults.setdefault(name, field.clone())

    def _by_env(self, name: str) -> torch.Tensor:
        sim = self._scene.sim
        array = getattr(sim.model, name)
        if name == "gravity":  # its last entry is for what belongs to no environment
            array = array[: sim.num_envs]
        return sim.per_env(array, sim.shared_shape_count if name.startswith("shape") else 0)

    def model_array(self, kind: Struct, field: str, layout: Layout | None = None) -> wp.array:
        """Array of a field of a struct of :mod:`stripe_kernels.model_data`, in the model's memory.

        Args:
            kind: The struct.
            field: The field, such as ``"mass"``, or ``"default_mass"`` for the values as the model was built.
            layout: Rows of the asset whose bodies or joints it holds. Default: all of an environment.

        Raises:
            ValueError: if the bodies of the asset do not lie together in the model.
        """
        is_default = field.startswith("default_")
        values = self.field(MODEL_FIELDS[kind][field.removeprefix("default_")])[is_default]
        if layout is not None and kind in (BodyModelData, JointModelData):
            dofs = slice(layout.dofs.start, layout.dofs.stop)
            rows = layout.body_slice if kind is BodyModelData else dofs
            if not isinstance(rows, slice):
                text = "do not lie together in the model, events cannot change them"
                raise ValueError(f"the bodies of '{layout.path}' {text}")
            values = values[:, rows]
        return wp.from_torch(values, dtype=dtype_of(kind, field))


class _Draw:
    """One call of :meth:`SceneController.randomize_dynamics`: launches, and the fields that they changed."""

    def __init__(self, controller: SceneController, mask: torch.Tensor, generator: torch.Generator | None):
        self._controller = controller
        self._mask = wp.from_torch(mask, dtype=wp.bool)
        self._rng = wp.empty(len(mask), dtype=wp.uint32)
        # On the generator's own device, which need not be that of the scene.
        device = "cpu" if generator is None else generator.device
        seed = int(torch.randint(2**31, (), generator=generator, device=device))
        wp.launch(seed_streams, dim=len(mask), inputs=[seed], outputs=[self._rng])
        self.changed: list[str] = []

    def launch(
        self, kernel: wp.Kernel, kind: Struct, fields: Iterable[str], *ranges: Bounds, reads: Iterable[str] = ()
    ) -> None:
        """Change fields of a struct in all of an environment, where the mask is True.

        Args:
            kernel: Kernel of :mod:`stripe_kernels.dynamics`.
            kind: The struct.
            fields: Fields that it changes, from their defaults.
            ranges: Ranges that it takes.
            reads: Other fields that it needs.
        """
        model, count = kind(), 0
        for field in [*fields, *(f"default_{name}" for name in fields), *reads]:
            array = self._controller.model_array(kind, field)
            setattr(model, field, array)
            count = array.shape[1]
        ids = wp.array(np.arange(count), dtype=int)
        wp.launch(kernel, dim=len(self._mask), inputs=[self._mask, self._rng, model, ids, *map(wp.vec2, ranges)])
        self.changed += [MODEL_FIELDS[kind][field] for field in fields]
