# SPDX-License-Identifier: Apache-2.0
"""Another scene of a specification without a restart."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import torch
import warp as wp
from pxr import UsdGeom

from stripe_newton.assets import AssetBaseCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import DirectRLEnv, DirectRLEnvCfg, ManagerBasedRLEnv, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.rl import (
    OnPolicyRunner,
    RslRlMLPModelCfg,
    RslRlOnPolicyRunnerCfg,
    RslRlPpoAlgorithmCfg,
    RslRlVecEnvWrapper,
)
from stripe_newton.scene import ObstaclesCfg
from stripe_newton.scene.scenery import read_scenery
from stripe_newton.sensors import CameraCfg, ContactSensorCfg, GridPatternCfg, LidarPatternCfg, RayCasterCfg
from stripe_newton.sim import CollisionPropertiesCfg, CuboidCfg, MuJoCoSolverCfg, SimulationCfg, XPBDSolverCfg
from stripe_newton.spec import (
    AssetSpec,
    BoxMesh,
    CylinderMesh,
    Places,
    SceneSpec,
    TerrainInstance,
    TileGridSpec,
    TrainingSpec,
)
from stripe_newton.terrains import Ground
from stripe_tasks.robots import ANT_CFG

SIZE, N = (16.0, 16.0), 4


class Posts(AssetSpec):
    """Posts anywhere, one more or less with each seed."""

    def __init__(self, name="posts", mesh=None, count=40, spread=10):
        super().__init__(name)
        self.mesh, self.count, self.spread = mesh or CylinderMesh("post", (0.15, 1.0)), count, spread

    def generate(self, terrain, rng):
        count = self.count + int(rng.integers(0, self.spread + 1))
        places = rng.uniform(-0.48, 0.48, (count, 2)) * terrain.size
        heights = terrain.ground.height_at(*places.T)
        for index, (place, height) in enumerate(zip(places, heights, strict=True)):
            yield self.create_instance(f"a{index}", self.mesh, (*place, height), scale=rng.uniform(0.8, 1.2))


class Hills(SceneSpec):
    """Hills whose height, friction and colour depend on the seed."""

    def __init__(self, size=SIZE, palette=None, places=True, grows=0, **options):
        self.grows = grows
        wanted = {"init_pos": Places(16, margin=1.0), "target": Places(8, margin=1.0)} if places else None
        super().__init__(size, [Posts()] if palette is None else palette, places=wanted, **options)

    def generate(self, rng):
        count = [round(2.0 * s) + 1 + self.grows * int(rng.integers(1, 5)) for s in self.size]
        x, y = np.meshgrid(*(np.linspace(-0.5 * s, 0.5 * s, n) for s, n in zip(self.size, count, strict=True)))
        relief = rng.uniform(0.2, 0.8)
        heights = relief * np.sin(0.5 * x + rng.uniform(0.0, 6.0)) * np.cos(0.4 * y) + rng.uniform(-1.0, 1.0)
        lower, cell = (-0.5 * self.size[0], -0.5 * self.size[1]), tuple(s / (n - 1) for s, n in zip(self.size, count))
        return TerrainInstance(
            Ground(heights + rng.normal(0.0, 0.01, x.shape), lower, cell), dynamic_friction=float(rng.uniform(0.5, 1.0))
        )


@configclass
class PolicyCfg(ObservationGroupCfg):
    height: ObservationTermCfg = ObservationTermCfg(func=mdp.base_pos_z)
    joints: ObservationTermCfg = ObservationTermCfg(func=mdp.joint_pos)
    scan: ObservationTermCfg = ObservationTermCfg(
        func=mdp.height_scan, params={"sensor": SceneEntityCfg("scanner"), "offset": 0.5}
    )


@configclass
class EventsCfg:
    start: EventTermCfg = EventTermCfg(
        func=mdp.reset_root_state_from_terrain,
        mode="reset",
        params={"pose_range": {}, "velocity_range": {}, "move_origin": True},
    )


def scanner(pattern=None, **options):
    return RayCasterCfg(
        prim_path="{ENV_REGEX_NS}/Robot/torso",
        offset=RayCasterCfg.OffsetCfg(pos=(0.0, 0.0, 1.0)),
        pattern_cfg=pattern or GridPatternCfg(resolution=0.5, size=(1.0, 1.0)),
        mesh_prim_paths=["/World/ground"],
        **options,
    )


def lidar():
    return LidarPatternCfg(
        channels=3, vertical_fov_range=(-40.0, 0.0), horizontal_fov_range=(0.0, 360.0), horizontal_res=30.0
    )


def training(scene=None, device="cpu", **changes):
    fields = {
        "observations": {"policy": PolicyCfg()},
        "actions": {"efforts": mdp.JointEffortActionCfg(joint_names=[".*"], scale=5.0)},
        "rewards": {"alive": RewardTermCfg(func=mdp.is_alive, weight=1.0)},
        "terminations": {"time_out": TerminationTermCfg(func=mdp.time_out, time_out=True)},
        "events": EventsCfg(),
        "obstacles": ObstaclesCfg(slots=6, reach=1.2),
        "sensors": {
            "contacts": ContactSensorCfg(prim_path="{ENV_REGEX_NS}/Robot/.*"),
            "scanner": scanner(),
            "lidar": scanner(lidar()),
        },
        "sim": SimulationCfg(device=device, dt=1 / 120, solver=MuJoCoSolverCfg(njmax=400, nconmax=80)),
        "num_envs": N,
        "env_spacing": 1.0,
        **changes,
    }
    return TrainingSpec(scene=scene or Hills(), robot=ANT_CFG, **fields)


def make(seed, spec=None):
    cfg = (spec or training()).to_env_cfg(decimation=2, episode_length_s=2.0, seed=seed)
    cfg.seed = 0
    env = ManagerBasedRLEnv(cfg)
    env.reset()
    return env


@pytest.fixture(scope="module")
def pair():
    """The same scene, of one environment that was made with it, and of one that came to it."""
    fresh, moved = make(7), make(3)
    for _ in range(5):
        moved.step(torch.rand(N, 8) - 0.5)
    moved.regenerate(7)
    return fresh, moved


def arrays(holder):
    """Arrays by name; those of structs are left out."""
    found = {k: v for k, v in vars(holder).items() if isinstance(v, wp.array) and v.size}
    return {k: v for k, v in found.items() if not isinstance(v.dtype, wp._src.codegen.Struct)}


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
    compared = 0
    for name, array in arrays(fresh.solver.mjw_model).items():
        mine, its = array.numpy(), getattr(moved.solver.mjw_model, name).numpy()
        if name in ("qpos0", "qpos_spring", "body_pos"):  # of free roots, where they were built
            continue
        slots = name in ("geom_size", "geom_aabb", "geom_rbound")
        if slots:  # those of obstacles are where robots are
            mine, its = (a[:, : a.shape[1]][:, _ground_geom(s)] for a, s in ((mine, fresh), (its, moved)))
        np.testing.assert_allclose(mine, its, atol=1e-5, rtol=1e-5, err_msg=name)
        compared += 1
    assert compared > 100
    for name in ("hfield_size", "hfield_data"):
        np.testing.assert_allclose(*(getattr(s.solver.mj_model, name) for s in (fresh, moved)), atol=1e-6)
    for name in ("geom_pos", "geom_aabb", "geom_rbound"):
        rows = [getattr(s.solver.mj_model, name)[_ground_geom(s)] for s in (fresh, moved)]
        np.testing.assert_allclose(*rows, atol=1e-6)
    poses = [s.solver.mjw_data.geom_xpos.numpy()[:, _ground_geom(s)] for s in (fresh, moved)]
    np.testing.assert_allclose(*poses, atol=1e-6)


def _ground_geom(sim):
    shape = list(sim.model.shape_label).index("/World/ground/terrain")
    return int(np.flatnonzero(sim.solver.mjc_geom_to_newton_shape.numpy()[0] == shape)[0])


def copy_state(pair):
    """Both in the first one's state, which stays."""
    fresh, moved = pair
    moved.set_state({**fresh.get_state(), "scenery_seed": 7})


