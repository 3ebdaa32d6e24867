# SPDX-License-Identifier: Apache-2.0
"""Collider slots: obstacles of any number, of which each robot touches the few that are nearest to it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from typing import TYPE_CHECKING

import newton
import numpy as np
import warp as wp
from mujoco_warp._src.types import BroadphaseType
from numpy.typing import ArrayLike

from stripe_kernels import obstacles as kernels
from stripe_newton.assets import BoundAsset
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.sensors.sensor_base import SensorBase, SensorCfg
from stripe_newton.sensors.sensor_data import SensorData
from stripe_newton.sim.host_flags import HostFlags
from stripe_newton.sim.mujoco_solver_cfg import MuJoCoSolverCfg
from stripe_newton.solvers.pair_list import remove_geom_pairs
from stripe_newton.value_types import NonNegativeFloat, PositiveFloat, PositiveInt, short

from .capsules import MAX_CELLS, Capsules, list_cells
from .scenery import Scenery

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["Obstacles", "ObstaclesCfg"]

_SIZE_FIELDS = "positions", "rotations", "radius", "half_length"
_LEFT_OUT = "positions", "radius"
"""Fields that a source of obstacles replaces."""
_BLOCK = 32
"""Threads a block: so few that a few thousand worlds are spread over a whole GPU."""


def _are_numbers(value: object, may_be_none: bool) -> bool:
    """Whether a value is an array of numbers, or one number; text, dicts and iterators make arrays of objects."""
    try:
        return (value is None and may_be_none) or np.asarray(value).dtype.kind in "fiu"
    except (TypeError, ValueError):  # rows of different lengths
        return False


def _obstacles(cfg: ObstaclesCfg) -> Obstacles:
    return Obstacles(cfg)


@configclass
class ObstaclesCfg(SensorCfg):
    """Capsules in the world frame, as arrays or from a function; a field of the scene's config."""

    class_type: Callable[..., SensorBase] | None = _obstacles
    """Class that the scene makes of this config."""
    prim_path: str = "/World/obstacles"
    """Path of the slots' labels, for contact sensors that tell them apart; nothing is authored there."""
    positions: ArrayLike | None = None
    """Centres in the world [m], ``(N, 3)``."""
    rotations: ArrayLike = (0.0, 0.0, 0.0, 1.0)
    """Orientations, xyzw, ``(N, 4)`` or one for all; the axis of a capsule is z."""
    radius: ArrayLike | None = None
    """Radii [m], ``(N,)`` or one for all."""
    half_length: ArrayLike = 0.0
    """Half lengths of the axes, without the caps [m], ``(N,)`` or one for all; 0 for spheres."""
    source: Callable[[], Capsules] | None = None
    """Function that returns the obstacles instead, such as with :meth:`Capsules.from_colliders`."""
    of_scenery: bool = False
    """Whether the obstacles are the colliders of the assets of the scene's specification, which then are no shapes."""
    capacity: PositiveInt | None = None
    """Limit on the obstacles that may take their place later; by default as many as there are, a quarter more with
    ``of_scenery``."""
    asset_name: str = "robot"
    """The asset that touches them, by its name in the scene."""
    slots: PositiveInt = 8
    """Number of obstacles that a robot can touch at a time."""
    reach: PositiveFloat = 1.5
    """Distance from the robot's root within which no obstacle may be missed [m]: the robot's extent from its root, and
    the distance it moves in a step of the environment."""
    sight: PositiveFloat | None = None
    """Distance from the root up to which obstacles are found [m], for terms that see them from afar; they also get
    slots that nearer ones leave free. By default ``reach``. It is the size of a cell of the grid, too."""
    directions: PositiveInt = 32
    """Number of directions about the robot in which ``mdp.obstacle_proximity`` looks."""
    friction: NonNegativeFloat | None = None
    """Coefficient of friction; by default that of ``SimulationCfg.physics_material``."""

    @property
    def farthest(self) -> float:
        """Distance up to which obstacles are looked for [m]."""
        return self.reach if self.sight is None else self.sight

    def capsules(self) -> Capsules:
        """The obstacles; none with ``of_scenery``, as the scene brings them.

        Raises:
            ConfigError: if they are not all there, or not capsules.
        """
        if self.of_scenery:
            return Capsules.none()
        if self.source is not None:
            found = self.source()
            if not isinstance(found, Capsules):
                raise ConfigError([f"source: returned a {type(found).__name__}, must return Capsules"])
            return found
        try:
            return Capsules(*(getattr(self, name) for name in _SIZE_FIELDS))
        except ValueError as error:
            raise ConfigError([str(error)]) from error

    def problems(self) -> Iterator[tuple[str, str]]:
        wrong = [name for name in _SIZE_FIELDS if not _are_numbers(getattr(self, name), name in _LEFT_OUT)]
        for name in wrong:
            yield name, f"is {short(getattr(self, name))}, must be an array of numbers, or one value for all"
        yield from self._source_problems(wrong)
        if self.sight is not None and self.sight < self.reach:
            yield "sight", f"is {self.sight}, must be at least reach, {self.reach} [m]"
        if self.capacity is not None and self.positions is not None and "positions" not in wrong:
            given = np.asarray(self.positions)
            if given.ndim == 2 and len(given) > self.capacity:
                yield "capacity", f"is {self.capacity}, but there are {len(given)} obstacles"

    def _source_problems(self, wrong: Collection[str]) -> Iterator[tuple[str, str]]:
        """Problems of the fields that say which obstacles there are."""
        given = [self.source is not None, self.positions is not None, self.of_scenery]
        if sum(given) > 1:
            yield "source", "is one of source, positions and of_scenery that are set; set one of them"
        if self.source is not None:
            return
        if not self.of_scenery:
            for name in ("positions", "radius"):
                if getattr(self, name) is None:
                    yield name, "is missing; give arrays of positions and radius, a source, or of_scenery=True"
        if self.positions is not None and self.radius is not None and not wrong:
            try:
                self.capsules()
            except ConfigError as error:
                name, _, text = error.problems[0].partition(": ")
                yield name, text


