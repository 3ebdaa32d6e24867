# SPDX-License-Identifier: Apache-2.0
"""Regeneration of a scene without a restart: the result is the same as a new scene of that seed."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import torch
import warp as wp
from pxr import UsdGeom

from stripe_newton.scene.scenery import read_scenery
from tests.helpers.regenerate_world import (
    N,
    arrays,
    copy_state,
    ground_geom,
    make,
    put_beside_posts,
    random_actions,
    training,
)
from tests.helpers.solver_contacts import contact_count


@pytest.fixture(scope="module")
def pair():
    """The same scene, of one environment that was made with it, and of one that came to it."""
    fresh, moved = make(7), make(3)
    for _ in range(5):
        moved.step(torch.rand(N, 8) - 0.5)
    moved.regenerate(7)
    return fresh, moved


def test_ground_and_everything_on_it_is_that_of_the_seed(pair):
    fresh, moved = pair
    one, two = fresh.scene.terrain, moved.scene.terrain
    for name in ("heights", "raw", "origins"):
        np.testing.assert_array_equal(getattr(one.ground, name), getattr(two.ground, name))
    np.testing.assert_array_equal(one.struct.heights.numpy(), two.struct.heights.numpy())
    assert torch.equal(one.terrain_origins, two.terrain_origins)
    assert set(two.flat_patches) == {"init_pos", "target"}
    for name, points in one.flat_patches.items():
        assert torch.equal(points, two.flat_patches[name])
        np.testing.assert_array_equal(getattr(two.struct, name).numpy(), points.numpy())
    a, b = (env.scene["obstacles"].capsules for env in pair)
    for name in ("positions", "rotations", "radius", "half_length"):
        np.testing.assert_array_equal(getattr(a, name), getattr(b, name))
    assert moved.scene.scenery_seed == 7
    assert moved.scene.first_scenery_seed == 3
    assert len(a) != len(read_scenery(make_scene(3).stage).capsules())


def make_scene(seed):
    return training().scene.create(seed)


def test_model_and_solver_are_those_of_the_seed(pair):
    """All arrays, whoever reads them, but the meshes that are only seen and where robots are."""
    fresh, moved = (env.sim for env in pair)
    count, ground = N * fresh.template.shape_count, "/World/ground/terrain"
    i, j = (list(s.model.shape_label).index(ground) for s in (fresh, moved))
    for name, array in arrays(fresh.model).items():
        mine, its = array.numpy(), getattr(moved.model, name).numpy()
        if name.startswith(("shape_", "_shape")) and len(mine) == fresh.model.shape_count:
            if name in ("shape_source_ptr", "shape_edge_range") or "sdf" in name:
                continue
            np.testing.assert_allclose(mine[-count:], its[-count:], atol=1e-6, err_msg=name)
            np.testing.assert_allclose(mine[i], its[j], atol=1e-6, err_msg=name)
    np.testing.assert_array_equal(
        fresh.model.heightfield_elevations.numpy(), moved.model.heightfield_elevations.numpy()
    )
    assert fresh.model.heightfield_data.numpy().tolist() == moved.model.heightfield_data.numpy().tolist()
    meshes = [s.model.heightfield_meshes[0].points.numpy() for s in (fresh, moved)]
    np.testing.assert_allclose(*meshes, atol=1e-6)
    assert fresh.solver.one_launch == moved.solver.one_launch  # its kernel takes pairs out of MuJoCo Warp's list
    compared = 0
    for name, array in arrays(fresh.solver.mjw_model).items():
        mine, its = array.numpy(), getattr(moved.solver.mjw_model, name).numpy()
        if name in ("qpos0", "qpos_spring", "body_pos"):  # of free roots, where they were built
            continue
        slots = name in ("geom_size", "geom_aabb", "geom_rbound")
        if slots:  # those of obstacles are where robots are
            mine, its = (a[:, : a.shape[1]][:, ground_geom(s)] for a, s in ((mine, fresh), (its, moved)))
        np.testing.assert_allclose(mine, its, atol=1e-5, rtol=1e-5, err_msg=name)
        compared += 1
    assert compared > 100
    for name in ("hfield_size", "hfield_data"):
        np.testing.assert_allclose(*(getattr(s.solver.mj_model, name) for s in (fresh, moved)), atol=1e-6)
    for name in ("geom_pos", "geom_aabb", "geom_rbound"):
        rows = [getattr(s.solver.mj_model, name)[ground_geom(s)] for s in (fresh, moved)]
        np.testing.assert_allclose(*rows, atol=1e-6)
    poses = [s.solver.mjw_data.geom_xpos.numpy()[:, ground_geom(s)] for s in (fresh, moved)]
    np.testing.assert_allclose(*poses, atol=1e-6)


def test_it_goes_the_same_way(pair):
    """Until rounding, of where robots were built, has grown from contact to contact."""
    pair[0].reset(seed=4)
    copy_state(pair)
    for action in random_actions(25):
        (a, *_), (b, *_) = (env.step(action) for env in pair)
        torch.testing.assert_close(a["policy"], b["policy"], atol=1e-4, rtol=1e-4)
        np.testing.assert_allclose(*(env.sim.state.joint_q.numpy() for env in pair), atol=1e-4)


def test_each_step_from_the_same_state_is_the_same(pair):
    """Among posts and on the ground, for observations, rewards, rays and forces."""
    pair[0].reset(seed=5)
    put_beside_posts(pair[0])
    touched, near = 0, 0
    for action in random_actions(50):
        copy_state(pair)
        (a, ra, *_), (b, rb, *_) = (env.step(action) for env in pair)
        torch.testing.assert_close(a["policy"], b["policy"], atol=1e-5, rtol=1e-5)
        torch.testing.assert_close(ra, rb)
        np.testing.assert_allclose(*(env.sim.state.joint_q.numpy() for env in pair), atol=1e-5)
        np.testing.assert_allclose(*(env.sim.state.joint_qd.numpy() for env in pair), atol=1e-3)
        rays = [env.scene["lidar"].data.distances for env in pair]
        torch.testing.assert_close(*rays, atol=1e-3, rtol=1e-3)  # some graze the ground
        forces = [env.scene["contacts"].data.net_forces_w for env in pair]
        torch.testing.assert_close(*forces, atol=0.5, rtol=1e-2)
        counts = [contact_count(env.sim.solver) for env in pair]
        assert counts[0] == counts[1]
        torch.testing.assert_close(*(env.scene["obstacles"].data.distance for env in pair), atol=1e-5, rtol=1e-5)
        touched += int((forces[0].norm(dim=-1) > 1.0).any())
        near += int(env_near(pair[0]))
    assert touched > 20
    assert near > 20


def env_near(env):
    """Whether all robots have an obstacle in reach."""
    return bool((env.scene["obstacles"].data.count > 0).all())


def test_the_stage_and_what_draws_it_show_the_new_scene(pair, tmp_path):
    fresh, moved = pair
    one, two = (env.scene.stage for env in pair)
    assert [p.GetPath() for p in one.Traverse()] == [p.GetPath() for p in two.Traverse()]
    points = [UsdGeom.Mesh(s.GetPrimAtPath("/World/ground/terrain")).GetPointsAttr().Get() for s in (one, two)]
    np.testing.assert_array_equal(*map(np.array, points))
    np.testing.assert_array_equal(read_scenery(one).pos, read_scenery(two).pos)
    seen = []
    for env in pair:
        static, visible = env.sim.static, int(newton.ShapeFlags.VISIBLE)
        rows = zip(static.shape_label, static.shape_flags, static.shape_transform, strict=True)
        seen.append({label: list(pose) for label, flags, pose in rows if int(flags) & visible})
    assert seen[0] == seen[1]
    assert any(label.startswith("/World/posts") for label in seen[0])
    for env, name in ((fresh, "a"), (moved, "b")):
        env.scene.export(tmp_path / f"{name}.usda")
    assert (tmp_path / "a.usda").read_text().count("/World/posts") == (tmp_path / "b.usda").read_text().count(
        "/World/posts"
    )


def test_robots_start_and_stand_on_the_new_ground(pair):
    _, env = pair
    env.regenerate(11)
    ground = env.scene.terrain.ground
    assert torch.equal(env.episode_length_buf, torch.zeros(N, dtype=torch.int64))
    for _ in range(70):
        env.step(torch.zeros(N, 8))
    pos = env.scene["robot"].data.body_pos_w[..., :3].numpy()
    above = pos[..., 2] - ground.height_at(pos[..., 0], pos[..., 1])
    assert (above.min(axis=1) > 0.0).all()
    assert (above.min(axis=1) < 0.6).all()
    forces = env.scene["contacts"].data.net_forces_w[..., 2].sum(dim=1)
    assert (forces > 0.5 * 9.81 * env.scene["robot"].data.default_mass.sum(dim=1)).any()
    env.regenerate(7)


def test_no_array_is_replaced(pair):
    """What graphs read stays where it is."""
    _, env = pair

    def pointers():
        holders = {"model": env.sim.model, "mjw": env.sim.solver.mjw_model, "data": env.sim.solver.mjw_data}
        structs = {"terrain": env.scene.terrain.struct, "obstacles": env.scene["obstacles"].struct}
        structs["rays"] = env.scene["lidar"]._field
        found = {f"{k}.{n}": a.ptr for k, h in holders.items() for n, a in arrays(h).items()}
        for key, struct in structs.items():
            values = {n: getattr(struct, n) for n in struct._cls.vars}
            found |= {f"{key}.{n}": v.ptr if isinstance(v, wp.array) else str(v) for n, v in values.items()}
        tensors = {"origins": env.scene.env_origins, "tiles": env.scene.terrain.terrain_origins}
        return found | {k: v.data_ptr() for k, v in (tensors | env.scene.terrain.flat_patches).items()}

    before, recaptures = pointers(), env.sim.recaptures
    env.regenerate(12)
    assert pointers() == before
    assert env.sim.recaptures == recaptures
    env.regenerate(7)


def test_a_saved_state_brings_its_scene(pair):
    _, env = pair
    env.regenerate(9)
    env.step(torch.ones(N, 8))
    state = env.get_state()
    assert state["scenery_seed"] == 9
    after = env.step(torch.ones(N, 8))[0]["policy"]
    env.regenerate(3)
    assert "scenery_seed" not in env.get_state()
    env.set_state(state)
    assert env.scene.scenery_seed == 9
    torch.testing.assert_close(env.step(torch.ones(N, 8))[0]["policy"], after, atol=1e-5, rtol=1e-5)
    env.regenerate(7)


# -- on a GPU


@pytest.mark.gpu
def test_captured_graphs_walk_on_the_new_ground():
    """The graph of a step is recorded once; replayed it does what kernels one by one do in that scene."""
    spec = training(device="cuda:0")
    graph = make(3, spec)
    spec.sim.use_cuda_graph = False
    eager = make(7, spec)
    for _ in range(5):
        graph.step(torch.zeros(N, 8, device="cuda:0"))
    assert graph.plan.graph_count == 1
    graphs = [block.replay for block in graph.plan._recorded]
    graph.regenerate(7)
    eager.reset(seed=5)
    put_beside_posts(eager)
    for action in random_actions(50).to("cuda:0"):
        copy_state((eager, graph))
        (a, *_), (b, *_) = (env.step(action) for env in (eager, graph))
        torch.testing.assert_close(a["policy"], b["policy"], atol=1e-4, rtol=1e-4)
        joints = (env.sim.state.joint_q.numpy() for env in (eager, graph))
        np.testing.assert_allclose(*joints, atol=1e-4)
        rays = (env.scene["lidar"].data.distances for env in (eager, graph))
        torch.testing.assert_close(*rays, atol=1e-2, rtol=1e-3)
    assert [block.replay for block in graph.plan._recorded] == graphs
    graph.regenerate(11)
    for _ in range(100):
        graph.step(torch.zeros(N, 8, device="cuda:0"))
    pos = graph.scene["robot"].data.body_pos_w.cpu().numpy()
    above = pos[..., 2] - graph.scene.terrain.ground.height_at(pos[..., 0], pos[..., 1])
    assert (above.min(axis=1) > 0.0).all()
    assert (above.min(axis=1) < 0.6).all()
