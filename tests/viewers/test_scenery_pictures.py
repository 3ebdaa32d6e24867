# SPDX-License-Identifier: Apache-2.0
"""Pictures of scenery, traced by our own kernels: the same surfaces as Newton's sensor finds."""

from __future__ import annotations

import math
import types

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.configclass import ConfigError
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import MuJoCoSolverCfg, Simulation, SimulationCfg
from stripe_newton.specifications.scene_pictures import ScenePictures, still_life
from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_tasks.robots import ANT_CFG
from tests.helpers.small_wood import SmallWood

SIZE = (96, 64)


@pytest.fixture(scope="module")
def sim():
    return still_life(SmallWood((40.0, 40.0), count=150).create(4), wp.get_device("cpu"))


def cfg(**options):
    return ViewerCfg(
        eye=(0.0, 0.0, 4.0), lookat=(10.0, 4.0, 2.0), origin_type="world", resolution=SIZE, fov=60.0, **options
    )


def surfaces(renderer):
    renderer.render()
    shape, depth, normal = (renderer._tracer._main[k].numpy() for k in ("shape", "depth", "normal"))
    return shape, depth, normal


def test_scenery_is_what_newtons_sensor_sees(sim, monkeypatch):
    # Scenery is drawn by the normals of its faces.
    monkeypatch.setattr("stripe_newton.viewers.display_model.crease_builder", lambda builder: None)
    ours, theirs = (SceneRenderer(sim, cfg(natural=natural)) for natural in (True, False))
    assert ours._scene.model.bvh_shape_count_enabled == 0
    assert theirs._scene.model.bvh_shape_count_enabled == 3 * 150 + 2  # with the ground around
    (shape, depth, normal), (shape_2, depth_2, normal_2) = surfaces(ours), surfaces(theirs)
    same = shape == shape_2
    assert same.mean() > 0.998  # rays along an edge may fall to either side
    hit = same & (shape != 0xFFFFFFFF)
    assert 0.4 < hit.mean() < 1.0
    assert len(np.unique(shape[hit])) > 20
    np.testing.assert_allclose(depth[hit], depth_2[hit], rtol=1e-3, atol=1e-3)
    cosine = np.abs((normal[hit] * normal_2[hit]).sum(axis=1))
    assert np.quantile(cosine, 0.02) > 0.999


def test_scenes_with_many_meshes_are_natural_by_themselves(sim):
    assert len(SceneRenderer(sim, cfg())._scene.scenery) == 3 * 150 + 2
    few = still_life(SmallWood((20.0, 20.0), count=5).create(4), wp.get_device("cpu"))
    assert len(SceneRenderer(few, cfg())._scene.scenery) == 0
    assert len(SceneRenderer(few, cfg(natural=True))._scene.scenery) == 3 * 5 + 2


def wall_and_floor(wall: bool, robot_at=(0.0, 0.0, -50.0), color=(0.9, 0.05, 0.05)):
    """A floor of 40 m, a wall along y at x = 0 that is 2 m high, a box; the sun shines along (-1, 0, -1)."""
    static, template = newton.ModelBuilder(), newton.ModelBuilder()
    floor = newton.Mesh.create_box(20.0, 20.0, 0.5, compute_inertia=False)
    static.add_shape_mesh(-1, xform=wp.transform((0, 0, -0.5), wp.quat_identity()), mesh=floor, color=(0.5, 0.5, 0.5))
    if wall:
        mesh = newton.Mesh.create_box(0.1, 20.0, 1.0, compute_inertia=False)
        static.add_shape_mesh(-1, xform=wp.transform((0, 0, 1.0), wp.quat_identity()), mesh=mesh, color=(0.5, 0.5, 0.5))
    body = template.add_body(xform=wp.transform(robot_at, wp.quat_identity()))
    template.add_shape_box(body, hx=0.3, hy=0.3, hz=0.3, color=color)
    builder = newton.ModelBuilder()
    builder.add_world(template)
    model = builder.finalize(device="cpu")
    sun = types.SimpleNamespace(kind="distant", color=(1.0, 1.0, 1.0), intensity=3000.0, direction=(-0.7, 0.0, -0.7))
    dome = types.SimpleNamespace(kind="dome", color=(1.0, 1.0, 1.0), intensity=800.0, direction=(0.0, 0.0, -1.0))
    return types.SimpleNamespace(
        markers=[], body_choices=[],
        device=wp.get_device("cpu"), template=template, static=static, env_origins=np.zeros((1, 3)),
        state=model.state(), num_envs=1, lights=[sun, dome], env_origin=None,
    )  # fmt: skip