def random_actions(steps):
    return 0.4 * torch.rand(steps, N, 8, generator=torch.Generator().manual_seed(0)) - 0.2


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
        counts = [int(env.sim.solver.mjw_data.nacon.numpy()[0]) for env in pair]
        assert counts[0] == counts[1]
        torch.testing.assert_close(*(env.scene["obstacles"].data.distance for env in pair), atol=1e-5, rtol=1e-5)
        touched += int((forces[0].norm(dim=-1) > 1.0).any())
        near += int(env_near(pair[0]))
    assert touched > 20
    assert near > 20


def put_beside_posts(env):
    """Each robot falls onto a post's side."""
    posts, ground = env.scene["obstacles"].capsules, env.scene.terrain.ground
    at = posts.positions[np.abs(posts.positions[:, :2]).max(axis=1) < 6.0][:N, :2] + [0.3, 0.2]
    pose = env.scene["robot"].data.root_state_w[:, :7].clone()
    place = np.column_stack([at, ground.height_at(*at.T) + 0.6])
    pose[:, :3] = torch.tensor(place, dtype=torch.float32, device=pose.device)
    env.scene["robot"].write_root_pose_to_sim(pose)
    env.sim.forward()


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


def test_pictures_show_the_new_scene():
    cfg = training().to_env_cfg(seed=3)
    cfg.viewer.resolution, cfg.viewer.eye, cfg.viewer.lookat = (48, 32), (9.0, 9.0, 6.0), (0.0, 0.0, 0.0)
    cfg.viewer.origin_type = "world"
    env = ManagerBasedRLEnv(cfg, "rgb_array")
    env.reset()
    before = env.render().astype(int)
    env.regenerate(7)
    after = env.render().astype(int)
    env.regenerate(3)
    again = env.render().astype(int)
    assert np.abs(before - after).max() > 30
    assert np.abs(before - again).mean() < 0.2 * np.abs(before - after).mean()


