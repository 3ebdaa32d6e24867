# SPDX-License-Identifier: Apache-2.0
"""Pools of rigid objects by configuration."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

from stripe_newton.assets import RigidObject, RigidObjectCfg
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.scene import InteractiveScene

__all__ = ["ObjectPoolCfg", "spawn_object_pools"]

_AXES = ("x", "y", "z", "roll", "pitch", "yaw")

Range = dict[str, tuple[float, float]]
"""Bounds by axis: x, y, z, roll, pitch, yaw; (0, 0) for those not named."""


@configclass
class ObjectPoolCfg:
    """Rigid objects that a task spawns, moves and retires while it runs, some of them in each environment.

    Bodies cannot be made while a simulation runs: all of them are there from the start, and those that are not active
    wait at rest high above the environment, where they touch nothing. They cost degrees of freedom, no contacts.
    The buffers of a solver are sized at the start: give ``MuJoCoSolverCfg(nconmax=..., njmax=...)`` room for the
    contacts of all active objects; a box on the ground takes 4 contacts and 16 constraints, a ball 1 and 4.
    """

    objects: dict[str, RigidObjectCfg] | RigidObjectCfg = MISSING
    """The objects by name, or one of which ``count`` copies are made. ``init_state`` is an object's home."""
    count: int = 1
    """Copies, where ``objects`` is one config; ``_0``, ``_1``, ... is added to its prim path and to the pool's name."""
    spacing: float = 1.0
    """Distance between the homes of copies [m], which stand in a square about the ``init_state``."""
    respawn: bool = True
    """Whether a reset retires all objects and spawns new ones; otherwise that is up to event terms."""
    num_active: int | tuple[int, int] | None = None
    """How many a reset spawns, chosen at random: a number, bounds of a random number, or all."""
    pose_range: Range | None = None
    """Where a reset spawns them: x, y [m] in the environment's frame, z [m] above the home, roll, pitch, yaw [rad]
    from the home; ``None`` for the homes themselves."""
    velocity_range: Range = {}
    """Added to the velocity at home: x, y, z [m/s], roll, pitch, yaw for rates about x, y, z [rad/s]; it needs
    ``pose_range``."""
    min_distance: float = 0.0
    """Least distance between spawned objects [m]; it needs ``pose_range``."""
    min_robot_distance: float = 0.0
    """Least horizontal distance from the root of the robot [m]; it needs ``pose_range``."""
    robot_name: str = "robot"
    """Which robot that is."""
    max_tries: int = 16
    """Places tried for an object; one that finds none stays retired."""
    target_range: Range | None = None
    """Where the objects should get to, drawn at a reset, bounds as of ``pose_range``; ``None`` leaves the targets,
    which are the homes at first."""
    parking_height: float = 100.0
    """Height above the environment's origin at which retired objects wait [m]; above all that moves there, as below
    it lies the ground."""

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
        needs: dict[str, Any] = {"velocity_range": {}, "min_distance": 0.0, "min_robot_distance": 0.0}
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


def _range_problems(bounds: Range | None) -> Iterator[str]:
    for axis, pair in (bounds or {}).items():
        if axis not in _AXES:
            yield f"has '{axis}', keys must be among {', '.join(_AXES)}"
        elif len(pair) != 2 or not pair[0] <= pair[1]:
            yield f"has {pair} for '{axis}', must be (low, high) with low <= high"


def spawn_object_pools(cfg: Any, scene: InteractiveScene) -> None:
    """Add the bodies of all pools to a scene under construction.

    Args:
        cfg: What :class:`ObjectManager` takes: a config or dict of :class:`ObjectPoolCfg`, or None.
        scene: The scene.
    """
    pools = cfg if isinstance(cfg, Mapping) else {n: getattr(cfg, n) for n in getattr(cfg, "__dataclass_fields__", ())}
    for name, pool in pools.items():
        if isinstance(pool, ObjectPoolCfg):
            pool.spawn(scene, name)
