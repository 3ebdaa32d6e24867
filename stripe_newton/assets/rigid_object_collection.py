# SPDX-License-Identifier: Apache-2.0
"""Rigid object collection: several rigid objects in every environment, read and written by one tensor."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import ClassVar

import torch

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.matching import match_names

from .asset_base import EnvIds
from .rigid_object import RigidObject, RigidObjectCfg
from .root_data import RootData

__all__ = ["RigidObjectCollection", "RigidObjectCollectionCfg", "RigidObjectCollectionData"]

ObjectIds = Sequence[int] | torch.Tensor | slice | None
"""Objects by index; ``None`` means all."""


def _collection(cfg: RigidObjectCollectionCfg) -> RigidObjectCollection:
    return RigidObjectCollection(cfg)


@configclass
class RigidObjectCollectionCfg:
    """Several rigid objects in every environment.

    In a scene's config each object also has a name of its own, ``NAME_KEY``, by which terms and resets find it.
    """

    MAY_BE_NONE: ClassVar[bool] = True

    rigid_objects: dict[str, RigidObjectCfg] = MISSING
    """The objects by name."""
    class_type: Callable[..., RigidObjectCollection] | None = _collection
    """Class that the scene makes of this config."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if self.rigid_objects is not MISSING and not self.rigid_objects:
            yield "rigid_objects", "is empty, must have an object at least"


class RigidObjectCollectionData:
    """State of all objects of a collection, shape ``(num_envs, num_objects, ...)``.

    ``object_NAME`` is the field ``root_NAME`` of each object's :class:`RootData`, or ``body_NAME`` where there is no
    such: ``object_link_pose_w``, ``object_com_vel_w``, ``object_state_w``, ``object_com_acc_w`` and so on. Other fields
    go by their own names: ``default_mass``, ``projected_gravity_b``, ``heading_w``. The tensors are copies: write
    by the ``write_object_*_to_sim`` methods.
    """

    def __init__(self, objects: Mapping[str, RigidObject]):
        self._objects = dict(objects)
        self.object_names = list(objects)
        """Names of the objects."""
        # Kept, unlike the rest: events of a user's change it in place.
        self.default_object_state = self._stack("default_root_state")
        """State at the start of an episode, relative to the environment's origin, shape ``(num_envs, objects, 13)``."""

    @property
    def default_inertia(self) -> torch.Tensor:
        """Inertia about the centres of mass [kg m^2], link frames, shape ``(num_envs, num_objects, 9)``."""
        return self._stack("body_inertia").flatten(start_dim=-2)

    def _stack(self, name: str) -> torch.Tensor:
        return torch.stack([_of_one(getattr(o.native_data, name), name) for o in self._objects.values()], dim=1)

    def __getattr__(self, name: str) -> torch.Tensor:
        if name.startswith("_") or not self.__dict__.get("_objects"):  # asked for by copies and unpickling
            raise AttributeError(name)
        kind, _, rest = name.partition("_")
        names = (f"root_{rest}", f"body_{rest}") if kind == "object" else (name, f"body_{name}")
        for other in names:
            if hasattr(RootData, other) or other in vars(next(iter(self._objects.values())).native_data):
                return self._stack(other)
        raise AttributeError(f"a collection of rigid objects has no '{name}', as an object has none of {names}")


def _of_one(value: torch.Tensor, name: str) -> torch.Tensor:
    """The value of an asset's only body, shape ``(num_envs, ...)``."""
    return value.squeeze(1) if name.startswith("body_") else value


