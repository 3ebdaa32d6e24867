# SPDX-License-Identifier: Apache-2.0
"""Start spots: where robots stand in a world of triangles, on all of its floors."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp

from stripe_kernels import start_spots as kernels
from stripe_newton.configclass import configclass
from stripe_newton.value_types import NonNegativeFloat, PositiveFloat, PositiveInt, Seed

__all__ = ["Floors", "StartSpotsCfg", "choose_spots", "find_floors"]

_LAYERS = 12
"""Most floors above each other."""
_MAX_COLUMNS = 400_000
"""Most columns of the grid; a larger world gets wider cells."""
_STEEP = math.cos(math.radians(50.0))
"""Vertical part of the normal of the steepest ground that counts as a floor."""
_REASONS = {
    kernels.INSIDE: "inside of something solid",
    kernels.OBSTRUCTED: "too close to something",
    kernels.UNEVEN: "not level",
}


@configclass
class StartSpotsCfg:
    """Places where robots start: level, clear of everything, and on a floor that is large enough."""

    num_spots: PositiveInt | None = None
    """Number of places. ``None``: one for each environment, at least 64 and at most 1024."""
    min_spots: PositiveInt = 1
    """Fewer places than this are an error."""
    radius: PositiveFloat | None = None
    """Radius around the place that is level and clear [m]. ``None``: that of what stands in an environment at its
    start, and 5 cm. Resets that move a robot away from its origin need more."""
    height: PositiveFloat | None = None
    """Free height above the place [m]. ``None``: that of what stands in an environment, and 5 cm."""
    max_height_diff: PositiveFloat = 0.03
    """Largest height difference of the ground within the radius [m]."""
    max_step: PositiveFloat = 0.25
    """Greatest step between parts of one floor [m]. Floors that stairs connect are one."""
    min_area: NonNegativeFloat = 4.0
    """Least area of a floor with what it connects to [m^2]: table tops are none."""
    reachable_from: tuple[float, float, float] | None = None
    """A point of the floor that places must be connected with [m], to leave out roofs. ``None``: any floor."""
    lower: tuple[float, float, float] | None = None
    """Lower corner of the box in which places are looked for [m]. ``None``: everywhere."""
    upper: tuple[float, float, float] | None = None
    """Upper corner of that box [m]."""
    seed: Seed = 0
    """Seed of the choice. The same seed gives the same places."""

    def problems(self) -> Iterator[tuple[str, str]]:
        corners = zip(self.lower or (), self.upper or (), strict=False)
        if not all(low < high for low, high in corners):
            yield "lower", f"is {self.lower}, must be below upper, {self.upper} [m]"


@dataclass
class Floors:
    """Ground that a robot can reach on foot, as points on a grid.

    Attributes:
        points: Points of the ground [m], float32 ``(points, 3)``.
        cell: Distance between neighbouring columns of the grid [m].
        areas: Area of each floor with all that it connects to [m^2], the largest first.
        covered: Share of the columns of the grid that have ground.
        found: Number of surfaces that are not steep and have free space above.
        free: Number of these without something in the way of a body.
        radius: Radius of the room of a robot [m].
        height: Height of that room [m].
    """

    points: np.ndarray
    cell: float
    areas: list[float]
    covered: float
    found: int
    free: int
    radius: float
    height: float

    @property
    def area(self) -> float:
        """Area of all floors [m^2]."""
        return sum(self.areas)


def find_floors(mesh: wp.Mesh, bounds: np.ndarray, cfg: StartSpotsCfg, radius: float, height: float) -> Floors:
    """Find the floors of a world: surfaces with free space above, connected by steps that are not too high.

    Args:
        mesh: The world, made by :func:`collider_mesh`.
        bounds: Lower and upper corner of where to look [m], shape ``(2, 3)``.
        cfg: Limits; its ``radius`` and ``height`` are not read.
        radius: Radius of the room of a robot [m].
        height: Height of that room [m].

    Raises:
        ValueError: if ``reachable_from`` is on no floor.
    """
    low, high = bounds.astype(float).copy()
    for corner, limit, side in ((low, cfg.lower, max), (high, cfg.upper, min)):
        if limit is not None:
            corner[:] = [side(a, b) for a, b in zip(corner, limit, strict=True)]
    size = np.maximum(high - low, 1.0e-3)
    cell = max(0.1, math.sqrt(size[0] * size[1] / _MAX_COLUMNS))
    shape = tuple(max(1, int(s // cell)) for s in size[:2])
    # The rest of the extent that no whole cell fills is where the seed shifts the grid.
    shift = np.random.default_rng([cfg.seed, 0]).random(2) * (size[:2] - cell * (np.array(shape) - 1))
    x, y = (low[i] + shift[i] + cell * np.arange(shape[i]) for i in (0, 1))
    columns = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)
    with wp.ScopedDevice(mesh.device):
        heights = wp.zeros((len(columns), _LAYERS), dtype=float)
        counts = wp.zeros(len(columns), dtype=int)
        # Above the bounds, but within the box that the config gives, where a roof shall not hide the rooms.
        top = float(high[2]) + (0.1 if cfg.upper is None else 0.0)
        limits = [top, float(low[2]) - 0.1, _STEEP, height]
        ends = wp.array(columns, dtype=wp.vec2)
        wp.launch(kernels.find_surfaces, dim=len(columns), inputs=[mesh.id, ends, *limits], outputs=[heights, counts])
        z, found = heights.numpy(), counts.numpy()
    there = np.arange(_LAYERS) < np.minimum(found, _LAYERS)[:, None]
    column, layer = np.nonzero(there)
    points = np.column_stack([columns[column], z[column, layer]]).astype(np.float32)
    # A body that is narrower than a cell cannot pass unseen between two columns on both sides of a wall.
    free = _verdicts(mesh, points, 0.6 * cell, cfg.max_step, max(height, cfg.max_step + 0.01), -1.0) == kernels.CLEAR
    kept, areas = _connected(points, column, layer, free, shape, cell, cfg)
    covered = len(np.unique(column[kept])) / max(1, len(columns))
    return Floors(points[kept], cell, areas, covered, len(points), int(free.sum()), radius, height)


def _verdicts(
    mesh: wp.Mesh, points: np.ndarray, radius: float, low: float, high: float, tolerance: float
) -> np.ndarray:
    """Verdict of :func:`kernels.check_spots` on each point, int ``(points,)``."""
    if not len(points):
        return np.zeros(0, dtype=np.int32)
    with wp.ScopedDevice(mesh.device):
        verdict = wp.zeros(len(points), dtype=int)
        inputs = [mesh.id, wp.array(points, dtype=wp.vec3), radius, low, high, tolerance]
        wp.launch(kernels.check_spots, dim=len(points), inputs=inputs, outputs=[verdict])
        return verdict.numpy()


def _connected(
    points: np.ndarray,
    column: np.ndarray,
    layer: np.ndarray,
    free: np.ndarray,
    shape: tuple[int, ...],
    cell: float,
    cfg: StartSpotsCfg,
) -> tuple[np.ndarray, list[float]]:
    """Points of the floors that count, bool ``(points,)``, and the areas of these floors [m^2], the largest first."""
    node = np.full((math.prod(shape), _LAYERS), -1)
    node[column, layer] = np.where(free, np.arange(len(points)), -1)
    node = node.reshape(*shape, _LAYERS)
    pairs = []
    for here, there in ((node[:-1], node[1:]), (node[:, :-1], node[:, 1:])):
        for i in range(_LAYERS):
            for j in range(_LAYERS):
                both = (here[..., i] >= 0) & (there[..., j] >= 0)
                a, b = here[..., i][both], there[..., j][both]
                near = np.abs(points[a, 2] - points[b, 2]) <= cfg.max_step
                pairs.append((a[near], b[near]))
    start, end = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    from scipy.sparse import coo_matrix  # here, as both take long to import
    from scipy.sparse.csgraph import connected_components

    graph = coo_matrix((np.ones(len(start), dtype=bool), (start, end)), shape=(len(points), len(points)))
    _, label = connected_components(graph, directed=False)
    label[~free] = -1
    if cfg.reachable_from is not None:
        kept = free & (label == _label_at(points, label, free, cfg.reachable_from, cell))
    else:
        sizes = np.bincount(label[free], minlength=1) * cell**2
        kept = free & (sizes[label] >= cfg.min_area)
    areas = np.bincount(label[kept], minlength=1) * cell**2
    return kept, sorted((float(a) for a in areas if a > 0.0), reverse=True)


def _label_at(points: np.ndarray, label: np.ndarray, free: np.ndarray, where: Sequence[float], cell: float) -> int:
    """Label of the floor at a point.

    Raises:
        ValueError: if there is none.
    """
    away = np.abs(points - np.array(where, dtype=np.float32))
    near = np.flatnonzero(free & (away[:, :2].max(axis=1) <= 3.0 * cell) & (away[:, 2] <= 0.5))
    if not len(near):
        raise ValueError(f"start.reachable_from is {tuple(where)}, where no floor is within {3.0 * cell:.2g} m")
    return int(label[near[np.linalg.norm(away[near], axis=1).argmin()]])


def choose_spots(mesh: wp.Mesh, floors: Floors, cfg: StartSpotsCfg, num_envs: int) -> np.ndarray:
    """Choose places on the floors where a robot has room, spread over all of them.

    Args:
        mesh: The world.
        floors: Its floors.
        cfg: Limits.
        num_envs: Number of environments.

    Returns:
        Points of the ground [m], float32 ``(spots, 3)``, in an order in which each is far from those before it.

    Raises:
        ValueError: if there are fewer than ``min_spots``, with the reason.
    """
    wanted = cfg.num_spots or min(max(num_envs, 64), 1024)
    tolerance = cfg.max_height_diff
    verdict = _verdicts(mesh, floors.points, floors.radius, tolerance, floors.height, tolerance)
    good = floors.points[verdict == kernels.CLEAR]
    if len(good) < max(cfg.min_spots, 1):
        raise ValueError(_too_few(floors, cfg, verdict))
    rng = np.random.default_rng([cfg.seed, 1])
    # Farthest points of a random part: their number times that of the candidates is what this takes.
    pool = good[rng.permutation(len(good))[: 8 * wanted]]
    return _farthest(pool, min(wanted, len(pool)))


def _farthest(points: np.ndarray, count: int) -> np.ndarray:
    """``count`` of the points, each the farthest from those before it, beginning with the first."""
    chosen = np.zeros(count, dtype=int)
    away = np.full(len(points), np.inf)
    for k in range(1, count):
        away = np.minimum(away, np.linalg.norm(points - points[chosen[k - 1]], axis=1))
        chosen[k] = away.argmax()
    return points[chosen]


def _too_few(floors: Floors, cfg: StartSpotsCfg, verdict: np.ndarray) -> str:
    """Message that says how many places were found, and what was wrong with the others."""
    room = f"{floors.radius:.2f} m around and {floors.height:.2f} m above"
    if not len(verdict):
        why = (
            f"of {floors.found} points of level ground on a grid of {floors.cell:.2g} m {floors.free} have free space, "
            f"none of them on a floor of {cfg.min_area:g} m^2 or more"
        )
        return f"no place to start: {why}; set start.min_area, start.max_step or start.height"
    counts = {text: int((verdict == code).sum()) for code, text in _REASONS.items()}
    why = ", ".join(f"{count} are {text}" for text, count in counts.items() if count)
    number = int((verdict == kernels.CLEAR).sum())
    return (
        f"{number or 'no'} place{'' if number == 1 else 's'} to start with {room} free, min_spots is {cfg.min_spots}: "
        f"of {len(verdict)} points of the floors ({floors.area:.1f} m^2) {why}; set start.radius, start.height or "
        "start.max_height_diff"
    )