def from_above(sim, **options):
    """A picture whose left half is x < 0 and right half x > 0, 4 m to either side."""
    options = {"natural": True, "anti_aliasing": False, "haze": 0.0, **options}
    view = {"eye": (0.0, -0.01, 8.0), "lookat": (0.0, 0.0, 0.0), "origin_type": "world", "fov": 53.13}
    return SceneRenderer(sim, ViewerCfg(resolution=(64, 64), **view, **options)).render().astype(float)


def test_the_whole_scenery_casts_shadows():
    with_wall, without = from_above(wall_and_floor(True)), from_above(wall_and_floor(False))
    behind, lit = with_wall[24:40, 18:28].mean(), with_wall[24:40, 40:50].mean()  # x = -1.75 to -0.5, and beyond 1
    assert behind < 0.75 * lit
    assert abs(without[24:40, 18:28].mean() - without[24:40, 40:50].mean()) < 0.1 * lit
    assert with_wall[24:40, 2:8].mean() == pytest.approx(lit, rel=0.1)  # the shadow is 2 m long


def red(picture):
    r, g, b = picture[..., 0], picture[..., 1], picture[..., 2]
    return (r > 60) & (r > 1.7 * g) & (r > 1.7 * b)


def test_robots_and_scenery_hide_and_shade_each_other():
    lit = from_above(wall_and_floor(True, (2.5, 0.0, 0.3)))
    assert red(lit).sum() > 15
    in_shadow = from_above(wall_and_floor(True, (-0.8, 0.0, 0.3)))
    assert in_shadow[red(in_shadow)][:, 0].mean() < 0.8 * lit[red(lit)][:, 0].mean()
    assert red(from_above(wall_and_floor(True, (0.0, 0.0, -0.6)))).sum() == 0  # below the floor
    shade = from_above(wall_and_floor(False, (2.0, 0.0, 1.5)))  # casts its shadow at x = 0.5
    assert shade[30:34, 34:37].mean() < 0.8 * shade[30:34, 50:60].mean()


def test_outdoors_the_outlines_of_robots_alone_are_smoothed(sim):
    robot = wall_and_floor(True, (2.5, 0.0, 0.3))
    view = {"eye": (0.0, -0.01, 8.0), "lookat": (0.0, 0.0, 0.0), "origin_type": "world", "fov": 53.13}
    renderer = SceneRenderer(robot, ViewerCfg(resolution=(64, 64), natural=True, **view))
    renderer.render()
    side = 0.6 / 8.0 * 64  # of the box [px]; its edges have pixels on either side
    assert 4 * side < int(renderer._tracer._edge_count.numpy()[0]) < 16 * side
    renderer = SceneRenderer(sim, cfg())
    renderer.render()
    assert int(renderer._tracer._edge_count.numpy()[0]) == 0


def test_water_mirrors_the_sky():
    def far_water(roughness):
        sim = wall_and_floor(False)
        quad = np.array([[-19, -19, 0], [19, -19, 0], [19, 19, 0], [-19, 19, 0]], dtype=np.float32)
        mesh = newton.Mesh(quad, [0, 1, 2, 0, 2, 3], compute_inertia=False, roughness=roughness)
        at = wp.transform((0.0, 0.0, 0.1), wp.quat_identity())
        sim.static.add_shape_mesh(-1, xform=at, mesh=mesh, color=(0.1, 0.1, 0.05))
        view = {"eye": (-18.0, 0.0, 0.8), "lookat": (0.0, 0.0, 0.1), "origin_type": "world", "haze": 0.0}
        picture = SceneRenderer(sim, ViewerCfg(resolution=SIZE, natural=True, shadows=False, **view)).render()
        return picture[32:36].reshape(-1, 3).mean(axis=0)

    mirror, matt = far_water(0.05), far_water(0.9)
    assert mirror[2] > mirror[0] + 10  # blue, as the sky is
    assert matt[2] < matt[0] + 5


def test_haze_hides_what_is_far(sim):
    def contrast(haze):
        renderer = SceneRenderer(sim, cfg(haze=haze, anti_aliasing=False))
        picture = renderer.render().reshape(-1, 3).astype(float)
        far = renderer._tracer._main["depth"].numpy() > 8.0
        return picture[far & (renderer._tracer._main["shape"].numpy() != 0xFFFFFFFF)].std(axis=0).mean()

    assert contrast(0.05) < 0.8 * contrast(0.0)
    assert contrast(1.0) < 0.15 * contrast(0.0)
    with pytest.raises(ConfigError, match="haze"):
        cfg(haze=-0.1).validate()
    with pytest.raises(ConfigError, match="exposure"):
        cfg(exposure=0.0).validate()


