# SPDX-License-Identifier: Apache-2.0
"""Tiles of many scenes on one ground: each is its own scene, and together they are a terrain with levels."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch
from pxr import Usd

from stripe_newton.configclass import configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import EventTermCfg, ObservationGroupCfg, ObservationTermCfg, RewardTermCfg
from stripe_newton.managers import TerminationTermCfg as Termination
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_newton.specifications import (
    CylinderMesh,
    IdenticalAssetSpec,
    MeshPart,
    Places,
    SceneSpec,
    TerrainInstance,
    TileGridSpec,
    TrainingSpec,
)
from stripe_newton.terrains import Ground
from stripe_newton.terrains.ground_usd import ground_prims, read_ground
from stripe_newton.terrains.terrain_importer import found_terrain
from stripe_tasks.robots import ANT_CFG

TILE, CELL, FADE, BORDER, TYPES = (16.0, 12.0), 0.5, 2.0, 3.0, 2
HEIGHTS = (0.5, 1.0, 2.0)
"""Height of the hills of each level [m]."""
POST = CylinderMesh("post", (0.1, 0.5))


class Posts(IdenticalAssetSpec):
    def __init__(self, name, count):
        super().__init__(name, POST)
        self.count = count

    def find_positions(self, terrain, rng):
        return rng.uniform(-0.45, 0.45, (self.count, 2)) * terrain.size


class Hills(SceneSpec):
    """Hills of a height and posts; also where it was made, for what is compared later."""

    def __init__(self, height, size=TILE, cell=CELL, colored=True, **kwargs):
        super().__init__(size, [Posts("posts", round(6 * height))], **kwargs)
        self.height, self.cell, self.colored, self.made = height, cell, colored, []

    def generate(self, rng):
        x, y = (np.linspace(-0.5 * s, 0.5 * s, round(s / self.cell) + 1) for s in self.size)
        heights = self.height * np.sin(0.8 * x + rng.uniform(0, 6))[None] * np.sin(0.7 * y + rng.uniform(0, 6))[:, None]
        heights += self.height * rng.uniform(-0.3, 0.3)
        water = MeshPart("water", np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]), np.array([[0, 1, 2]]))
        terrain = TerrainInstance(
            Ground(heights, (float(x[0]), float(y[0])), (self.cell, self.cell)),
            parts=[(water, ["water"])],
            origin=(1.0, -2.0, 0.0),
            maps={"wet": heights.astype(np.float32), "coarse": np.zeros((2, 2))},
            colors=np.full((*heights.shape, 3), self.height) if self.colored else None,
        )
        self.made.append(heights.astype(np.float32))
        return terrain

    def survey(self, terrain):
        terrain.maps["posts"] = np.full(terrain.ground.heights.shape, len(terrain.placed["posts"]), dtype=np.float32)


def grid(types=TYPES, heights=HEIGHTS, **kwargs) -> TileGridSpec:
    places = {"init_pos": Places(30, 0.4), "target": Places(20, 0.3, margin=1.0)}
    return TileGridSpec(
        [Hills(h) for h in heights], types, **{"fade": FADE, "border": BORDER, "places": places, **kwargs}
    )


def corner(level: int, kind: int) -> np.ndarray:
    """Of a tile, lower [m]."""
    whole = np.array([len(HEIGHTS) * TILE[0], TYPES * TILE[1]])
    return -0.5 * whole + np.array([level, kind]) * TILE


def block(ground: Ground, level: int, kind: int, values: np.ndarray) -> np.ndarray:
    """The part of an array with a value for each height that is a tile's."""
    col, row = np.rint((corner(level, kind) - np.array(ground.lower)) / CELL).astype(int)
    return values[row : row + round(TILE[1] / CELL) + 1, col : col + round(TILE[0] / CELL) + 1]


@pytest.fixture(scope="module")
def spec():
    return grid(max_init_level=1)


@pytest.fixture(scope="module")
def scene(spec):
    return spec.create(3)


def test_tiles_are_the_ground_of_their_specs(spec, scene):
    ground = scene.terrain.ground
    assert ground.size == spec.size == (3 * TILE[0] + 2 * BORDER, 2 * TILE[1] + 2 * BORDER)
    inner = round(FADE / CELL)
    for level, kind in np.ndindex(3, TYPES):
        tile, own = block(ground, level, kind, ground.raw), spec.levels[level].made[kind]
        np.testing.assert_array_equal(tile[inner:-inner, inner:-inner], own[inner:-inner, inner:-inner])
        for edge in (tile[0], tile[-1], tile[:, 0], tile[:, -1]):
            np.testing.assert_array_equal(edge, 0.0)
        assert (np.abs(tile) <= np.abs(own) + 1e-6).all()
    assert not np.array_equal(spec.levels[0].made[0], spec.levels[0].made[1])
    rim = round(BORDER / CELL)
    assert not ground.raw[:rim].any()
    assert not ground.raw[:, -rim:].any()


