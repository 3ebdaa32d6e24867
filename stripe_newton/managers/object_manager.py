# SPDX-License-Identifier: Apache-2.0
"""Object manager: pools of rigid objects that are spawned, retired and tracked while a task runs."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import ClassVar

import torch
import warp as wp

from stripe_kernels.mdp import objects as mdp
from stripe_newton.assets import RigidObject
from stripe_newton.assets.asset_base import EnvIds
from stripe_newton.fusion import Code, Item, NamedStructs, SceneEntityCfg, Section, bind_term, code
from stripe_newton.fusion.warp_types import Struct, struct_of

from .context import ManagerContext
from .manager_base import ManagerBase
from .object_cfg import ObjectPoolCfg

__all__ = ["ObjectManager", "ObjectPool"]

_CLEARANCE = 0.5
"""Gap between objects in the parking place [m]."""


class PoolStructs(NamedStructs):
    """Finds the objects of a pool by ``pool_name``."""

    def __init__(self, kind: Struct):
        super().__init__(kind, ["pool_name"])


class ObjectManager(ManagerBase):
    """Spawns, retires and tracks the objects of pools. A config's fields are :class:`ObjectPoolCfg`.

    The bodies must be in the scene already, by ``ObjectPoolCfg.spawn`` before it was built. Terms get a pool's
    ``ObjectPoolData`` by ``params={"pool_name": "balls"}``. Numbers that a reset uses are parameters below
    ``objects.<pool>``: ``num_range``, ``min_distance``, ``min_robot_distance``, ``max_tries``.

    Attributes:
        pools: The pools by name.
    """

    name: ClassVar[str] = "objects"

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context)
        self.pools: dict[str, ObjectPool] = {}
        for name, pool in self.terms(cfg, ObjectPoolCfg).items():
            found = _find(name, pool, context)
            if found:
                self.pools[name] = ObjectPool(name, pool, found, context)
        self._lay_out_parking()
        self._respawn = [line for pool in self.pools.values() for line in self._respawn_lines(pool)]

    @property
    def active_terms(self) -> list[str]:
        return list(self.pools)

    def __getitem__(self, name: str) -> ObjectPool:
        """A pool by name.

        Raises:
            KeyError: if there is none; the message says what there is.
        """
        if name not in self.pools:
            raise KeyError(f"no object pool '{name}'; there is {', '.join(self.pools) or 'none'}")
        return self.pools[name]

    # -- items

    def reset(self) -> list[Item]:
        """Log how many objects were active, retire them and spawn new ones; after the robots were reset."""
        if not self.pools:
            return []
        return [Section("objects_reset", self._respawn, self.active_terms).only(self.context.is_reset)]

    def update(self) -> list[Item]:
        """Count ages and keep retired objects parked; in every step after resets and events, before ``moved`` is used.

        ``moved`` is set where objects were spawned or retired in the step. A retired object falls for one step and is
        put back: its body's pose, which nothing reads, may be that much off until the next physics step.
        """
        if not self.pools:
            return []
        context = self.context
        moved = context.code("{moved}")
        body = [context.scope.call(mdp.update_objects, "env", pool.struct_name, moved) for pool in self.pools.values()]
        if not context.scene.sim.cfg.solver.reduced_coordinates:  # its state is that of the bodies
            body.append(context.code("{moved}[env] = True"))
        return [Section("objects_update", body, self.active_terms)]

    def _respawn_lines(self, pool: ObjectPool) -> list[Code]:
        context, cfg, where = self.context, pool.cfg, f"{self.name}.{pool.name}"
        count = code("float({})", context.scope.call(mdp.num_active_objects, "env", pool.struct_name))
        lines = [context.log.line(f"Metrics/{pool.name}/active", count, "mean")]
        this: dict[str, object] = {"pool_name": pool.name}
        if cfg.target_range is not None:
            lines += self._call(mdp.sample_object_targets, this | {"pose_range": cfg.target_range}, f"{where}.target")
        if not cfg.respawn:
            return lines
        lines += self._call(mdp.retire_objects, this, where)
        params = this | {"num_range": tuple(map(float, cfg.num_range))}
        if cfg.pose_range is None:
            return lines + self._call(mdp.spawn_objects_at_home, params, where)
        params |= {f: getattr(cfg, f) for f in ("pose_range", "velocity_range", "min_distance", "max_tries")}
        if cfg.min_robot_distance == 0.0:
            return lines + self._call(mdp.spawn_objects_in_region, params, where)
        params |= {"robot": SceneEntityCfg(cfg.robot_name), "min_robot_distance": cfg.min_robot_distance}
        return lines + self._call(mdp.spawn_objects, params, where)

    def _call(self, func: wp.Function, params: Mapping[str, object], where: str) -> list[Code]:
        call = bind_term(self.context, func, params, where, "event")
        return [call.expression()] if call else []

    # -- parking

    def _lay_out_parking(self) -> None:
        """Give each object a place of its own over the environment, farther from the next than both can reach."""
        slots = [(pool, slot) for pool in self.pools.values() for slot in range(len(pool.names))]
        if not slots:
            return
        distance = _CLEARANCE + 2.0 * max(_reach(pool.objects[slot], self.context) for pool, slot in slots)
        side = math.ceil(math.sqrt(len(slots)))
        for index, (pool, slot) in enumerate(slots):
            x, y = (distance * (k - 0.5 * (side - 1)) for k in (index % side, index // side))
            pool.parking[slot] = torch.tensor([x, y, pool.cfg.parking_height, 0.0, 0.0, 0.0, 1.0])

    def __str__(self) -> str:
        rows = []
        for pool in self.pools.values():
            low, high = pool.cfg.num_range
            spawned = "by events" if not pool.cfg.respawn else str(low) if low == high else f"{low} to {high}"
            place = "home" if pool.cfg.pose_range is None else "in a region"
            rows.append(
                (pool.name, len(pool.names), ", ".join(pool.names), spawned, place if pool.cfg.respawn else "-")
            )
        return self.table("Object pools", ("pool", "objects", "names", "spawned at reset", "where"), rows)


class ObjectPool:
    """The objects of one pool, in all environments. Tensors are views: they show the state as it is now.

    Attributes:
        name: Name of the pool.
        cfg: The config.
        names: Names of the objects in the scene, one a slot.
        objects: The objects themselves.
        data: What terms read, an ``ObjectPoolData``.
        struct_name: Name of ``data`` in generated source.
        pose: Poses in the world [m], shape ``(num_envs, num_objects, 7)``.
        vel: Velocities of the centres of mass [m/s, rad/s], shape ``(num_envs, num_objects, 6)``.
        active: Whether an object takes part, bool, shape ``(num_envs, num_objects)``.
        age: Steps since an active object was spawned, shape ``(num_envs, num_objects)``.
        home: Poses of the configs in the environment's frame [m], shape ``(num_envs, num_objects, 7)``.
        target: Where the objects should get to, in the environment's frame [m], same shape.
        parking: Where retired objects wait, in the environment's frame [m], shape ``(num_objects, 7)``.
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
        defaults = torch.stack([o.data.default_root_state for o in self.objects], dim=1)
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
        """Make objects active, outside a step or in a torch term.

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
        """Take objects out, outside a step or in a torch term.

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