class RigidObjectCollection:
    """Several rigid objects in every environment; their state is in :attr:`data`.

    Values of methods that write have the shape ``(n, objects, ...)``, for ``n`` environments and the objects of
    ``object_ids``, or one that is broadcast to it.

    Attributes:
        objects: The objects by name.
    """

    def __init__(self, cfg: RigidObjectCollectionCfg):
        """Spawn the objects into the scene under construction."""
        cfg.validate()
        self.cfg = cfg.copy()
        self.objects: dict[str, RigidObject] = {}
        for name, one in self.cfg.rigid_objects.items():
            made = (one.class_type or RigidObject)(one)
            assert isinstance(made, RigidObject)
            self.objects[name] = made
        self._made_data: RigidObjectCollectionData | None = None

    # -- what it is

    @property
    def data(self) -> RigidObjectCollectionData:
        """State of the objects, once the scene is built."""
        return self.native_data

    @property
    def native_data(self) -> RigidObjectCollectionData:
        """State with quaternions (x, y, z, w), also where a subclass hands out another form as ``data``."""
        if self._made_data is None:
            self._made_data = RigidObjectCollectionData(self.objects)
        return self._made_data

    @property
    def num_instances(self) -> int:
        """Number of environments."""
        return self._first.num_instances

    @property
    def num_objects(self) -> int:
        """Number of objects in an environment."""
        return len(self.objects)

    @property
    def object_names(self) -> list[str]:
        """Names of the objects."""
        return list(self.objects)

    @property
    def device(self) -> str:
        """Device of the simulation."""
        return self._first.device

    def names_of(self, kind: str) -> list[str] | None:
        """Names among which terms choose bodies (``kind="body"``), the objects; None for joints, of which it has none.

        Args:
            kind: ``"body"`` or ``"joint"``.
        """
        return self.object_names if kind == "body" else None

    def find_objects(
        self, name_keys: str | Sequence[str], preserve_order: bool = False
    ) -> tuple[torch.Tensor, list[str]]:
        """Indices, int64, and names of the objects that match regular expressions.

        Raises:
            ValueError: if an expression matches nothing.
        """
        ids, names = match_names(name_keys, self.object_names, preserve_order, "object of the collection")
        return torch.tensor(ids, device=self.device), names

    @property
    def _first(self) -> RigidObject:
        return next(iter(self.objects.values()))

    def _chosen(self, object_ids: ObjectIds) -> list[RigidObject]:
        every = list(self.objects.values())
        if object_ids is None or isinstance(object_ids, slice):
            return every[slice(None) if object_ids is None else object_ids]
        return [every[int(i)] for i in object_ids]

    def _each(
        self, value: torch.Tensor, env_ids: EnvIds, object_ids: ObjectIds
    ) -> Iterator[tuple[RigidObject, torch.Tensor]]:
        """The chosen objects, each with its part of a value.

        Raises:
            ValueError: for a value of another shape.
        """
        chosen = self._chosen(object_ids)
        rows = len(self._first.env_indices(env_ids))
        try:
            every = value.expand(rows, len(chosen), -1)
        except RuntimeError as error:
            wanted = f"({rows}, {len(chosen)}, {value.shape[-1]}): environments, objects"
            raise ValueError(f"got a value of the shape {tuple(value.shape)}, must be {wanted}") from error
        yield from zip(chosen, every.unbind(dim=1), strict=True)

    # -- state; in the world frame

    def write_object_state_to_sim(
        self, object_state: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set poses of the links and velocities of the centres of mass, shape ``(n, objects, 13)``."""
        for one, state in self._each(object_state, env_ids, object_ids):
            one.write_root_state_to_sim(state, env_ids)

    def write_object_link_state_to_sim(
        self, object_state: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set poses and velocities of the links, shape ``(n, objects, 13)``."""
        for one, state in self._each(object_state, env_ids, object_ids):
            one.write_root_link_state_to_sim(state, env_ids)

    def write_object_com_state_to_sim(
        self, object_state: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set poses and velocities of the centres of mass, shape ``(n, objects, 13)``."""
        for one, state in self._each(object_state, env_ids, object_ids):
            one.write_root_com_state_to_sim(state, env_ids)

    def write_object_pose_to_sim(
        self, object_pose: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set poses of the links: positions [m] and quaternions, shape ``(n, objects, 7)``."""
        self.write_object_link_pose_to_sim(object_pose, env_ids, object_ids)

    def write_object_link_pose_to_sim(
        self, object_pose: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set poses of the links: positions [m] and quaternions, shape ``(n, objects, 7)``."""
        for one, pose in self._each(object_pose, env_ids, object_ids):
            one.write_root_link_pose_to_sim(pose, env_ids)

    def write_object_com_pose_to_sim(
        self, object_pose: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set poses of the centres of mass: positions [m] and quaternions, shape ``(n, objects, 7)``."""
        for one, pose in self._each(object_pose, env_ids, object_ids):
            one.write_root_com_pose_to_sim(pose, env_ids)

    def write_object_velocity_to_sim(
        self, object_velocity: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set velocities of the centres of mass: linear [m/s] and angular [rad/s], shape ``(n, objects, 6)``."""
        self.write_object_com_velocity_to_sim(object_velocity, env_ids, object_ids)

    def write_object_com_velocity_to_sim(
        self, object_velocity: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set velocities of the centres of mass: linear [m/s] and angular [rad/s], shape ``(n, objects, 6)``."""
        for one, velocity in self._each(object_velocity, env_ids, object_ids):
            one.write_root_com_velocity_to_sim(velocity, env_ids)

    def write_object_link_velocity_to_sim(
        self, object_velocity: torch.Tensor, env_ids: EnvIds = None, object_ids: ObjectIds = None
    ) -> None:
        """Set velocities of the link origins: linear [m/s] and angular [rad/s], shape ``(n, objects, 6)``."""
        for one, velocity in self._each(object_velocity, env_ids, object_ids):
            one.write_root_link_velocity_to_sim(velocity, env_ids)

    # -- forces and episodes

    def set_external_force_and_torque(
        self,
        forces: torch.Tensor,
        torques: torch.Tensor,
        positions: torch.Tensor | None = None,
        object_ids: ObjectIds = None,
        env_ids: EnvIds = None,
        is_global: bool = False,
    ) -> None:
        """Set the wrenches that act from the next step on, until a reset or the next call.

        Args:
            forces: Forces at the centres of mass, or at ``positions`` [N], shape ``(n, objects, 3)``.
            torques: Torques [N m], same shape.
            positions: Points of attack relative to the centres of mass [m], same shape.
            object_ids: Objects, default all.
            env_ids: Environments, default all.
            is_global: In the world frame; otherwise in the links' frames.
        """
        torque_of = dict(self._each(torques, env_ids, object_ids))
        point_of = {} if positions is None else dict(self._each(positions, env_ids, object_ids))
        for one, force in self._each(forces, env_ids, object_ids):
            point = point_of[one].unsqueeze(1) if point_of else None
            wrench = force.unsqueeze(1), torque_of[one].unsqueeze(1), point
            one.set_external_force_and_torque(*wrench, env_ids=env_ids, is_global=is_global)

    def reset(self, env_ids: EnvIds = None, object_ids: ObjectIds = None) -> None:
        """Remove external forces."""
        for one in self._chosen(object_ids):
            one.reset(env_ids)

    def write_data_to_sim(self) -> None:
        """Write what was set since the last step to the simulation."""
        for one in self.objects.values():
            one.write_data_to_sim()

    def update(self, dt: float) -> None:
        """Do nothing: data are computed when they are asked for."""