def test_seams_are_no_steeper_than_hills(scene):
    ground, inner = scene.terrain.ground, round(FADE / CELL)
    for axis in (0, 1):
        for level, kind in np.ndindex(3, TYPES):
            steps = np.abs(np.diff(block(ground, level, kind, ground.raw), axis=axis))
            kept = steps[inner:-inner, inner:-inner].max()
            assert 0.0 < steps.max() <= 1.1 * kept + 1.3 * HEIGHTS[level] * 1.5 * CELL / FADE  # 1.5: steepest fading
            first = np.moveaxis(steps, axis, 0)[0]
            assert first.max() < 0.2 * HEIGHTS[level]  # fading starts gently


def test_what_stands_on_a_tile_stands_on_the_whole(scene):
    placed, ground = scene.terrain.placed["posts"], scene.terrain.ground
    names = [i.name for i in placed]
    assert len(set(names)) == len(names) == TYPES * sum(round(6 * h) for h in HEIGHTS)
    at = np.array([i.position for i in placed])
    np.testing.assert_allclose(at[:, 2], ground.height_at(at[:, 0], at[:, 1]), atol=1e-4)
    counts = np.zeros((3, TYPES), dtype=int)
    for name, (x, y, _) in zip(names, at, strict=True):
        level, kind = (int(part[1:]) for part in name.split("_")[-2:])
        low = corner(level, kind)
        assert (low <= [x, y]).all()
        assert (low + TILE >= [x, y]).all()
        counts[level, kind] += 1
    np.testing.assert_array_equal(counts, np.round(6 * np.array(HEIGHTS))[:, None].astype(int) * [1, 1])


def test_origins_and_places_lie_on_their_tiles(scene):
    ground = scene.terrain.ground
    assert ground.tile == TILE
    assert ground.origins.shape == (3, TYPES, 3)
    for level, kind in np.ndindex(3, TYPES):
        low = corner(level, kind)
        for name, count, margin in (("init_pos", 30, 2.0), ("target", 20, 1.0)):
            places = ground.patches[name][level, kind]
            assert places.shape == (count, 3)
            assert (places[:, :2] >= low + margin - 1e-9).all()
            assert (places[:, :2] <= low + TILE - margin + 1e-9).all()
        wanted = low + 0.5 * np.array(TILE) + [1.0, -2.0]
        away = np.linalg.norm(ground.patches["init_pos"][level, kind, :, :2] - wanted, axis=1)
        np.testing.assert_array_equal(
            ground.origins[level, kind], ground.patches["init_pos"][level, kind][away.argmin()]
        )


def test_maps_colours_and_surfaces_are_put_together(spec, scene):
    terrain = scene.terrain
    assert set(terrain.maps) == {"wet", "posts"}  # not what is coarser than the heights
    inner = (slice(1, -1), slice(1, -1))
    for level, kind in np.ndindex(3, TYPES):
        own = block(terrain.ground, level, kind, terrain.maps["wet"])
        np.testing.assert_array_equal(own[inner], spec.levels[level].made[kind][inner])
        posts = block(terrain.ground, level, kind, terrain.maps["posts"])
        assert (posts[inner] == round(6 * HEIGHTS[level])).all()
        assert (block(terrain.ground, level, kind, terrain.colors)[inner] == HEIGHTS[level]).all()
    np.testing.assert_allclose(terrain.colors[0, 0], terrain.color)
    parts = {part.name: part.vertices for part, _ in terrain.parts}
    assert len(parts) == 3 * TYPES
    np.testing.assert_allclose(parts["water_2_1"][0, :2], corner(2, 1) + 0.5 * np.array(TILE))
    assert grid(heights=(1.0,)).create().terrain.colors is not None
    plain = TileGridSpec([Hills(1.0, colored=False)], 1, places={}).create()
    assert plain.terrain.colors is None


def test_more_tiles_change_nothing_on_the_others(scene):
    more = grid(types=3, heights=(*HEIGHTS, 2.5)).create(3)

    def tiles(one):
        found = {}
        for instance in one.terrain.placed["posts"]:
            found[instance.name] = instance.position[2]
        return found

    few, many = tiles(scene), tiles(more)
    assert len(many) > len(few)
    assert few == {name: many[name] for name in few}
    shift = more.terrain.ground.patches["init_pos"][:3, :TYPES] - scene.terrain.ground.patches["init_pos"]
    np.testing.assert_allclose(shift, np.broadcast_to([-0.5 * TILE[0], -0.5 * TILE[1], 0.0], shift.shape), atol=1e-6)


