# SPDX-License-Identifier: Apache-2.0
"""Rubble: streets, heaps at rest and pieces on them, and a forest task on it."""

from __future__ import annotations

import ast
import math
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

import stripe_tasks.rubble
from stripe_newton.registration import scene_class
from stripe_newton.scene import ObstaclesCfg
from stripe_newton.specifications import TerrainInstance, TileGridSpec
from stripe_tasks.forest.walk import training
from stripe_tasks.rubble import RubbleSpec
from stripe_tasks.rubble.relief import REPOSE
from stripe_tasks.rubble.resting import Support
from tests.helpers.rubble_geometry import capsules, corners, placed

LOOSE = "slabs", "beams", "pipes", "bricks", "chunks"
LABELS = {"walls": "wall", "columns": "column", "slabs": "slab", "beams": "beam", "pipes": "pipe", "bars": "rebar",
          "bricks": "brick", "chunks": "chunk", "debris": "debris"}  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    return RubbleSpec().create(1)


def test_heaps_lie_at_rest_and_streets_are_free(scene):
    terrain = scene.terrain
    heights, street = terrain.ground.heights, terrain.maps["street"]
    assert heights.max() > 1.5
    smooth = RubbleSpec(rough=0.0).create(1).terrain.ground
    rise = max(np.abs(np.diff(smooth.heights, axis=k)).max() / smooth.cell[1 - k] for k in (0, 1))
    assert rise < math.tan(REPOSE) + 1e-3
    assert np.median(np.abs(heights[street > 0.99])) < 0.25 < np.median(heights[street < 0.01])
    assert 0.2 < (street > 0.99).mean() < 0.6
    assert terrain.colors.shape == (*heights.shape, 3)
    assert (terrain.colors > 0.0).all()
    assert (terrain.colors <= 1.0).all()
    main = [i for name in ("slabs", "beams") for i in terrain.placed[name]]
    at = np.array([i.position[:2] for i in main])
    col, row = np.rint((at + 20.0) / terrain.ground.cell).astype(int).T
    assert (street[row, col] > 0.99).mean() < 0.12


# -- pieces on the ground


def test_nothing_hovers_and_nothing_is_buried(scene):
    """Part of every underside is in the ground or in an earlier piece; the upper side is not."""
    terrain = scene.terrain
    bare = TerrainInstance(terrain.ground)
    support = Support(bare)
    shown = []
    for name, instances in terrain.placed.items():
        for instance in instances:
            if name in LOOSE:
                feet = placed(instance, instance.mesh.feet)
                gap = feet[:, 2] - support.at(feet[:, :2])
                assert (gap < 0.0).mean() > 0.15, instance.name
                assert (gap < 0.06).mean() > 0.2, instance.name
                body = placed(instance, corners(instance.mesh))
                shown.append((body[:, 2] - support.at(body[:, :2])).max())
            support.add(instance)
    assert len(shown) > 500
    assert np.quantile(shown, 0.02) > 0.0
    up = [
        Rotation.from_quat(i.rotation).apply([0, 0, 1])[2] for name in ("slabs", "beams") for i in terrain.placed[name]
    ]
    assert min(up) > math.cos(math.radians(40.0) + 0.63)
    assert np.degrees(np.arccos(np.clip(up, -1.0, 1.0))).std() > 5.0  # some lie flat, some are tilted


def test_bars_stick_out_of_slabs_and_beams(scene):
    terrain = scene.terrain
    from_concrete = [i for name in ("slabs", "beams") for i in terrain.placed[name]]
    roots = cKDTree(np.concatenate([placed(i, i.mesh.stubs[:, 0]) for i in from_concrete]))
    bars = terrain.placed["bars"]
    assert len(bars) > 20
    away, _ = roots.query([b.position for b in bars])
    assert away.max() < 1e-6


def test_walls_stand_where_buildings_were(scene):
    terrain = scene.terrain
    walls = terrain.placed["walls"]
    assert len(walls) >= 3
    for wall in walls:
        edge = [abs(float(b.depth(np.array(wall.position[0]), np.array(wall.position[1])))) for b in terrain.buildings]
        assert min(edge) < 1e-6
        up = Rotation.from_quat(wall.rotation).apply([0.0, 0.0, 1.0])[2]
        assert math.cos(math.radians(14.0)) < up < 1.0
    loose = capsules([i for name in LOOSE for i in terrain.placed[name]])
    support = Support(TerrainInstance(terrain.ground))
    for wall in walls:
        support.add(wall)
    row, col, _ = support._cells(loose.positions[:, :2])
    assert support.taken[row, col].mean() < 0.005  # nothing lies in a wall


# -- the scene


