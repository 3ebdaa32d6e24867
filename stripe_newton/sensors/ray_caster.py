# SPDX-License-Identifier: Apache-2.0
"""Ray caster: rays from a body, for height scanners, lidars and distance sensors."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import newton
import numpy as np
import torch
import warp as wp

from stripe_kernels.episode import seed_streams
from stripe_kernels.sensors import ray as kernels
from stripe_kernels.sensors.ray_drift import reset_rays
from stripe_kernels.sensors.ray_field import RayField
from stripe_kernels.sensors.ray_shapes import cast_rays
from stripe_newton.configclass import MISSING, configclass
from stripe_newton.noise import NoiseCfg, NoiseModelCfg
from stripe_newton.value_types import INFINITE, NonNegativeInt, Range

from .clock import SensorClock
from .corruption import Corruption
from .patterns import PatternBaseCfg
from .prim_paths import OffsetCfg as FrameOffsetCfg
from .ray_caster_targets import ShapeTree, choose_shapes, field_of, path_problems
from .sensor_base import SensorBase, SensorBaseCfg
from .sensor_data import SensorData
from .sensor_mount import carrying_asset, find_mount
from .warp_struct import copy_struct, field_values

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["RayCaster", "RayCasterCfg", "RayCasterData"]

_ALIGNMENTS = {"base": kernels.ALIGN_BASE, "yaw": kernels.ALIGN_YAW, "world": kernels.ALIGN_WORLD}


def _ray_caster(cfg: RayCasterCfg) -> RayCaster:
    return RayCaster(cfg)


@configclass
class RayCasterCfg(SensorBaseCfg):
    """Rays from a body to the ground or to any collider; with a :class:`GridPatternCfg` a height scanner."""

    @configclass
    class OffsetCfg(FrameOffsetCfg):
        """Pose of the sensor in the frame of its body; a height scanner stands well above all ground."""

    class_type: Callable[..., SensorBase] | None = _ray_caster
    """Class that the scene makes of this config."""
    offset: OffsetCfg = OffsetCfg()
    """Pose of the sensor in the frame of its body."""
    pattern_cfg: PatternBaseCfg = MISSING
    """The rays, such as :class:`GridPatternCfg`."""
    ray_alignment: str = "base"
    """Frame that the rays follow: ``"base"`` the body's, ``"yaw"`` its position and heading alone, so that they stay
    upright, ``"world"`` its position alone."""
    attach_yaw_only: bool | None = None
    """Former spelling: True is ``ray_alignment="yaw"``."""
    max_distance: Annotated[float, INFINITE, Range(above=0.0)] = 1.0e6
    """Length of the rays [m]; nothing beyond it is hit."""
    mesh_prim_paths: Sequence[str] = ()
    """Prims that the rays hit, with all below them, such as ``/World/ground`` or ``{ENV_REGEX_NS}/Box_.*``; expressions
    are allowed. Empty for every collider. Visuals that collide with nothing are never hit."""
    exclude_own: bool = True
    """Whether the rays pass through the asset that carries the sensor."""
    drift_range: tuple[float, float] = (0.0, 0.0)
    """Bounds of an error of the body's position along x, y and z, drawn for each episode [m]."""
    ray_cast_drift_range: Mapping[str, tuple[float, float]] = {}
    """Bounds of a shift of the rays along their own ``x`` and ``y``, and of the hits along ``z``, drawn for each
    episode [m]."""
    noise: NoiseCfg | NoiseModelCfg | None = None
    """Noise of the lengths of the rays [m]; rays that hit nothing have none. A noise model draws its bias for an
    episode."""
    delay: NonNegativeInt = 0
    """Age of pose and hits, in measurements."""

    @property
    def alignment(self) -> str:
        """:attr:`ray_alignment`, with the former spelling taken into account."""
        return "yaw" if self.attach_yaw_only else self.ray_alignment

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        if self.ray_alignment not in _ALIGNMENTS:
            yield "ray_alignment", f"is {self.ray_alignment!r}, must be 'base', 'yaw' or 'world'"
        yield from path_problems(self.mesh_prim_paths)
        wrong = set(self.ray_cast_drift_range) - {"x", "y", "z"}
        if wrong:
            yield "ray_cast_drift_range", f"has {', '.join(sorted(wrong))}, its keys are x, y and z"
        if self.history_length:
            yield "history_length", "is not kept by ray casters; set it on the observation term"