def test_robots_start_and_stand_on_the_new_ground(pair):
    _, env = pair
    env.regenerate(11)
    ground = env.scene.terrain.ground
    assert torch.equal(env.episode_length_buf, torch.zeros(N, dtype=torch.int64))
    for _ in range(100):
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


@pytest.mark.parametrize(
    "solver",
    [
        MuJoCoSolverCfg(njmax=400, nconmax=80, use_mujoco_cpu=True),
        XPBDSolverCfg(),
    ],
    ids=["mujoco_cpu", "xpbd"],
)
def test_other_ways_of_contact_find_the_new_ground(solver):
    sim = SimulationCfg(device="cpu", dt=1 / 240, solver=solver)
    options = {"obstacles": None, "sensors": {"scanner": scanner()}, "sim": sim, "num_envs": 1}
    env = make(3, training(Hills(palette=[]), **options))
    old = env.scene.terrain.ground
    env.regenerate(11)
    new = env.scene.terrain.ground
    heights = []
    for _ in range(110):
        env.step(torch.zeros(1, 8))
        pos = env.scene["robot"].data.body_pos_w[0, :, :3].numpy()
        heights.append([(pos[:, 2] - g.height_at(pos[:, 0], pos[:, 1])).min() for g in (old, new)])
    assert abs(heights[-1][0] - heights[-1][1]) > 0.4
    assert 0.0 < heights[-1][1] < 0.6


class Roamer(DirectRLEnv):
    """Starts in the middle of the terrain, at its height."""

    def _setup_scene(self):
        self.scene.clone_environments()

    def _pre_physics_step(self, actions):
        self.actions = actions

    def _apply_action(self):
        pass

    def _get_dones(self):
        late = self.episode_length_buf >= self.max_episode_length
        return torch.zeros_like(late), late

    def _get_rewards(self):
        return torch.zeros(self.num_envs)

    def _reset_idx(self, env_ids):
        super()._reset_idx(env_ids)
        robot = self.scene["robot"]
        state = robot.data.default_root_state[env_ids].clone()
        state[:, :3] += self.scene.env_origins[env_ids]
        robot.write_root_pose_to_sim(state[:, :7], env_ids)

    def _get_observations(self):
        return {"policy": self.scene["robot"].data.root_pos_w[:, 2:3].clone()}


@configclass
class RoamerCfg(DirectRLEnvCfg):
    decimation = 2
    episode_length_s = 1.0
    observation_space = 1
    action_space = 8


def test_a_direct_environment_goes_on_in_another_scene():
    spec = training(Hills(places=False))
    factory = spec.scene.create_instance(N, 0.5, seed=3)
    factory.add_sensor("obstacles", ObstaclesCfg(of_scenery=True, reach=1.2))
    env = Roamer(RoamerCfg(sim=spec.sim, scene=factory.get_scene(ANT_CFG)))
    env.reset()
    for _ in range(3):
        env.step(torch.zeros(N, 8))
    assert (env.episode_length_buf == 3).all()
    env.regenerate(11)
    assert (env.episode_length_buf == 0).all()
    ground, at = env.scene.terrain.ground, env.scene.env_origins.numpy()
    np.testing.assert_allclose(at[:, 2], ground.height_at(at[:, 0], at[:, 1]), atol=1e-5)
    start = ANT_CFG.init_state.pos[2]
    np.testing.assert_allclose(env.obs_buf["policy"][:, 0], at[:, 2] + start, atol=1e-5)
    env.step(torch.zeros(N, 8))


