# SPDX-License-Identifier: Apache-2.0
"""Object manager: pools of rigid objects that are spawned, retired and tracked during a task."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from typing import ClassVar

import torch
import warp as wp

from stripe_kernels.mdp import objects as mdp
from stripe_newton.assets import RigidObject
from stripe_newton.fusion import Code, Item, SceneEntityCfg, Section, bind_term, code

from .context import ManagerContext
from .manager_base import ManagerBase
from .object_pool import ObjectPool, ObjectPoolCfg

__all__ = ["ObjectManager"]

_CLEARANCE = 0.5
"""Gap between parked objects [m]."""


class ObjectManager(ManagerBase):
    """Spawns, retires and tracks the objects of pools. The fields of its config are :class:`ObjectPoolCfg`.

    The bodies must be in the scene: call ``ObjectPoolCfg.spawn`` before it is built. Terms get a pool's
    ``ObjectPoolData`` by ``params={"pool_name": "balls"}``. A curriculum may change the parameters ``num_range``,
    ``min_distance``, ``min_robot_distance`` and ``max_tries`` below ``objects.<pool>``.

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
            KeyError: if there is none; the message lists those that exist.
        """
        if name not in self.pools:
            raise KeyError(f"no object pool '{name}'; there is {', '.join(self.pools) or 'none'}")
        return self.pools[name]

    # -- items

    def reset_items(self) -> list[Item]:
        """Items that log the number of active objects, retire them and spawn new ones.

        They belong after the reset of the robots, from which spawned objects keep a distance.
        """
        if not self.pools:
            return []
        return [Section("objects_reset", self._respawn, self.active_terms).only(self.context.is_reset)]

    def update_items(self) -> list[Item]:
        """Items that advance the ages of objects and keep retired ones parked.

        They belong after resets and events and before ``moved`` is used, which they set where objects were spawned or
        retired. A retired object falls during the physics of a step and is then put back. Its body pose, which nothing
        reads, is off by that fall until the next physics step.
        """
        if not self.pools:
            return []
        context = self.context
        moved = context.code("{moved}")
        body = [context.scope.call(mdp.update_objects, "env", pool.struct_name, moved) for pool in self.pools.values()]
        if not context.scene.sim.cfg.solver.reduced_coordinates:  # bodies are the solver's state, so they must follow
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
        """Give each object a parking place above the environment, so far from the others that no two can touch."""
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


def _find(name: str, cfg: ObjectPoolCfg, context: ManagerContext) -> dict[str, RigidObject]:
    """The objects of a pool in the scene, by name; none after a problem."""
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


def _reach(body: RigidObject, context: ManagerContext) -> float:
    """Radius of a sphere about the body's origin that holds its shapes [m]."""
    model = context.scene.sim.model
    mine = model.shape_body.numpy() == body.layout.bodies[0]  # its body in the first environment
    centres, radii = model.shape_transform.numpy()[mine, :3], model.shape_collision_radius.numpy()[mine]
    return max((float((c @ c) ** 0.5 + r) for c, r in zip(centres, radii, strict=True)), default=0.0)
