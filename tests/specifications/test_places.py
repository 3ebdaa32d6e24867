# SPDX-License-Identifier: Apache-2.0
"""Places for robots, against exact distances to the colliders and planes fitted to the ground."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pxr import Usd
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from stripe_newton.specifications import AssetSpec, BoxMesh, CapsuleMesh, CylinderMesh, Places, SceneSpec, SphereMesh
from stripe_newton.specifications import TerrainInstance as Terrain
from stripe_newton.specifications.places import add_places, footprints, tile_bounds, walkable
from stripe_newton.terrains import Ground
from stripe_newton.terrains.ground_usd import ground_prims, read_ground

SIZE = (30.0, 24.0)


class Things(AssetSpec):
    """Primitives of each kind, turned any way, and some long thin ones."""

    def __init__(self, name="things", count=60):
        super().__init__(name)
        self.count = count

    def generate(self, terrain, rng):
        meshes = [
            BoxMesh("box", (0.5, 0.2, 1.0)), SphereMesh("ball", (0.4,)), CapsuleMesh("pole", (0.04, 1.5)),
            CylinderMesh("can", (0.3, 0.6)), CapsuleMesh("pill", (0.5, 0.9)),
        ]  # fmt: skip
        for index in range(self.count):
            turn = Rotation.random(random_state=int(rng.integers(1 << 31))).as_quat()
            place = [*(rng.uniform(-0.5, 0.5, 2) * terrain.size), rng.uniform(0.0, 1.0)]
            yield self.create_instance(f"t{index}", meshes[index % 5], place, turn, rng.uniform(0.5, 1.5))


class Wall(AssetSpec):
    """From edge to edge, 5 m beyond the middle."""

    def generate(self, terrain, rng):
        size = (0.1, 0.5 * terrain.size[1] + 1.0, 1.0)
        yield self.create_instance("wall", BoxMesh("wall", size), (5.0, 0.0, 0.0))


class Hills(SceneSpec):
    def __init__(self, *args, cell=0.5, height=1.5, **kwargs):
        super().__init__(*args, **kwargs)
        self.cell, self.height = cell, height

    def generate(self, rng):
        x, y = (np.linspace(-0.5 * s, 0.5 * s, round(s / self.cell) + 1) for s in self.size)
        phase = rng.uniform(0.0, 6.3, 4)
        waves = np.sin(0.45 * x + phase[0])[None] * np.sin(0.5 * y + phase[1])[:, None]
        bumps = np.sin(2.5 * x + phase[2])[None] * np.sin(2.1 * y + phase[3])[:, None]
        cell = (x[1] - x[0], y[1] - y[0])
        return Terrain(Ground(self.height * (waves + 0.06 * bumps), (float(x[0]), float(y[0])), cell))


def outline(terrain: Terrain) -> list[tuple[np.ndarray, float]]:
    """Areas below colliders: convex polygons ``(N, 2)`` and widths added to them on all sides [m]."""
    found = []
    for one in (i for placed in terrain.placed.values() for i in placed):
        turn, place = Rotation.from_quat(one.rotation), np.array(one.position)
        for collider in one.mesh.colliders():
            size, round_by = collider.size, 0.0
            if collider.kind == "box":
                corners = np.array(np.meshgrid(*([-s, s] for s in size))).reshape(3, -1).T
            elif collider.kind == "cylinder":
                angle = np.linspace(0.0, 2.0 * np.pi, 240)
                rim = np.column_stack([size[0] * np.cos(angle), size[0] * np.sin(angle), np.full(240, size[1])])
                corners = np.concatenate([rim, rim * [1, 1, -1]])
            else:
                half, round_by = (size[1] if len(size) > 1 else 0.0), one.scale * size[0]
                corners = np.array([[0.0, 0.0, -half], [0.0, 0.0, half]])
            corners = Rotation.from_quat(collider.rot).apply(corners) + collider.pos
            flat = (place + one.scale * turn.apply(corners))[:, :2]
            if len(flat) > 2:
                flat = flat[ConvexHull(flat).vertices]
            found.append((flat, round_by))
    return found


def clearance(points: np.ndarray, shapes: list[tuple[np.ndarray, float]]) -> np.ndarray:
    """Distance of points ``(N, 2)`` to the nearest shape [m], 0 or less inside."""
    best = np.full(len(points), np.inf)
    for polygon, round_by in shapes:
        a, b = polygon, np.roll(polygon, -1, axis=0)
        edge, way = b - a, points[:, None] - a
        length = np.maximum((edge**2).sum(axis=1), 1e-12)
        share = np.clip((way * edge).sum(axis=-1) / length, 0.0, 1.0)
        away = np.linalg.norm(way - share[..., None] * edge, axis=-1).min(axis=1)
        inside = (edge[:, 0] * way[..., 1] - edge[:, 1] * way[..., 0] > 0.0).all(axis=1) & (len(polygon) > 2)
        best = np.minimum(best, np.where(inside, -away, away) - round_by)
    return best


def fitted_slope(ground: Ground, point: np.ndarray, radius: float) -> float:
    """Slope of the plane that fits the ground best within a radius [rad]."""
    grid = np.stack(np.meshgrid(*[np.linspace(-radius, radius, 25)] * 2), axis=-1).reshape(-1, 2)
    grid = grid[np.linalg.norm(grid, axis=1) <= radius]
    z = ground.height_at(*(point[:2] + grid).T)
    plane = np.linalg.lstsq(np.column_stack([grid, np.ones(len(grid))]), z, rcond=None)[0]
    return math.atan(np.hypot(*plane[:2]))


ASKED = {"init_pos": Places(200, 0.7, math.radians(20.0), 2.0), "target": Places(300, 0.4, math.radians(30.0), 1.0)}


@pytest.fixture(scope="module")
def scenes():
    return [Hills(SIZE, [Things()], places=ASKED).create(seed) for seed in range(3)]


def test_places_are_clear_of_all_colliders(scenes):
    tightest = []
    for scene in scenes:
        shapes = outline(scene.terrain)
        for name, asked in ASKED.items():
            found = scene.terrain.ground.patches[name]
            assert found.shape == (1, 1, asked.count, 3)
            room = clearance(found[0, 0, :, :2], shapes) - asked.radius
            assert room.min() >= -1e-9
            tightest.append(room.min())
    assert min(tightest) < 0.1  # no more room is taken than asked for


def test_circles_cover_all_colliders(scenes):
    for scene in scenes:
        circles = footprints(scene.terrain)
        points = np.random.default_rng(0).uniform(-0.5, 0.5, (3000, 2)) * SIZE
        inside = clearance(points, outline(scene.terrain)) <= 0.0
        assert inside.sum() > 50
        away = np.linalg.norm(points[inside, None] - circles[:, :2], axis=-1) - circles[:, 2]
        assert away.min(axis=1).max() <= 1e-9


def test_the_ground_of_places_is_not_too_steep(scenes):
    slopes = {"all": [], **{name: [] for name in ASKED}}
    for scene in scenes:
        ground = scene.terrain.ground
        for name, asked in ASKED.items():
            for place in ground.patches[name][0, 0, ::4]:
                slopes[name].append(fitted_slope(ground, place, asked.radius))
        for x, y in np.random.default_rng(1).uniform(-0.4, 0.4, (50, 2)) * SIZE:
            slopes["all"].append(fitted_slope(ground, np.array([x, y]), 0.7))
    for name, asked in ASKED.items():
        assert max(slopes[name]) <= asked.max_slope + math.radians(2.0)  # smoothed by another window
    assert max(slopes["all"]) > math.radians(33.0)
    assert max(slopes["target"]) > math.radians(22.0)


def test_places_keep_the_margin_and_stand_on_the_ground(scenes):
    for scene in scenes:
        ground = scene.terrain.ground
        for name, asked in ASKED.items():
            places = ground.patches[name][0, 0]
            assert (np.abs(places[:, :2]) <= 0.5 * np.array(SIZE) - asked.margin + 1e-9).all()
            ring = np.random.default_rng(2).uniform(-1.0, 1.0, (150, 2))
            ring = min(asked.radius, 0.5) * ring[np.linalg.norm(ring, axis=1) <= 1.0]
            points = places[:, None, :2] + ring
            over = places[:, 2] - ground.height_at(points[..., 0], points[..., 1]).max(axis=1)
            assert over.min() > -0.02  # samples may miss a crest
            assert over.max() < 0.05


def test_all_places_are_connected(scenes):
    for scene in scenes:
        asked = ASKED["init_pos"]
        free, x, y = walkable(scene.terrain, asked.radius, asked.max_slope)
        rows, cols = np.nonzero(free)
        points = np.column_stack([x[cols], y[rows]])
        points = points[(np.abs(points) <= 0.5 * np.array(SIZE) - asked.margin + 1e-9).all(axis=1)]
        tree, seen = cKDTree(points), np.zeros(len(points), dtype=bool)
        places = scene.terrain.ground.patches["init_pos"][0, 0, :, :2]
        away, own = tree.query(places)
        assert away.max() < 1e-9
        step, edge = 1.01 * (x[1] - x[0]), [int(own[0])]
        while edge:  # from place to place, to neighbours along the axes
            seen[edge] = True
            near = tree.query_ball_point(points[edge], step)
            edge = [int(i) for i in np.unique(np.concatenate(near)) if not seen[int(i)]]
        assert seen[own].all()


@pytest.mark.parametrize("cell", [0.5, 3.0])
def test_behind_a_wall_there_is_no_place(cell):
    scene = Hills(SIZE, [Wall("wall")], cell=cell, height=0.1, places={"init_pos": Places(100, 0.5)}).create()
    x = scene.terrain.ground.patches["init_pos"][..., 0]
    assert x.max() <= 5.0 - 0.1 - 0.5
    assert x.max() > 3.0
    assert x.min() < -10.0


def test_the_origin_moves_to_the_nearest_place():
    class Middle(AssetSpec):
        def generate(self, terrain, rng):
            yield self.create_instance("rock", SphereMesh("rock", (2.0,)), (0.0, 0.0, 0.0))

    terrain = Hills(SIZE, [Middle("middle")], places={"init_pos": Places(400)}, height=0.2).create(1).terrain
    places = terrain.ground.patches["init_pos"][0, 0]
    nearest = places[np.argmin(np.linalg.norm(places[:, :2], axis=1))]
    np.testing.assert_array_equal(terrain.origin, nearest)
    np.testing.assert_array_equal(terrain.ground.origins, nearest[None, None])
    assert 2.6 <= np.hypot(*nearest[:2]) < 3.5
    only_goals = Hills(SIZE, [Middle("middle")], places={"target": Places(4)}, height=0.2).create(1).terrain
    assert only_goals.origin[:2] == (0.0, 0.0)


def test_each_tile_has_places_of_its_own():
    ground = Ground(np.zeros((41, 61)), (10.0, -5.0), (0.5, 0.5))
    ground.origins, ground.tile = np.zeros((3, 2, 3)), (10.0, 10.0)
    terrain = Terrain(ground)
    add_places(terrain, {"init_pos": Places(40, 0.5, margin=1.5)}, np.random.default_rng(0))
    for level, kind in np.ndindex(3, 2):
        low, high = tile_bounds(terrain, level, kind)
        np.testing.assert_allclose(low, [10.0 + 10.0 * level, -5.0 + 10.0 * kind])
        places = ground.patches["init_pos"][level, kind, :, :2]
        assert (places >= low + 1.5 - 1e-9).all()
        assert (places <= high - 1.5 + 1e-9).all()
        assert np.ptp(places, axis=0).min() > 4.0
        assert ground.origins[level, kind] in ground.patches["init_pos"][level, kind]


def test_the_same_seed_gives_the_same_places_and_the_file_keeps_them(scenes, tmp_path):
    again = Hills(SIZE, [Things()], places=ASKED).create(2)
    stage = Usd.Stage.Open(str(again.export(tmp_path / "a.usdc")))
    saved = read_ground(ground_prims(stage)[0])
    for name in ASKED:
        found = [s.terrain.ground.patches[name] for s in scenes]
        np.testing.assert_array_equal(found[2], again.terrain.ground.patches[name])
        np.testing.assert_array_equal(found[2], saved.patches[name])
        assert not np.array_equal(found[1], found[2])
    np.testing.assert_array_equal(saved.origins[0, 0], again.terrain.origin)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: Places(count=0), "Places.count is 0: must be a whole number, 1 or more"),
        (lambda: Places(count=1.5), "Places.count is 1.5"),
        (lambda: Places(radius=0.0), "Places.radius is 0.0: must be above 0"),
        (lambda: Places(radius=math.nan), "Places.radius is nan"),
        (lambda: Places(max_slope=1.6), "Places.max_slope is 1.6: must be in (0, pi / 2)"),
        (lambda: Places(margin=-1.0), "Places.margin is -1.0: must be 0 or more"),
        (lambda: Hills(SIZE, [Things(count=2000)], places=ASKED).create(), "tile 0, 0 has no place 'init_pos'"),
        (lambda: Hills(SIZE, places={"target": Places(margin=13.0)}).create(), "has no place 'target'"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said(make, text):
    with pytest.raises(ValueError) as error:
        make()
    assert text in str(error.value)