def test_levels_of_tiles_stay():
    posts = Posts(count=5)
    tiles = TileGridSpec([Hills((8.0, 8.0), [posts]), Hills((8.0, 8.0), [posts])], types=2, fade=1.0, border=1.0)
    env = make(3, training(tiles, sensors={"scanner": scanner()}))
    terrain = env.scene.terrain
    terrain.terrain_levels[:] = torch.tensor([1, 1, 0, 1])
    old = terrain.terrain_origins.clone()
    env.scene.regenerate(5)
    assert terrain.terrain_levels.tolist() == [1, 1, 0, 1]
    assert not torch.equal(old, terrain.terrain_origins)
    assert torch.equal(
        env.scene.env_origins, terrain.terrain_origins[terrain.terrain_levels.long(), terrain.terrain_types.long()]
    )
    assert env.sim.env_origin.ptr == env.scene.env_origins.data_ptr()


def runner(folder, count, **changes):
    env = RslRlVecEnvWrapper(make(3))
    small = RslRlMLPModelCfg(hidden_dims=(8,))
    agent = RslRlOnPolicyRunnerCfg(
        num_steps_per_env=4,
        max_iterations=count,
        save_interval=1,
        regenerate_interval=2,
        experiment_name="hills",
        actor=RslRlMLPModelCfg(hidden_dims=(8,), distribution_cfg=RslRlMLPModelCfg.GaussianDistributionCfg()),
        critic=small,
    ).replace(**changes)
    torch.manual_seed(1)
    return OnPolicyRunner(env, agent, folder)


@pytest.mark.parametrize("stop", [2, 3])
def test_training_goes_from_scene_to_scene_and_resumes(tmp_path, stop):
    whole = runner(tmp_path / "whole", 5)
    seeds = []
    whole.logger.iteration_hooks.append(lambda it: seeds.append(whole.env.unwrapped.scene.scenery_seed))
    whole.learn()
    assert seeds == [3, 4, 4, 5, 5]
    again = runner(tmp_path / "again", 5)
    again.resume(tmp_path / "whole" / "checkpoints" / f"model_{stop - 1}.pt")
    assert again.env.unwrapped.scene.scenery_seed == 4
    assert again.env.unwrapped.scene.first_scenery_seed == 3
    seeds.clear()
    again.logger.iteration_hooks.append(lambda it: seeds.append(again.env.unwrapped.scene.scenery_seed))
    again.learn()
    assert seeds == [4, 5, 5][stop - 2 :]
    heights = [r.env.unwrapped.scene.terrain.struct.heights.numpy() for r in (whole, again)]
    np.testing.assert_array_equal(*heights)


def test_training_acts_on_the_first_observations_of_a_scene(tmp_path):
    """rsl_rl's loop holds the last ones; the episode's sums begin at zero."""
    once = runner(tmp_path, 2)
    seen = []
    act = once.alg.act
    once.alg.act = lambda obs: seen.append(obs["policy"].clone()) or act(obs)
    expected = []
    once.logger.iteration_hooks.append(lambda it: expected.append(once.env.unwrapped.obs_buf["policy"].clone()))
    once.logger.iteration_hooks.append(lambda it: expected.append(once.logger.cur_episode_length.sum()))
    once.learn(3)
    assert torch.equal(seen[8], expected[2])
    assert not torch.equal(seen[7], seen[8])
    assert expected[1] == 4 * N
    assert expected[3] == 0


def test_training_says_at_its_start_that_it_cannot():
    env = RslRlVecEnvWrapper(make(3, training(obstacles=None)))
    agent = RslRlOnPolicyRunnerCfg(regenerate_interval=2, algorithm=RslRlPpoAlgorithmCfg(num_mini_batches=1))
    with pytest.raises(ConfigError, match=r"regenerate_interval: is 2, but assets like '.*' have colliders"):
        OnPolicyRunner(env, agent)
    with pytest.raises(ConfigError, match="regenerate_interval: is -1"):
        RslRlOnPolicyRunnerCfg(regenerate_interval=-1).validate()


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