def _find(name: str, cfg: ObjectPoolCfg, context: ManagerContext) -> dict[str, RigidObject]:
    """The objects of a pool in the scene; none after a problem."""
    where = f"{ObjectManager.name}.{name}"
    problems = [f"{where}.{field}: {text}" for field, text in cfg.problems()]
    context.problems += problems
    if problems:
        return {}
    there = context.scene.rigid_objects
    names = list(cfg.bodies(name))
    missing = [n for n in names if n not in there]
    if missing:
        context.problems.append(
            f"{where}.objects: the scene has no rigid object {', '.join(missing)}; call ObjectPoolCfg.spawn(scene, "
            f"'{name}') before it is built"
        )
        return {}
    found = {n: there[n] for n in names}
    fixed = [n for n, o in found.items() if not o.layout.floating]
    if fixed:
        context.problems.append(f"{where}.objects: {', '.join(fixed)} cannot move, a pool needs free bodies")
        return {}
    starts = [(o.layout.root_coord, o.layout.root_dof) for o in found.values()]
    steps = {(b[0] - a[0], b[1] - a[1]) for a, b in itertools.pairwise(starts)}
    if len(steps) > 1 or min(steps, default=(1, 1)) < (0, 0):
        context.problems.append(
            f"{where}.objects: are not evenly spaced in the model; make pools of one kind of spawner each"
        )
        return {}
    return found


def _rows(state: torch.Tensor, starts: list[int], size: int) -> torch.Tensor:
    """``size`` columns from each of evenly spaced ``starts``, as a view: shape ``(num_envs, len(starts), size)``."""
    step = starts[1] - starts[0] if len(starts) > 1 else size
    shape, strides = (len(state), len(starts), size), (state.stride(0), step, 1)
    return state.as_strided(shape, strides, state.storage_offset() + starts[0])


def _reach(body: RigidObject, context: ManagerContext) -> float:
    """Radius of a sphere about the body's origin that holds its shapes [m]."""
    model = context.scene.sim.model
    mine = model.shape_body.numpy() == body.layout.bodies[0]  # that of the first environment
    centres, radii = model.shape_transform.numpy()[mine, :3], model.shape_collision_radius.numpy()[mine]
    return max((float((c @ c) ** 0.5 + r) for c, r in zip(centres, radii, strict=True)), default=0.0)
