# SPDX-License-Identifier: Apache-2.0
"""Forest scenes: requested assets are there, none overlap, and a file loads as it was made."""

from __future__ import annotations

import math
from functools import cache

import newton
import numpy as np
import pytest
from pxr import Usd, UsdValidation
from scipy.spatial.transform import Rotation

from stripe_newton.registration import scene_class
from stripe_newton.scene.scenery import add_scenery, read_scenery
from stripe_newton.specifications import AssetInstance, Places
from stripe_newton.specifications.places import walkable
from stripe_newton.terrains.ground_usd import ground_prims, read_ground
from stripe_tasks.forest import ClearingSpec, ForestSpec, PathSpec, RavineSpec
from stripe_tasks.forest.assets import Lying, Rocks, Trees, Undergrowth
from stripe_tasks.forest.maps import slope
from stripe_tasks.forest.placement import sample_map

SIZE = (48.0, 40.0)
HECTARES = SIZE[0] * SIZE[1] / 1.0e4
KINDS = {"forest": ForestSpec, "clearing": ClearingSpec, "path": PathSpec, "ravine": RavineSpec}
CROWDED = {"rocks": 400.0, "stumps": 150.0, "logs": 100.0, "branches": 200.0}


@cache
def made(kind="forest", seed=1, **kwargs):
    return KINDS[kind](SIZE, **kwargs).create(seed)


def at(scene, name) -> np.ndarray:
    return np.array([i.position for i in scene.terrain.placed[name]])


def capsules(one: AssetInstance) -> list[tuple[np.ndarray, float]]:
    """Points along the axis of each collider, ``(17, 3)``, and its radius [m]."""
    turn, found = Rotation.from_quat(one.rotation), []
    for collider in one.mesh.colliders():
        half = collider.size[1] if collider.kind == "capsule" else 0.0
        axis = Rotation.from_quat(collider.rot).apply([0.0, 0.0, half])
        line = np.array(collider.pos) + np.linspace(-1.0, 1.0, 17)[:, None] * axis
        found.append((np.array(one.position) + one.scale * turn.apply(line), one.scale * collider.size[0]))
    return found


def least_gap(scene, one: str, other: str) -> float:
    """Distance of the nearest two colliders of two specs [m]."""
    best, lists = np.inf, [[(i.position, capsules(i)) for i in scene.terrain.placed[name]] for name in (one, other)]
    for index, (place, mine) in enumerate(lists[0]):
        for there, others in lists[1][index + 1 :] if one == other else lists[1]:
            if math.hypot(place[0] - there[0], place[1] - there[1]) < 10.0:
                for a, wide in mine:
                    for b, broad in others:
                        best = min(best, np.linalg.norm(a[:, None] - b, axis=-1).min() - wide - broad)
    return best


# -- what is there


def test_numbers_are_those_asked_for():
    scene = ForestSpec(SIZE, density=700.0, clutter=2.0, undergrowth=0.5).create()
    wanted = {"trees": 700, "rocks": 160, "stumps": 60, "logs": 50, "branches": 120, "bushes": 75, "ferns": 250, "grass": 750}  # fmt: skip # noqa: E501
    assert {n: len(p) for n, p in scene.terrain.placed.items()} == {n: round(d * HECTARES) for n, d in wanted.items()}
    assert len(at(made(count=37), "trees")) == 37
    bare = ForestSpec(SIZE, density=0.0, clutter=0.0, undergrowth=0.0).create()
    assert bare.instances == []
    open_share = float(made("clearing").terrain.maps["open"].mean())
    assert len(at(made("clearing"), "trees")) == round(round(600.0 * HECTARES) * (1.0 - open_share))


def test_a_forest_of_300_trees_is_made_in_one_go():
    scene = ForestSpec((64.0, 64.0), count=300).create(5)
    trees = scene.terrain.placed["trees"]
    assert len(trees) == 300
    assert len({i.mesh.name for i in trees}) > 8
    assert len(scene.stage.GetPrimAtPath("/World/trees").GetChildren()) == 300
    heights = [max(p.vertices[:, 2].max() for p in i.mesh.parts()) * i.scale for i in trees]
    assert min(heights) < 8.0
    assert max(heights) > 18.0