# -- what cannot follow


def refused(spec, match, seed=5):
    env = make(3, spec)
    heights = env.scene.terrain.struct.heights.numpy()
    stage = env.scene.stage.GetRootLayer().ExportToString()
    with pytest.raises(ValueError, match=match):
        env.regenerate(seed)
    np.testing.assert_array_equal(env.scene.terrain.struct.heights.numpy(), heights)
    assert env.scene.stage.GetRootLayer().ExportToString() == stage
    assert env.scene.scenery_seed == 3
    env.step(torch.zeros(N, 8))


def test_ordinary_colliders_are_refused():
    refused(training(obstacles=None), r"set TrainingSpec\(obstacles=ObstaclesCfg\(\.\.\.\)\)")


def test_another_grid_is_refused():
    spec = Hills(places=False, grows=1)
    refused(
        training(spec, events=None, sensors={"scanner": scanner()}),
        r"seed 5: '/World/ground': the new ground has heights",
    )


def test_too_many_obstacles_name_the_number():
    spec = Hills(palette=[Posts(count=5, spread=300)])
    counts = [len(read_scenery(spec.create(s).stage).paths) for s in (3, 5)]
    more = counts[1] > counts[0]
    seeds = (3, 5) if more else (5, 3)
    count = max(counts)
    room = ObstaclesCfg(slots=12, reach=1.2, capacity=count - 1)
    env = make(seeds[0], training(spec, obstacles=room))
    with pytest.raises(ValueError, match=rf"{count} obstacles do not fit, set ObstaclesCfg\(capacity={count}\)"):
        env.regenerate(seeds[1])


def test_boxes_among_obstacles_are_refused():
    class Sometimes(Posts):
        def generate(self, terrain, rng):
            self.mesh = BoxMesh("box", (0.2, 0.2, 0.2)) if terrain.kind else CylinderMesh("post", (0.15, 1.0))
            return super().generate(terrain, rng)

    class Boxes(Hills):
        def generate(self, rng):
            terrain = super().generate(rng)
            terrain.kind = self.kind
            return terrain

    spec = Boxes(palette=[Sometimes()])
    spec.kind = False
    env = make(3, training(spec))
    spec.kind = True
    with pytest.raises(ValueError, match="is a box, which no capsule stands for"):
        env.regenerate(5)


def test_cameras_are_refused():
    camera = CameraCfg(prim_path="{ENV_REGEX_NS}/Robot/torso/cam", width=8, height=8)
    refused(training(sensors={"scanner": scanner(), "eye": camera}), "the camera 'eye' sees the meshes")


def test_what_is_fixed_in_the_environments_is_refused():
    table = AssetBaseCfg(
        prim_path="{ENV_REGEX_NS}/Table",
        spawn=CuboidCfg(size=(0.2, 0.2, 0.2), collision_props=CollisionPropertiesCfg()),
    )
    refused(training(assets={"table": table}), r"'/World/envs/env_0/Table.*' is fixed to the world in each environment")


def test_a_scene_of_a_file_is_refused(tmp_path):
    file = Hills().create(3).export(tmp_path / "hills.usda")
    cfg = training().to_env_cfg(seed=3)
    cfg.scene.scenery.spawn = cfg.scene.scenery.spawn.replace(spec=None, usd_path=str(file))
    env = ManagerBasedRLEnv(cfg)
    with pytest.raises(ValueError, match=r"is of the file '.*hills\.usda'"):
        env.regenerate(5)


def test_a_scene_without_a_specification_is_refused():
    from tests.cart_env import make as make_cart

    with pytest.raises(ValueError, match="the scene is of no specification"):
        make_cart().regenerate(1)


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
    graphs = [segment.graph for segment in graph.plan._segments]
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
    assert [segment.graph for segment in graph.plan._segments] == graphs
    graph.regenerate(11)
    for _ in range(100):
        graph.step(torch.zeros(N, 8, device="cuda:0"))
    pos = graph.scene["robot"].data.body_pos_w.cpu().numpy()
    above = pos[..., 2] - graph.scene.terrain.ground.height_at(pos[..., 0], pos[..., 1])
    assert (above.min(axis=1) > 0.0).all()
    assert (above.min(axis=1) < 0.6).all()