class Obstacles(SensorBase):
    """Static capsules in the world that all environments share, and that one robot of each environment touches.

    Each world has ``slots`` static capsules. Before the physics steps of an environment step they are moved to the
    obstacles that are nearest to its robot, so that a step costs the same however many obstacles there are. The nearest
    obstacles are found again after the physics, for rewards and terminations, and after resets, for observations. Terms
    read them as :class:`stripe_kernels.obstacles.ObstacleData`.

    Slots touch the bodies of that robot alone. In models of so many geoms (some hundred) that MuJoCo Warp sorts them
    rather than listing their pairs, they touch other bodies of their environment too.

    Obstacles in reach without a slot are an error that names the number of slots to set, like contacts that do not fit;
    see ``SimulationCfg.on_overflow``. ``reach`` is measured from the root, and the robot must not extend farther from
    its root than that.

    Attributes:
        capsules: The present obstacles.
        capacity: Limit on the obstacles that :meth:`replace` takes.
    """

    adds_shapes = True
    cfg: ObstaclesCfg
    struct: kernels.ObstacleData

    def __init__(self, cfg: ObstaclesCfg):
        super().__init__(cfg)
        self.capsules = self.cfg.capsules()
        self._count_room()

    def _count_room(self) -> None:
        count = len(self.capsules)
        spare = count // 4 + 16 if self.cfg.of_scenery else 0  # the scene of another seed may have more of them
        self.capacity = max(1, count + spare if self.cfg.capacity is None else self.cfg.capacity)

    def use_scenery(self, scenery: Scenery) -> None:
        """Take the colliders of a scene's assets as the obstacles, before the scene is built.

        Raises:
            ValueError: for a box, which no capsule can represent, or more than ``capacity``.
        """
        self.capsules = scenery.capsules()
        self._count_room()
        if len(self.capsules) > self.capacity:
            count = len(self.capsules)
            raise ConfigError([f"Obstacles.capacity: is {self.capacity}, but the scene has {count} obstacles"])

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        self._where = where = f"Obstacles '{self.cfg.prim_path}'"
        solver = sim.cfg.solver
        if not isinstance(solver, MuJoCoSolverCfg) or solver.use_mujoco_cpu or not solver.finds_contacts:
            raise ConfigError(
                [f"{where}: slots are geoms of MuJoCo Warp that differ from world to world, use MuJoCoSolverCfg() "
                 "with use_mujoco_contacts=True and use_mujoco_cpu=False"]
            )  # fmt: skip
        there: dict[str, BoundAsset] = {**self._scene.articulations, **self._scene.rigid_objects}
        if self.cfg.asset_name not in there:
            names = ", ".join(there) or "none"
            raise ConfigError([f"{where}.asset_name: is '{self.cfg.asset_name}', the scene has {names}"])
        self._asset = there[self.cfg.asset_name]
        shape = static.default_shape_cfg.copy()
        shape.is_visible = False
        if self.cfg.friction is not None:
            shape.mu = self.cfg.friction
        # Slots without an obstacle wait deep below the ground, small.
        below = wp.transform(wp.vec3(0.0, 0.0, -kernels.PARKED_DEPTH), wp.quat_identity())
        size = kernels.PARKED_SIZE
        # Shapes of what all environments share: in MuJoCo each world has its own copy, with poses and sizes of its own.
        self._labels = [f"{self.cfg.prim_path}/slot_{i}" for i in range(self.cfg.slots)]
        for label in self._labels:
            static.add_shape_capsule(-1, xform=below, radius=size, half_height=size, cfg=shape, label=label)

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        model = sim.solver.mjw_model
        shape_of_geom = sim.solver.mjc_geom_to_newton_shape.numpy()[0]  # geoms are the same in all worlds
        shapes = [sim.model.shape_label.index(label) for label in self._labels]
        geoms = [int(np.flatnonzero(shape_of_geom == shape)[0]) for shape in shapes]
        self._touch_robot_alone(shape_of_geom, geoms)
        sim.expect_changes(["shape_scale"])
        targets = [model.geom_size, model.geom_aabb, model.geom_rbound]
        if any(len(array) != self.num_envs for array in targets):
            raise RuntimeError(f"{self._where}: this solver does not keep sizes of geoms for each world")
        with wp.ScopedDevice(self.device):
            self._make_struct(self._asset.native_data.struct.root_pose)
            self._seen, self._told = wp.zeros(1, dtype=int), HostFlags(1, self.device)
            self._mask, self._slot_geoms = wp.zeros(self.num_envs, dtype=wp.bool), wp.array(geoms, dtype=int)
            data = sim.solver.mjw_data
            self._outputs = [data.geom_xpos, data.geom_xmat, *targets]
        self.replace(self.capsules)

    def _touch_robot_alone(self, shape_of_geom: np.ndarray, geoms: list[int]) -> None:
        """Take pairs of a slot and a body that is not the robot's from MuJoCo Warp's list of pairs."""
        sim, model = self._sim, self._sim.solver.mjw_model
        if model.opt.broadphase != BroadphaseType.NXN:  # MuJoCo Warp sorts many geoms and has no list of pairs
            return
        bodies = np.arange(sim.model.body_count // sim.num_envs)[self._asset.layout.body_slice]
        body = np.where(shape_of_geom >= 0, sim.model.shape_body.numpy()[shape_of_geom], -1)
        of_robot, is_slot = np.isin(body, bodies), np.isin(np.arange(len(body)), geoms)
        pairs = model.nxn_geom_pair_filtered.numpy()
        other = is_slot[pairs].any(axis=1) & ~of_robot[pairs].any(axis=1)
        if other.any():
            remove_geom_pairs(model, other)

    def _make_struct(self, root_pose: wp.array) -> None:
        count, slots, envs = self.capacity, self.cfg.slots, self.num_envs
        data = kernels.ObstacleData()
        data.pos, data.rot = wp.zeros(count, dtype=wp.vec3), wp.zeros(count, dtype=wp.quat)
        data.radius, data.half_length = wp.zeros(count, dtype=float), wp.zeros(count, dtype=float)
        data.start, data.listed = wp.zeros(MAX_CELLS + 1, dtype=int), wp.zeros(self._room, dtype=int)
        data.low_end, data.high_end = wp.zeros(self._room, dtype=wp.vec4), wp.zeros(self._room, dtype=wp.vec4)
        data.grid, data.grid_shape = wp.zeros(3, dtype=float), wp.zeros(2, dtype=int)
        data.root_pose, data.searched = root_pose, wp.empty(envs, dtype=wp.vec3)
        data.index = wp.full((envs, slots), value=-1, dtype=int)
        data.distance = wp.full((envs, slots), value=self.cfg.farthest, dtype=float)
        data.low, data.high = (wp.zeros((envs, slots), dtype=wp.vec4) for _ in range(2))
        data.found, data.directions = wp.zeros(envs, dtype=int), self.cfg.directions
        data.count, data.overflow = wp.zeros(envs, dtype=int), wp.zeros(envs, dtype=wp.bool)
        data.reach, data.sight = self.cfg.reach, self.cfg.farthest
        self.struct, self.data = data, SensorData(data)

    @property
    def _room(self) -> int:
        """Room for the lists of the cells: four cells for each, and some for long ones."""
        return 8 * self.capacity + 64

    def check(self, capsules: Capsules) -> None:
        """Refuse obstacles that cannot replace the present ones.

        Raises:
            ValueError: if there are more than :attr:`capacity`.
        """
        if len(capsules) > self.capacity:
            count = len(capsules)
            raise ValueError(f"{self._where}: {count} obstacles do not fit, set ObstaclesCfg(capacity={count}) or more")

    def replace(self, capsules: Capsules) -> None:
        """Replace the obstacles, for all environments; graphs stay as they are.

        Raises:
            ValueError: if there are more than :attr:`capacity`.
        """
        self.check(capsules)
        lists, data = list_cells(capsules, self.cfg.farthest, self._room), self.struct
        low, high = lists.ends(capsules)
        for array, value in (
            (data.pos, capsules.positions), (data.rot, capsules.rotations), (data.radius, capsules.radius),
            (data.half_length, capsules.half_length), (data.start, lists.start), (data.listed, lists.listed),
            (data.low_end, low), (data.high_end, high),
            (data.grid, np.array([*lists.lower, lists.size], dtype=np.float32)),
            (data.grid_shape, np.array(lists.shape, dtype=np.int32)),
        ):  # fmt: skip
            if len(value):
                wp.copy(array, wp.array(value, dtype=array.dtype, device="cpu"), count=len(value))
        self.capsules = capsules
        data.searched.fill_(float("nan"))
        self.launch()

    # -- what is known of it

    @property
    def counts(self) -> dict[str, int]:
        return {"num_slots": self.cfg.slots, "num_directions": self.cfg.directions}

    # -- what a step launches

    def launch(self) -> None:
        """Find the nearest obstacles and put the slots in their places."""
        self._find(self._mask, True)
        dim = self.num_envs, self.cfg.slots
        wp.launch(
            kernels.pose_slots, dim, inputs=[self.struct, self._slot_geoms], outputs=self._outputs, device=self.device
        )

    def _find(self, where: wp.array, everywhere: bool) -> None:
        inputs = [self.struct, where, everywhere, self._seen, self._told.array]
        wp.launch(kernels.find_obstacles, self.num_envs, inputs=inputs, device=self.device, block_dim=_BLOCK)

    def launch_before_steps(self) -> None:
        # Once for all physics steps of an environment step: reach covers what the robot moves in it.
        self.launch()

    def launch_measured(self) -> None:
        self._find(self._mask, True)

    def launch_reset(self, env_mask: wp.array) -> None:
        self._mask = env_mask  # launch_observed looks there: the roots of other environments are where they were

    def launch_observed(self) -> None:
        self._find(self._mask, False)

    def report_overflow(self) -> str:
        most, slots = self._told[0], self.cfg.slots
        if not most:
            return ""
        self._told[0] = 0
        self._seen.zero_()
        return (
            f"{self._where}: {most} obstacles lay within {self.cfg.reach:g} m of a robot, slots is {slots}, so that it "
            f"went through some of them; set ObstaclesCfg(slots={max(most, slots + slots // 2)}) or a shorter reach"
        )
