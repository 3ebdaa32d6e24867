# SPDX-License-Identifier: Apache-2.0
"""Object pool: rigid objects that are spawned and retired in each environment."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import torch
import warp as wp

from stripe_kernels.mdp import objects as mdp
from stripe_newton.assets import RigidObject, RigidObjectCfg
from stripe_newton.assets.asset_base import EnvIds
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.fusion import NamedStructs
from stripe_newton.fusion.warp_types import Struct, struct_of
from stripe_newton.scene import InteractiveScene
from stripe_newton.value_types import PositiveInt

from .context import ManagerContext
from .manager_base import terms_of

__all__ = ["ObjectManagerCfg", "ObjectPool", "ObjectPoolCfg", "PoolStructs", "spawn_object_pools"]

_AXES = ("x", "y", "z", "roll", "pitch", "yaw")

Range = dict[str, tuple[float, float]]
"""Bounds by axis: x, y, z, roll, pitch, yaw; (0, 0) for those not named."""


@configclass
class ObjectPoolCfg:
    """Config of a pool of rigid objects that a task spawns, moves and retires, in each environment.

    A simulation cannot add bodies while it runs. All objects exist from the start; those that are not active wait at
    rest high above the environment, where they touch nothing. They cost degrees of freedom but no contacts. Solvers
    allocate their buffers at the start: give ``MuJoCoSolverCfg(nconmax=..., njmax=...)`` room for the contacts of all
    active objects. A box on the ground takes 4 contacts and 16 constraints, a ball 1 and 4.
    """

    MAY_BE_NONE: ClassVar[bool] = True

    objects: dict[str, RigidObjectCfg] | RigidObjectCfg = MISSING
    """The objects by name, or one object of which ``count`` copies are made. ``init_state`` is an object's home."""
    count: PositiveInt = 1
    """Number of copies, if ``objects`` is one config. ``_0``, ``_1``, ... is appended to prim paths and names."""
    spacing: float = 1.0
    """Distance between the homes of copies [m], which form a square about the ``init_state``."""
    respawn: bool = True
    """Retire all objects at a reset and spawn new ones. False leaves that to event terms."""
    num_active: int | tuple[int, int] | None = None
    """Number of objects that a reset spawns, chosen at random: a number, bounds of a random number, or None for all."""
    pose_range: Range | None = None
    """Poses at which a reset spawns objects: x, y [m] in the environment's frame, z [m] above the home, roll, pitch,
    yaw [rad] relative to the home. ``None`` spawns them at their homes."""
    velocity_range: Range = {}
    """Velocity added at a spawn: x, y, z [m/s]; roll, pitch, yaw for rates about x, y, z [rad/s]. It needs
    ``pose_range``."""
    min_distance: float = 0.0
    """Least distance between spawned objects [m]; it needs ``pose_range``."""
    min_robot_distance: float = 0.0
    """Least horizontal distance from the root of the robot [m]; it needs ``pose_range``."""
    robot_name: str = "robot"
    """Robot of ``min_robot_distance``."""
    max_tries: PositiveInt = 16
    """Poses tried for each object; an object for which none keeps the distances stays retired."""
    target_range: Range | None = None
    """Bounds of target poses that a reset draws, as in ``pose_range``. ``None`` keeps the targets, which are the homes
    at first."""
    parking_height: float = 100.0
    """Height above the environment's origin at which retired objects wait [m]. It must be above everything that moves,
    and not below the ground."""

    @property
    def num_objects(self) -> int:
        """Number of objects in an environment."""
        return len(self.objects) if isinstance(self.objects, Mapping) else self.count

    @property
    def num_range(self) -> tuple[int, int]:
        """Least and greatest number that a reset spawns."""
        number = self.num_objects if self.num_active is None else self.num_active
        return (number, number) if isinstance(number, int) else (int(number[0]), int(number[1]))

    def bodies(self, name: str) -> dict[str, RigidObjectCfg]:
        """Configs of the objects by their name in the scene.

        Args:
            name: Name of the pool.
        """
        if isinstance(self.objects, Mapping):
            return dict(self.objects)
        made = {}
        side = math.ceil(math.sqrt(self.count))
        for i in range(self.count):
            copy = self.objects.copy()
            copy.prim_path = f"{copy.prim_path}_{i}"
            x, y, z = copy.init_state.pos or (0.0, 0.0, 0.0)
            dx, dy = (self.spacing * (k - 0.5 * (side - 1)) for k in (i % side, i // side))
            copy.init_state.pos = (x + dx, y + dy, z)
            made[f"{name}_{i}"] = copy
        return made

    def spawn(self, scene: InteractiveScene, name: str) -> dict[str, RigidObject]:
        """Add the bodies to a scene under construction, before its environments are cloned.

        Args:
            scene: The scene.
            name: Name of the pool.
        """
        self.validate()
        return scene.builder.build_objects(self.bodies(name))

    def problems(self) -> Iterator[tuple[str, str]]:
        if isinstance(self.objects, Mapping) and self.count != 1:
            yield "count", f"is {self.count}, must be 1 where 'objects' names each object"
        if self.num_objects < 1:
            yield "objects" if isinstance(self.objects, Mapping) else "count", "holds no object, must hold one or more"
        low, high = self.num_range
        if not 0 <= low <= high <= self.num_objects:
            yield "num_active", f"is {self.num_active}, must be from 0 to {self.num_objects}, the objects there are"
        for name in ("pose_range", "velocity_range", "target_range"):
            yield from ((name, text) for text in _range_problems(getattr(self, name)))
        needs: dict[str, object] = {"velocity_range": {}, "min_distance": 0.0, "min_robot_distance": 0.0}
        for name, unused in needs.items():
            if self.pose_range is None and getattr(self, name) != unused:
                yield name, "has no effect without 'pose_range', set that too"
        for name in ("spacing", "min_distance", "min_robot_distance"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0.0):
                yield name, f"is {value}, must be a length [m]"
        if self.max_tries < 1:
            yield "max_tries", f"is {self.max_tries}, must be 1 or more"
        if not math.isfinite(self.parking_height):
            yield "parking_height", f"is {self.parking_height}, must be a height [m]"


@configclass
class ObjectManagerCfg:
    """Config of the object manager: a field for each pool of objects.

    Subclass it, or name them: ``ObjectManagerCfg(NAME=ObjectPoolCfg(...))``.
    """

    OPEN: ClassVar[tuple[type, ...]] = (ObjectPoolCfg,)


class PoolStructs(NamedStructs):
    """Resolver of ``ObjectPoolData``, by ``pool_name``."""

    def __init__(self, kind: Struct):
        super().__init__(kind, ["pool_name"])


class ObjectPool:
    """The objects of one pool in all environments. Tensors are views of the current state.

    Attributes:
        name: Name of the pool.
        cfg: The config.
        names: Names of the objects in the scene, one a slot.
        objects: The objects themselves.
        data: The pool's ``ObjectPoolData``, which terms read.
        struct_name: Name of ``data`` in generated source.
        pose: Poses in the world [m], shape ``(num_envs, num_objects, 7)``.
        vel: Velocities of the centres of mass [m/s, rad/s], shape ``(num_envs, num_objects, 6)``.
        active: Whether an object is spawned, bool, shape ``(num_envs, num_objects)``.
        age: Steps since an active object was spawned, shape ``(num_envs, num_objects)``.
        home: Poses of the configs in the environment's frame [m], shape ``(num_envs, num_objects, 7)``.
        target: Target poses in the environment's frame [m], shape ``(num_envs, num_objects, 7)``.
        parking: Poses of retired objects in the environment's frame [m], shape ``(num_objects, 7)``.
    """

    def __init__(self, name: str, cfg: ObjectPoolCfg, objects: dict[str, RigidObject], context: ManagerContext):
        self.name, self.cfg, self._scene = name, cfg, context.scene
        self.names, self.objects = list(objects), list(objects.values())
        count, sim = len(objects), context.scene.sim
        layouts = [o.layout for o in self.objects]
        self.pose = _rows(sim.per_env(sim.state.joint_q), [x.root_coord for x in layouts], 7)
        self.vel = _rows(sim.per_env(sim.state.joint_qd), [x.root_dof for x in layouts], 6)

        def array(field: str, dtype: type) -> wp.array:
            return context.array(f"objects.{name}.{field}", dtype, count)

        self.data = data = mdp.ObjectPoolData()
        data.pose = wp.from_torch(self.pose, dtype=wp.transform)
        data.vel = wp.from_torch(self.vel, dtype=wp.spatial_vector)
        data.active, data.age, data.written = array("active", wp.bool), array("age", int), array("written", wp.bool)
        data.home_pose, data.home_vel = array("home_pose", wp.transform), array("home_vel", wp.spatial_vector)
        data.target_pose = array("target_pose", wp.transform)
        data.parking_pose = context.shared(f"objects.{name}.parking_pose", wp.transform, count)
        data.env_origin = wp.from_torch(context.scene.env_origins, dtype=wp.vec3)
        self.active, self.age = wp.to_torch(data.active), wp.to_torch(data.age)
        self.home, self.target = wp.to_torch(data.home_pose), wp.to_torch(data.target_pose)
        self.parking = wp.to_torch(data.parking_pose)
        defaults = torch.stack([o.native_data.default_root_state for o in self.objects], dim=1)
        self.home[:], self.target[:] = defaults[..., :7], defaults[..., :7]
        wp.to_torch(data.home_vel)[:] = defaults[..., 7:]
        context.structs.named(struct_of(data), PoolStructs).add(name, data, {"num_objects": count})
        self.struct_name = context.scope.name(name, data)

    @property
    def positions(self) -> torch.Tensor:
        """Positions in the world [m] (view), shape ``(num_envs, num_objects, 3)``."""
        return self.pose[..., :3]

    def spawn(
        self,
        env_ids: EnvIds = None,
        slots: int | Sequence[int] | None = None,
        pose: torch.Tensor | None = None,
        vel: torch.Tensor | None = None,
    ) -> None:
        """Spawn objects. Call it outside a step or in a torch term.

        Args:
            env_ids: Environments, default all.
            slots: Objects by index, default all.
            pose: Poses in the world [m], shape ``(n, m, 7)`` for ``n`` environments and ``m`` slots or one that can be
                broadcast to it; default: the homes.
            vel: Velocities of the centres of mass [m/s, rad/s], shape ``(n, m, 6)``; default: at rest.

        Raises:
            ValueError: for a slot that does not exist.
        """
        rows, columns = self._indices(env_ids, slots)
        if pose is None:
            pose = self.home[rows, columns]
            pose[..., :3] += self._scene.env_origins[rows]
        self._write(rows, columns, pose, 0.0 if vel is None else vel, active=True)

    def retire(self, env_ids: EnvIds = None, slots: int | Sequence[int] | None = None) -> None:
        """Retire objects to their parking places. Call it outside a step or in a torch term.

        Args:
            env_ids: Environments, default all.
            slots: Objects by index, default all.

        Raises:
            ValueError: for a slot that does not exist.
        """
        rows, columns = self._indices(env_ids, slots)
        pose = self.parking[columns].repeat(len(rows), 1, 1)
        pose[..., :3] += self._scene.env_origins[rows]
        self._write(rows, columns, pose, 0.0, active=False)

    def _write(
        self, rows: torch.Tensor, columns: torch.Tensor, pose: torch.Tensor, vel: torch.Tensor | float, active: bool
    ) -> None:
        """Write state and age of objects, and let their bodies follow."""
        self.pose[rows, columns], self.vel[rows, columns] = pose, vel
        self.active[rows, columns], self.age[rows, columns] = active, 0
        self._scene.sim.forward(self._scene.controller.mask(rows.squeeze(-1)))

    def _indices(self, env_ids: EnvIds, slots: int | Sequence[int] | None) -> tuple[torch.Tensor, torch.Tensor]:
        """Environments as a column, slots as a row."""
        count = len(self.names)
        given = [slots] if isinstance(slots, int) else list(range(count) if slots is None else map(int, slots))
        wrong = [s for s in given if not 0 <= s < count]
        if wrong:
            raise ValueError(f"object pool '{self.name}': no slot {wrong[0]}, there are 0 to {count - 1}")
        rows = self.objects[0].env_indices(env_ids)
        return rows.unsqueeze(1), torch.tensor(given, device=rows.device).unsqueeze(0)


def _rows(state: torch.Tensor, starts: list[int], size: int) -> torch.Tensor:
    """``size`` columns from each of evenly spaced ``starts``, as a view: shape ``(num_envs, len(starts), size)``."""
    step = starts[1] - starts[0] if len(starts) > 1 else size
    shape, strides = (len(state), len(starts), size), (state.stride(0), step, 1)
    return state.as_strided(shape, strides, state.storage_offset() + starts[0])


def _range_problems(bounds: Range | None) -> Iterator[str]:
    for axis, pair in (bounds or {}).items():
        if axis not in _AXES:
            yield f"has '{axis}', keys must be among {', '.join(_AXES)}"
        elif len(pair) != 2 or not pair[0] <= pair[1]:
            yield f"has {pair} for '{axis}', must be (low, high) with low <= high"


def spawn_object_pools(cfg: object, scene: InteractiveScene) -> None:
    """Add the bodies of all pools to a scene under construction.

    Args:
        cfg: Config or dict of :class:`ObjectPoolCfg`, as :class:`ObjectManager` takes it, or None.
        scene: The scene.
    """
    for name, pool in terms_of(cfg).items():
        if isinstance(pool, ObjectPoolCfg):
            pool.spawn(scene, name)