def test_the_same_seed_gives_the_same_bytes_and_the_file_keeps_the_levels(scene, tmp_path):
    files = [s.export(tmp_path / f"{i}.usdc") for i, s in enumerate((scene, grid(max_init_level=1).create(3)))]
    assert files[0].read_bytes() == files[1].read_bytes()
    assert grid(max_init_level=1).create(4).export(tmp_path / "2.usdc").read_bytes() != files[0].read_bytes()
    stage = Usd.Stage.Open(str(files[0]))
    assert found_terrain(stage).max_init_terrain_level == 1
    saved = read_ground(ground_prims(stage)[0])
    np.testing.assert_array_equal(saved.origins, scene.terrain.ground.origins)
    assert saved.tile == TILE
    stage = Usd.Stage.Open(str(grid().create(3).export(tmp_path / "any.usda")))
    assert found_terrain(stage).max_init_terrain_level is None


# -- in an environment


@configclass
class PolicyCfg(ObservationGroupCfg):
    height: ObservationTermCfg = ObservationTermCfg(func=mdp.base_pos_z)


def test_environments_are_spread_over_the_tiles(spec, scene):
    reset = EventTermCfg(
        func=mdp.reset_root_state_from_terrain, mode="reset", params={"pose_range": {}, "velocity_range": {}}
    )
    training = TrainingSpec(
        scene=spec,
        robot=ANT_CFG,
        observations={"policy": PolicyCfg()},
        actions={"efforts": mdp.JointEffortActionCfg(joint_names=[".*"], scale=5.0)},
        rewards={"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)},
        terminations={"time_out": Termination(func=mdp.time_out, time_out=True)},
        events={"reset": reset},
        sim=SimulationCfg(device="cpu", dt=1 / 120, solver=MuJoCoSolverCfg(njmax=300, nconmax=60)),
    )
    name = training.to_env_cfg(decimation=2, seed=3).register("Test-Tiles-Ant-v0")
    try:
        env = gymnasium.make_vec(name, num_envs=12).unwrapped
        terrain = env.scene.terrain
        level, kind = terrain.struct.level.numpy(), terrain.struct.kind.numpy()
        assert set(level) == {0, 1}
        np.testing.assert_array_equal(kind, np.arange(12) % TYPES)
        assert terrain.struct.init_pos.shape == (3, TYPES, 30)
        assert terrain.struct.target.shape == (3, TYPES, 20)
        np.testing.assert_allclose(
            terrain.struct.env_origin.numpy(), scene.terrain.ground.origins[level, kind], atol=1e-5
        )
        env.reset(seed=0)
        root = env.scene["robot"].data.root_pos_w.numpy()
        start = scene.terrain.ground.patches["init_pos"][level, kind]
        away = np.linalg.norm(start[..., :2] - root[:, None, :2], axis=-1)
        assert away.min(axis=1).max() < 1e-4
        height = np.take_along_axis(start[..., 2], away.argmin(axis=1)[:, None], axis=1)[:, 0]
        np.testing.assert_allclose(root[:, 2] - height, ANT_CFG.init_state.pos[2], atol=1e-4)
        obs, *_ = env.step(torch.zeros(12, env.single_action_space.shape[0]))
        assert torch.isfinite(obs["policy"]).all()
        env.close()
    finally:
        gymnasium.registry.pop(name, None)


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: TileGridSpec([]), "0 levels of 4 tiles; must be at least one of each"),
        (lambda: grid(types=0), "3 levels of 0 tiles"),
        (lambda: grid(types=1.5), "3 levels of 1.5 tiles"),
        (lambda: TileGridSpec([Hills(1.0), Hills(1.0, (12.0, 12.0))]), "all must have one size"),
        (lambda: TileGridSpec([Hills(1.0), Hills(1.0, cell=1.0)]).create(), "heights of tile 1, 0 are (13, 17) spaced"),
        (lambda: grid(fade=0.0), "fade is 0.0, must be above 0"),
        (lambda: grid(fade=6.5), "fade is 6.5, must be above 0 and at most half a tile"),
        (lambda: grid(border=-1.0), "border is -1.0, must be 0 or more"),
        (lambda: grid(border=1.2).create(), "border is 1.2 m, must be a whole number of the spacings"),
        (lambda: grid(max_init_level=3), "max_init_level is 3, must be in 0 .. 2"),
        (lambda: grid(places={"init_pos": Places(margin=6.5)}).create(), "tile 0, 0 has no place 'init_pos'"),
    ],
)
def test_what_is_wrong_is_said(make, text):
    with pytest.raises(ValueError) as error:
        make()
    assert text in str(error.value)