class RayCasterData(SensorData):
    """Pose, hits and lengths of the rays: torch views of the memory that terms read.

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
    """Rays from a body, cast after the reset of a step and before the observations.

    The method follows from what the rays may hit, and is named by :attr:`method`:

    * ``"height field, lookup"``: rays that point straight down on a height field read three heights each;
    * ``"height field, march"``: slanted rays go over its cells, exactly;
    * a level plane without end counts as a height field;
    * ``"shapes"``: through a tree of the colliders' bounds, of the ray's environment and of what all share;
    * ``"height field, march, and shapes"``: both, the nearer hit counts.

    Attributes:
        clock: Says when it measures.
        rng: Random streams that drifts are drawn from, uint32, shape ``(num_envs,)``.
    """

    cfg: RayCasterCfg
    data: RayCasterData
    struct: kernels.RayCasterData
    method: str = ""
    """Method by which the rays are cast."""

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        from scipy.spatial.transform import Rotation  # here, as it takes long to import

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
        # Sensors that add shapes did so in prepare: only now are all shapes known.
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
        """Put noise and delay between the casting kernels and :attr:`data`, if the config asks for them."""
        cfg, setup = self.cfg, self._setup
        self._cast, self._placed, self._corruption = self.struct, setup, None
        if cfg.noise is None and not cfg.delay:
            return
        # Position, orientation and the lengths of the rays are delayed together, so hits lie where they were measured;
        # place_rays computes the hits from them.
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
        self._placed = copy_struct(setup, kernels.RaySetup)
        # A miss is infinite until noise was added, which leaves it so; max_distance takes its place afterwards.
        setup.missed = math.inf

    def _aim(self, sim: Simulation, chosen: np.ndarray) -> None:
        """Choose how the rays are cast: by the height field among the chosen shapes, and a tree for the others."""
        # A field among several shapes is still marched over, and left out of the tree: the nearer of two hits counts.
        self._tree: ShapeTree | None = None
        terrain = self._scene.terrain
        found = field_of(sim.model, chosen, None if terrain is None else terrain.struct)
        self._field = RayField()
        self._field.heights, self._field.bounds = wp.zeros((0, 0), dtype=float), wp.zeros(2, dtype=float)
        self._chosen, self._field_shape = chosen.copy(), -1
        if found is not None:
            self._field_shape, self._field = found
            chosen[self._field_shape] = False
        # Rays straight down in a frame that stays upright need no search: one look-up of the cell below each.
        down = np.allclose(self._directions, (0.0, 0.0, -1.0), atol=1.0e-7) and self.cfg.alignment != "base"
        if chosen.any():
            self._tree = ShapeTree(sim.model, chosen, sim.state)
            self._targets = self._tree.targets()
            self.method = "height field, march, and shapes" if found else "shapes"
        else:
            self.method = "height field, lookup" if down else "height field, march"

    # -- another ground in the same scene

    def why_not_regenerable(self, name: str, ground: int) -> str:
        if ground == self._field_shape or not self._chosen[ground]:
            return ""
        return f"the rays of '{name}' meet the ground as a mesh; leave other height fields out of the scene"

    def replace_ground(self, ground: int, heights: np.ndarray) -> None:
        if ground == self._field_shape:
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
        drift = {"drift": self._setup.drift, "ray_drift": self._setup.ray_drift, "rng": self.rng}
        measured = field_values(self.struct) if self.clock.period > 1 else {}
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
            wp.launch(reset_rays, dim=self.num_envs, inputs=[env_mask, self._bounds, self._setup, self.rng])
        if self._corruption is not None:
            self._corruption.restart(env_mask)

    def launch_observed(self) -> None:
        dim = (self.num_envs, self.num_rays)
        if self._tree is not None:
            self._tree.refit(self._sim.state)
            wp.launch(cast_rays, dim=dim, inputs=[self._setup, self._field, self._targets], outputs=[self._cast])
        else:
            kernel = kernels.scan_field if self.method.endswith("lookup") else kernels.march_rays
            wp.launch(kernel, dim=dim, inputs=[self._setup, self._field], outputs=[self._cast])
        if self._corruption is not None:
            self._corruption.launch(self.clock.due)
            wp.launch(kernels.place_rays, dim=dim, inputs=[self._placed, self._corruption.out], outputs=[self.struct])
        self.clock.settle()