def test_labels_names_and_counts(scene):
    terrain = scene.terrain
    assert {name: {i.labels[0] for i in placed_} for name, placed_ in terrain.placed.items()} == {
        name: {label} for name, label in LABELS.items()
    }
    assert len({i.name for i in scene.instances}) == len(scene.instances)
    assert len(terrain.placed["slabs"]) + len(terrain.placed["beams"]) == round(1100 * 0.16)
    few = RubbleSpec(size=(20.0, 24.0), count=11, clutter=0.0).create(0).terrain.placed
    assert len(few["slabs"]) + len(few["beams"]) == 11
    assert not any(few[name] for name in ("bricks", "chunks", "pipes", "bars", "debris"))
    at = np.array([i.position for i in scene.instances])
    assert (np.abs(at[:, :2]) < 20.0).all()
    apart = cKDTree([i.position[:2] for i in terrain.placed["slabs"]]).query(
        [i.position[:2] for i in terrain.placed["slabs"]], k=2
    )[0][:, 1]
    assert np.median(apart) > 0.75


def test_the_same_seed_gives_the_same_bytes(tmp_path):
    spec = RubbleSpec(size=(16.0, 16.0))
    files = [spec.create(seed).export(tmp_path / f"{i}.usda").read_bytes() for i, seed in enumerate((3, 3, 4))]
    assert files[0] == files[1] != files[2]


def test_maps_and_places(scene):
    terrain = scene.terrain
    free = terrain.maps["walkable"]
    assert set(np.unique(free)) == {0.0, 1.0}
    assert 0.25 < free.mean() < 0.75
    assert terrain.maps["slope"].shape == terrain.ground.heights.shape
    start = terrain.ground.patches["init_pos"].reshape(-1, 3)
    there = capsules([i for i in scene.instances if i.mesh.colliders()])
    axis = Rotation.from_quat(there.rotations).apply([0.0, 0.0, 1.0])

    def distances(place):
        way = place + (0.0, 0.0, 0.3) - there.positions
        along = np.clip((way * axis).sum(axis=1), -there.half_length, there.half_length)
        return np.linalg.norm(way - along[:, None] * axis, axis=1) - there.radius

    assert min(distances(place).min() for place in start[::16]) > 0.3
    xy = np.argwhere(free)[::60, ::-1] / (np.array(free.shape[::-1]) - 1.0) * 40.0 - 20.0
    on_ground = np.column_stack([xy, terrain.ground.height_at(*xy.T)])
    near = [(distances(place) < 0.9).sum() for place in on_ground]
    assert len(near) > 100
    assert max(near) <= 24  # what a robot with that many slots touches


def test_levels_of_rubble():
    levels = [RubbleSpec((16.0, 16.0), density=d, height=h) for d, h in ((200.0, 1.0), (1000.0, 2.5))]
    terrain = TileGridSpec(levels, types=2).create(0).terrain
    each = [sum(f"_l{level}_" in i.name for i in terrain.placed["slabs"]) for level in (0, 1)]
    assert each[1] > 3 * each[0] > 0
    assert terrain.ground.patches["init_pos"].shape[:2] == (2, 2)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"density": -1.0}, "density is -1"),
        ({"height": math.nan}, "height is nan"),
        ({"resolution": 0.0}, "resolution is 0"),
        ({"clutter": -0.5}, "clutter"),
        ({"size": (0.0, 10.0)}, r"size|resolution"),
    ],
)
def test_bad_arguments(arguments, message):
    with pytest.raises(ValueError, match=message):
        RubbleSpec(**arguments)


def test_it_is_registered_and_needs_nothing_of_the_forest():
    assert scene_class("rubble") is RubbleSpec
    for file in Path(stripe_tasks.rubble.__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            assert not any("forest" in name for name in names), file.name


def test_a_task_of_the_forest_runs_in_it():
    obstacles = ObstaclesCfg(slots=24, reach=0.9, sight=1.5)
    made = training(RubbleSpec((24.0, 24.0)), curriculum=None, obstacles=obstacles, num_envs=4)
    cfg = made.to_env_cfg(seed=2)
    cfg.sim.device = "cpu"
    from stripe_newton.envs import ManagerBasedRLEnv

    env = ManagerBasedRLEnv(cfg)
    try:
        env.reset(seed=0)
        for _ in range(20):
            obs, reward, *_ = env.step(torch.zeros(4, env.action_manager.total_action_dim))
        assert torch.isfinite(obs["policy"]).all()
        assert torch.isfinite(reward).all()
        assert len(env.scene["obstacles"].capsules) > 300
        height = env.scene["robot"].data.root_pos_w[:, 2].numpy()
        at = env.scene["robot"].data.root_pos_w[:, :2].numpy()
        ground = env.scene.terrain.ground.height_at(*at.T)
        assert ((height - ground > 0.05) & (height - ground < 0.8)).all()
    finally:
        env.close()