@pytest.mark.parametrize("crowded", [False, True])
def test_nothing_stands_in_anything_else(crowded):
    scene = made(density=900.0, **(CROWDED if crowded else {}))
    solid = ("trees", "rocks", "stumps", "logs", "branches")
    for index, one in enumerate(solid):
        for other in solid[index:]:
            assert least_gap(scene, one, other) > 0.0, (one, other)
    assert least_gap(scene, "trees", "trees") > 0.1


def test_everything_is_within_the_field_and_stands_on_the_ground():
    for kind in KINDS:
        scene = made(kind)
        for name, placed in scene.terrain.placed.items():
            places = np.array([i.position for i in placed])
            assert (np.abs(places[:, :2]) <= 0.5 * np.array(SIZE)).all()
            if name not in ("logs", "branches"):
                np.testing.assert_allclose(places[:, 2], scene.terrain.ground.height_at(*places[:, :2].T), atol=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_what_lies_touches_the_ground(kind):
    scene = made(kind, **CROWDED)
    ground, thickest = scene.terrain.ground, {"logs": 0.0, "branches": 0.0}
    for name in thickest:
        for one in scene.terrain.placed[name]:
            gaps, across = [], []
            for line, radius in capsules(one):
                over = line[:, 2] - ground.height_at(line[:, 0], line[:, 1])
                gaps.append(over.min() - radius)
                across.append(over.max())
                thickest[name] = max(thickest[name], radius)
            assert -0.25 < min(gaps) <= 1e-6, one.name
    assert 0.2 < thickest["logs"] < 0.8
    assert thickest["branches"] < 0.05
    for one in scene.terrain.placed["logs"]:  # the ends lie within the field
        for line, radius in capsules(one):
            assert (np.abs(line[:, :2]) <= 0.5 * np.array(SIZE) + 0.5).all()
            assert radius > 0.05


def test_what_is_soft_is_not_touched_and_grows_where_it_likes():
    more = {"bushes": 0.0, "ferns": 0.0, "grass": 0.0}
    for seed in range(4):
        scene = ForestSpec((64.0, 64.0), 0.0, clutter=0.0, undergrowth=2.0).create(seed)
        moisture = scene.terrain.maps["moisture"]
        for name in more:
            assert not any(i.mesh.colliders() for i in scene.terrain.placed[name])
            more[name] += (sample_map(moisture, (64.0, 64.0), at(scene, name)[:, :2]).mean() - moisture.mean()) / 4
    assert more["ferns"] > 0.03
    assert abs(more["grass"]) < 0.02


def test_species_differ_between_wet_and_dry_ground():
    found: dict[str, list[float]] = {}
    for seed in range(4):
        scene = ForestSpec((64.0, 64.0), 700.0, clutter=0.0, undergrowth=0.0, relief=8.0).create(seed)
        moisture = sample_map(scene.terrain.maps["moisture"], (64.0, 64.0), at(scene, "trees")[:, :2])
        for one, moist in zip(scene.terrain.placed["trees"], moisture, strict=True):
            found.setdefault(one.mesh.name.split("_")[0], []).append(moist)
    assert set(found) == {"spruce", "pine", "beech", "birch", "oak"}
    means = {species: np.mean(values) for species, values in found.items()}
    assert means["pine"] < means["spruce"] - 0.02
    only = ForestSpec(SIZE, mix={"birch": 3.0, "oak": 1.0}).create()
    share = np.mean([i.mesh.name.startswith("birch") for i in only.terrain.placed["trees"]])
    assert share == pytest.approx(0.75, abs=0.08)


# -- the other scenes


def test_no_tree_stands_in_a_clearing():
    scene = made("clearing")
    trees, maps = at(scene, "trees")[:, :2], scene.terrain.maps
    assert (sample_map(maps["open"], SIZE, trees) < 0.5).all()
    rows, cols = np.nonzero(maps["open"] > 0.5)
    shape = maps["open"].shape
    middle = np.array([cols.mean() / (shape[1] - 1) - 0.5, rows.mean() / (shape[0] - 1) - 0.5]) * SIZE
    radius = 0.25 * min(SIZE)
    assert np.linalg.norm(trees - middle, axis=1).min() > 0.85 * radius
    assert len(rows) / maps["open"].size == pytest.approx(math.pi * radius**2 / np.prod(SIZE), rel=0.1)
    steep = slope(scene.terrain.ground.heights, scene.terrain.ground.cell)
    inner = np.hypot(*(np.stack(np.meshgrid(*(np.linspace(-0.5, 0.5, n) * s for n, s in zip(shape[::-1], SIZE, strict=True)))) - middle[:, None, None])) < 0.7 * radius  # fmt: skip # noqa: E501
    assert steep[inner].max() < 1e-3


def test_a_path_is_free_and_easy_to_walk():
    scene = made("path", **CROWDED)
    maps = scene.terrain.maps
    for name in ("trees", "rocks", "stumps", "logs", "branches"):
        for one in scene.terrain.placed[name]:
            for line, _ in capsules(one):
                assert (sample_map(maps["trodden"], SIZE, line[:, :2]) < 0.5).all(), one.name
    on_path = maps["trodden"] > 0.9
    width = on_path.sum(axis=0).min() * SIZE[1] / (on_path.shape[0] - 1)
    assert width >= 1.2  # from edge to edge
    along = maps["traversability"][on_path].mean()
    assert along > 0.5
    assert along > 1.5 * maps["traversability"].mean()
    grass = sample_map(maps["trodden"], SIZE, at(scene, "grass")[:, :2])
    assert (grass < 0.5).mean() > 0.98


def test_a_ravine_is_steep_and_its_bottom_is_free_of_trees():
    scene = made("ravine")
    maps, ground = scene.terrain.maps, scene.terrain.ground
    steep = slope(ground.heights, ground.cell)
    assert (steep > math.radians(35.0)).mean() > 0.02
    assert (steep[:, 5:-5] > math.radians(35.0)).any(axis=0).mean() > 0.9  # all along it
    bottom = maps["open"] > 0.5
    assert bottom.any(axis=0).all()
    assert (sample_map(maps["open"], SIZE, at(scene, "trees")[:, :2]) < 0.5).all()
    assert ground.heights[bottom].mean() < ground.heights[~bottom].mean() - 2.5


@pytest.mark.parametrize("kind", KINDS)
def test_a_robot_finds_places_and_maps(kind):
    scene = made(kind)
    ground, maps = scene.terrain.ground, scene.terrain.maps
    free, x, y = walkable(scene.terrain, 0.7, math.radians(25.0))
    places = ground.patches["init_pos"][0, 0]
    assert len(places) == len(ground.patches["target"][0, 0]) == 256
    col, row = (np.rint((places[:, i] - a[0]) / (a[1] - a[0])).astype(int) for i, a in ((0, x), (1, y)))
    assert free[row, col].all()
    assert np.ptp(places[:, :2], axis=0).min() > 10.0
    assert set(maps) >= {"slope", "moisture", "open", "traversability"}
    for name in ("slope", "traversability"):
        assert maps[name].shape == ground.heights.shape
        assert 0.0 <= maps[name].min() < maps[name].max() <= (1.0 if name == "traversability" else 0.5 * math.pi)
    assert scene.terrain.colors.min() >= 0.0
    assert scene.terrain.colors.max() <= 1.0
    assert np.ptp(scene.terrain.colors.reshape(-1, 3), axis=0).min() > 0.01
    assert scene_class(kind) is KINDS[kind]


# -- the file


@pytest.mark.parametrize("kind", ["forest", "path"])
def test_the_same_seed_gives_the_same_bytes(kind, tmp_path):
    scenes = (KINDS[kind]((24.0, 30.0)).create(seed) for seed in (1, 1, 2))
    files = [s.export(tmp_path / f"{i}.usdc").read_bytes() for i, s in enumerate(scenes)]
    assert files[0] == files[1]
    assert files[0] != files[2]


def test_the_file_is_sound_and_loads_as_it_was_made(tmp_path):
    scene = made("ravine")
    stage = Usd.Stage.Open(str(scene.export(tmp_path / "ravine.usdc")))
    registry = UsdValidation.ValidationRegistry()
    validators = [registry.GetOrLoadValidatorByName(m.name) for m in registry.GetAllValidatorMetadata()]
    assert len(validators) > 20
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert not [f"{e.GetName()}: {e.GetMessage()}" for e in errors]
    np.testing.assert_array_equal(read_ground(ground_prims(stage)[0]).raw, scene.terrain.ground.raw)
    builders = []
    for source in (stage, scene.stage):
        builder = newton.ModelBuilder()
        add_scenery(builder, read_scenery(source))
        builders.append(builder)
    saved, own = builders
    assert saved.shape_label == own.shape_label
    for name in ("shape_transform", "shape_scale", "shape_type", "shape_flags", "shape_color"):
        np.testing.assert_array_equal(*(np.array([np.array(v) for v in getattr(b, name)]) for b in builders))
    touched = [label for label, flags in zip(own.shape_label, own.shape_flags, strict=True) if flags & newton.ShapeFlags.COLLIDE_SHAPES]  # fmt: skip # noqa: E501
    assert len(touched) == sum(len(i.mesh.colliders()) for i in scene.instances)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: ForestSpec((30.0,)), "ForestSpec: size is (30.0,), must be the extent in x and y, each at least 5 m"),
        (lambda: PathSpec(30.0), "PathSpec: size is 30.0"),
        (lambda: ForestSpec((30.0, 4.0)), "each at least 5 m"),
        (lambda: ForestSpec(SIZE, -1.0), "asset 'trees': density is -1.0, must be 0 or more"),
        (lambda: ForestSpec(SIZE, math.nan), "asset 'trees': density is nan"),
        (lambda: ForestSpec(SIZE, count=1.5), "asset 'trees': count is 1.5, must be a whole number, 0 or more"),
        (lambda: ForestSpec(SIZE, rocks=-2.0), "asset 'rocks': density is -2.0"),
        (lambda: ForestSpec(SIZE, clutter=math.inf), "ForestSpec: clutter is inf, must be 0 or more"),
        (lambda: ForestSpec(SIZE, undergrowth=-1.0), "ForestSpec: undergrowth is -1.0"),
        (lambda: ForestSpec(SIZE, resolution=20.0), "resolution is 20.0: must be from 0.02 m to 10.0 m, 1/4 of size"),
        (lambda: ForestSpec(SIZE, years=0.0), "years: is 0.0, must be in [5, 2000]"),
        (lambda: ForestSpec(SIZE, mix={}), "mix: is {}, must give shares"),
        (lambda: ForestSpec(SIZE, mix={"palm": 1.0}), "mix has no known species 'palm'; known are spruce"),
        (lambda: ForestSpec(SIZE, count=3000).create(), "asks for 3000 stems, must be 0 or more and at most one per"),
        (lambda: ForestSpec(SIZE, 0.0, logs=20_000.0).create(), "find no room, they would cover half of it"),
        (lambda: ForestSpec(SIZE, places={"init_pos": Places(margin=21.0)}).create(), "has no place 'init_pos'"),
        (lambda: Trees("two words"), "must be an identifier"),
        (lambda: Rocks("r", radius=(0.5, 0.2)), "radius is (0.5, 0.2), must be the smallest and the largest"),
        (lambda: Lying("l", "plank"), "kind is 'plank', must be 'log' or 'branch'"),
        (lambda: Undergrowth("u", "moss"), "kind is 'moss', must be 'bush', 'fern' or 'grass'"),
        (lambda: Undergrowth("u", "fern", cover=0.0), "cover 0.0"),
    ],
)
def test_what_is_wrong_is_said(make, text):
    with pytest.raises(ValueError) as error:
        make()
    assert text in str(error.value)