def test_a_camera_looks_past_what_is_near():
    sim = wall_and_floor(True, robot_at=(2.0, 0.0, 0.5))

    def red(**view):
        options = {"natural": True, "resolution": SIZE, "shadows": False, "follow_time": 0.0} | view
        picture = SceneRenderer(sim, ViewerCfg(**options)).render().astype(int)
        return int(((picture[..., 0] > 2 * picture[..., 1]) & (picture[..., 0] > 60)).sum())

    fixed = {"eye": (-1.0, 0.0, 1.0), "lookat": (2.0, 0.0, 0.5), "origin_type": "world"}
    assert red(**fixed) == red(**fixed, near=0.5) == 0  # behind the wall
    assert red(**fixed, near=2.0) > 20
    behind = {"eye": (-3.0, 0.0, 0.3), "lookat": (0.5, 0.0, 0.0), "origin_type": "asset_heading"}
    assert red(**behind) > 20  # it comes before the wall, but stays behind the box
    with pytest.raises(ConfigError, match="near"):
        ViewerCfg(near=-1.0).validate()


def test_the_ground_has_the_colours_of_its_points():
    scene = SmallWood((40.0, 40.0), count=0).create(0)
    renderer = SceneRenderer(still_life(scene, wp.get_device("cpu")), cfg(natural=True))
    renderer.look((0.0, -0.01, 30.0), (0.0, 0.0, 0.0), fov=40.0)
    picture = renderer.render().astype(float)
    left, right = picture[10:-10, 20:40].mean(axis=(0, 1)), picture[10:-10, 56:76].mean(axis=(0, 1))
    assert left[0] > 1.3 * left[1]  # brown
    assert right[1] > 1.3 * right[0]  # green


@pytest.mark.parametrize("far", [1.0, 400.0])
def test_a_plain_floor_has_one_colour(far):
    """Neither grain, which is for bark and soil, nor shadows that it casts on itself, wherever it is and how large."""
    sim = wall_and_floor(False)
    size = 20.0 * far
    floor = newton.Mesh.create_box(size, size, 0.5, compute_inertia=False)
    sim.static.add_shape_mesh(
        -1, xform=wp.transform((0, 0, 0.1), wp.quat_identity()), mesh=floor, color=(0.5, 0.5, 0.5)
    )
    low = math.radians(6.0)  # of the sun: shadows of a surface on itself show first where light is grazing
    sim.lights[0].direction = (-math.cos(low), 0.0, -math.sin(low))
    view = {"eye": (0.4 * size, -0.3 * size, 4.0 + 0.2 * far), "lookat": (0.45 * size, -0.3 * size, 0.6)}
    options = {"natural": True, "haze": 0.0, "origin_type": "world", "anti_aliasing": False, "shadows": False}
    picture = SceneRenderer(sim, ViewerCfg(resolution=SIZE, fov=30.0, **view, **options)).render().astype(int)
    assert np.ptp(picture[SIZE[1] // 2 :].reshape(-1, 3), axis=0).max() <= 1


def test_distances_end_at_what_is_seen(sim):
    sim = wall_and_floor(True)
    view = {"eye": (3.0, 0.0, 1.0), "lookat": (0.0, 0.0, 1.0), "origin_type": "world"}
    renderer = SceneRenderer(sim, ViewerCfg(resolution=SIZE, natural=True, **view))
    seen = renderer.distances(np.array([[3.0, 0.0, 1.0]]), np.array([[-1.0, 0, 0], [0, 0, -1.0], [1.0, 0, 0]]), 12.0)
    np.testing.assert_allclose(seen, [[2.9, 1.0, 12.0]], atol=1e-3)
    other = SceneRenderer(sim, ViewerCfg(resolution=SIZE, natural=False, **view))
    np.testing.assert_allclose(other.distances(np.zeros((1, 3)), np.eye(3), 7.0), 7.0)


def test_five_thousand_instances_give_the_same_picture_each_time():
    pictures = []
    for _ in range(2):
        scene = SmallWood((200.0, 200.0), count=2500).create(7)
        drawn = ScenePictures(scene, (96, 54), "cpu")
        pictures.append((drawn.eye_level(), drawn.birds_eye()))
    for one, two in zip(*pictures, strict=True):
        np.testing.assert_array_equal(one, two)
        assert one.std() > 20


def test_a_simulation_in_a_wood_is_drawn_as_the_wood_is():
    spec = SmallWood((40.0, 40.0), count=40)
    simulation = Simulation(SimulationCfg(device="cpu", dt=1 / 240, solver=MuJoCoSolverCfg(njmax=300, nconmax=60)))
    scene = InteractiveScene(spec.create_instance(1, 1.0, seed=2).get_scene(ANT_CFG), simulation)
    scene.build()
    drawn = SceneRenderer(scene.sim, cfg())
    assert len(drawn._scene.scenery) == 3 * 40 + 2
    still = SceneRenderer(still_life(spec.create(2), wp.get_device("cpu")), cfg(natural=True, shadows=False))
    one, two = (r.render().astype(float) for r in (drawn, still))
    assert (np.abs(one - two).max(axis=2) < 12).mean() > 0.9  # but for the ant
