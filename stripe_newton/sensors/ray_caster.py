# SPDX-License-Identifier: Apache-2.0
"""Rays from a body: height scanners, lidars, distance sensors."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_kernels.episode import seed_streams
from stripe_kernels.sensors import ray as kernels
from stripe_kernels.sensors.ray_drift import reset_rays
from stripe_kernels.sensors.ray_field import RayField

from .clock import SensorClock
from .corruption import Corruption
from .ray_caster_cfg import RayCasterCfg
from .ray_caster_mount import carrying_asset, find_mount
from .ray_caster_targets import ShapeTree, choose_shapes, field_of
from .sensor_base import SensorBase
from .sensor_data import SensorData

if TYPE_CHECKING:
    import newton

    from stripe_newton.sim import Simulation

__all__ = ["RayCaster", "RayCasterData"]

_ALIGNMENTS = {"base": kernels.ALIGN_BASE, "yaw": kernels.ALIGN_YAW, "world": kernels.ALIGN_WORLD}


class RayCasterData(SensorData):
    """What a ray caster measured: torch views of the memory that terms read.

    Attributes:
        pos_w: Position of the body that carries it, with its drift [m], shape ``(num_envs, 3)``.
        quat_w: Orientation of that body, quaternion (x, y, z, w), shape ``(num_envs, 4)``.
        ray_hits_w: Points that the rays hit [m], infinite where they hit nothing, shape ``(num_envs, num_rays, 3)``.
        distances: Lengths of the rays [m], ``max_distance`` where they hit nothing, shape ``(num_envs, num_rays)``.
    """

    pos_w: torch.Tensor
    quat_w: torch.Tensor
    ray_hits_w: torch.Tensor
    distances: torch.Tensor


class RayCaster(SensorBase):
    """Rays from a body; measured after the reset of a step, before the observations.

    How they are cast follows from what they may hit, and :attr:`method` says so:

    * ``"height field, lookup"``: rays that point straight down on a height field read three heights each;
    * ``"height field, march"``: slanted rays go over its cells, exactly;
    * a level plane without end counts as a height field;
    * ``"shapes"``: through a tree of the colliders' bounds, of the ray's environment and of what all share;
    * ``"height field, march, and shapes"``: both, the nearer hit counts.

    Attributes:
        method: How the rays are cast.
        data: The measurement, :class:`RayCasterData`.
    """

    cfg: RayCasterCfg
    method = ""

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        self._where = f"{type(self).__name__} '{self.cfg.prim_path}'"
        self._mount = find_mount(template, self.cfg.prim_path, self._where).at(self.cfg.offset)
        self._own = carrying_asset(self._scene, template, self._mount.body)
        starts, directions = self.cfg.pattern_cfg.rays()
        pose = np.array(self._mount.pose, dtype=float)
        turn = Rotation.from_quat(pose[3:])
        self._starts, self._directions = turn.apply(starts) + pose[:3], turn.apply(directions)

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        cfg, count, rays = self.cfg, self.num_envs, self.num_rays
        own = self._own if cfg.exclude_own else ""
        chosen = choose_shapes(sim.model, cfg.mesh_prim_paths, own, self._where)
        with wp.ScopedDevice(sim.device):
            remembers = cfg.noise is not None or cfg.delay > 0
            self.clock = SensorClock(sim, cfg.update_period, self._where, observed=True, remembers=remembers)
            self.struct = data = kernels.RayCasterData()
            data.pos_w, data.quat_w = wp.zeros(count, dtype=wp.vec3), wp.zeros(count, dtype=wp.quat)
            data.ray_hits_w = wp.zeros((count, rays), dtype=wp.vec3)
            data.distances = wp.zeros((count, rays), dtype=float)
            self.data = RayCasterData(data)
            self._setup = self._make_setup(sim)
            self._corrupt()
            self._aim(sim, chosen)
            bounds = [cfg.drift_range] * 3 + [cfg.ray_cast_drift_range.get(axis, (0.0, 0.0)) for axis in "xyz"]
            self._drifts = any(b != (0.0, 0.0) for b in map(tuple, bounds))
            self._bounds = wp.array(bounds, dtype=wp.vec2)
            self.rng, seed = wp.zeros(count, dtype=wp.uint32), zlib.crc32(self._where.encode()) % 2**31
            wp.launch(seed_streams, dim=count, inputs=[seed], outputs=[self.rng])

    def _make_setup(self, sim: Simulation) -> kernels.RaySetup:
        setup = kernels.RaySetup()
        setup.body_pose, setup.num_bodies = sim.state.body_q, sim.template.body_count
        setup.body = self._mount.body
        setup.env_origin = wp.array(sim.env_origins, dtype=wp.vec3)
        setup.starts = wp.array(self._starts.astype(np.float32), dtype=wp.vec3)
        setup.directions = wp.array(self._directions.astype(np.float32), dtype=wp.vec3)
        setup.alignment, setup.max_distance = int(_ALIGNMENTS[self.cfg.alignment]), float(self.cfg.max_distance)
        setup.drift, setup.ray_drift = (wp.zeros(self.num_envs, dtype=wp.vec3) for _ in range(2))
        setup.missed = setup.max_distance
        setup.due = self.clock.due
        return setup

    def _corrupt(self) -> None:
        """Let what is cast pass through noise and delay, if there is any, on its way to :attr:`data`."""
        cfg, setup = self.cfg, self._setup
        self._cast, self._placed, self._corruption = self.struct, setup, None
        if cfg.noise is None and not cfg.delay:
            return
        count, size = self.num_envs, 7 + self.num_rays
        raw = wp.zeros((count, size), dtype=float)
        lengths, columns = slice(7, size), wp.to_torch(raw)
        noise = [] if cfg.noise is None else [(lengths, cfg.noise)]
        self._corruption = Corruption(raw, noise, cfg.delay, f"{self._where}.noise")
        cast = self._cast = kernels.RayCasterData()
        cast.pos_w = wp.from_torch(columns[:, :3], dtype=wp.vec3)
        cast.quat_w = wp.from_torch(columns[:, 3:7], dtype=wp.quat)
        cast.distances = wp.from_torch(columns[:, lengths])
        cast.ray_hits_w = wp.zeros((count, self.num_rays), dtype=wp.vec3)
        self._placed = _copy(setup)
        setup.missed = float("inf")

    def _aim(self, sim: Simulation, chosen: np.ndarray) -> None:
        """Find how the rays are to be cast."""
        self._tree: ShapeTree | None = None
        found = field_of(sim.model, chosen, getattr(self._scene.terrain, "struct", None))
        self._field = RayField()
        self._field.heights, self._field.bounds = wp.zeros((0, 0), dtype=float), wp.zeros(2, dtype=float)
        self._chosen, self._field_shape = chosen.copy(), -1
        if found is not None:
            self._field_shape, self._field = found
            chosen[self._field_shape] = False
        down = np.allclose(self._directions, (0.0, 0.0, -1.0), atol=1.0e-7) and self.cfg.alignment != "base"
        if chosen.any():
            self._tree = ShapeTree(sim.model, chosen, sim.state)
            self._targets = self._tree.targets()
            self.method = "height field, march, and shapes" if found else "shapes"
        else:
            self.method = "height field, lookup" if down else "height field, march"

    # -- another height field in the place of the one that there is

    def meets(self, shape: int) -> str:
        """How rays find a shape of the model: ``"field"``, ``"tree"``, or ``""`` if they do not hit it."""
        return "field" if shape == self._field_shape else "tree" if self._chosen[shape] else ""

    def replace_field(self, heights: np.ndarray) -> None:
        """Let rays meet other heights [m], as many as there are; graphs stay as they are."""
        self._field.heights.assign(heights)
        self._field.bounds.assign(np.array([heights.min(), heights.max()], dtype=np.float32))

    # -- what is known of it

    @property
    def num_rays(self) -> int:
        """Number of rays."""
        return len(self._starts)

    @property
    def body_names(self) -> list[str]:
        return [self._mount.name]

    @property
    def counts(self) -> dict[str, int]:
        return {"num_rays": self.num_rays}

    @property
    def arrays(self) -> dict[str, wp.array]:
        """What lasts from step to step, by name; what ends in ``rng`` are random streams."""
        drift = {"drift": self._setup.drift, "ray_drift": self._setup.ray_drift, "rng": self.rng}
        measured = {name: getattr(self.struct, name) for name in self.struct._cls.vars} if self.clock.period > 1 else {}
        corruption = {}
        if self._corruption is not None:
            corruption = {f"corruption.{k.removeprefix('corruption.')}": v for k, v in self._corruption.arrays.items()}
        return (drift if self._drifts else {}) | self.clock.arrays | measured | corruption

    def describe(self) -> str:
        """The sensor in one line: what carries it, its rays, and how they are cast."""
        return f"{self.num_rays} rays from '{self._mount.name}', {self.cfg.alignment}: {self.method}"

    # -- what a step launches

    def launch_measured(self) -> None:
        self.clock.count()

    def launch_reset(self, env_mask: wp.array) -> None:
        self.clock.restart(env_mask)
        if self._drifts:
            inputs: list[Any] = [env_mask, self._bounds, self._setup, self.rng]
            wp.launch(reset_rays, dim=self.num_envs, inputs=inputs)
        if self._corruption is not None:
            self._corruption.restart(env_mask)

    def launch_observed(self) -> None:
        dim = (self.num_envs, self.num_rays)
        if self._tree is not None:
            from stripe_kernels.sensors.ray_shapes import cast_rays

            self._tree.refit(self._sim.state)
            wp.launch(cast_rays, dim=dim, inputs=[self._setup, self._field, self._targets], outputs=[self._cast])
        else:
            kernel = kernels.scan_field if self.method.endswith("lookup") else kernels.march_rays
            wp.launch(kernel, dim=dim, inputs=[self._setup, self._field], outputs=[self._cast])
        if self._corruption is not None:
            self._corruption.launch(self.clock.due)
            wp.launch(kernels.place_rays, dim=dim, inputs=[self._placed, self._corruption.out], outputs=[self.struct])
        self.clock.settle()


def _copy(setup: Any) -> Any:
    made = kernels.RaySetup()
    for name in setup._cls.vars:
        setattr(made, name, getattr(setup, name))
    return made
