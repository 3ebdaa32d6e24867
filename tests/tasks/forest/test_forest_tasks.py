# SPDX-License-Identifier: Apache-2.0
"""Forest tasks: starts, terminations, changes of level, and play."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest
import torch

import stripe_tasks  # noqa: F401
from stripe_newton.cli.run_configs import load_configs
from stripe_newton.cli.tasks import load_cfg
from stripe_newton.cli.user_error import UserError
from stripe_newton.rl import RunFolder
from stripe_newton.specifications import TileGridSpec
from stripe_newton.specifications.places import footprints
from stripe_tasks.forest import ForestSpec, reach, walk
from tests.helpers.small_scenes import numpy

NAMES = [f"Stripe-Forest-{task}-Quadruped{play}-v0" for task in ("Walk", "Reach") for play in ("", "-Play")]
N, LEVELS, TILE = 4, 3, (30.0, 30.0)


def small_woods() -> TileGridSpec:
    """As the task's, with fewer and smaller tiles."""
    densities = np.linspace(100.0, 900.0, LEVELS)
    specs = [ForestSpec(TILE, d, relief=5.0, resolution=0.3, undergrowth=0.0) for d in densities]
    return TileGridSpec(specs, 2, border=6.0, max_init_level=1)


@pytest.fixture(scope="module")
def shared():
    cfg = reach.training(small_woods(), num_envs=N).to_env_cfg(episode_length_s=reach.EPISODE, seed=2)
    cfg.sim.device, cfg.seed = "cpu", 1
    env = reach.ForestReachEnv(cfg)
    yield env
    env.close()


@pytest.fixture
def env(shared):
    shared.reset(seed=1)
    return shared


def goals(env) -> np.ndarray:
    return env.context.arrays["commands.goal.pos"].numpy().astype(float)


def roots(env) -> np.ndarray:
    return numpy(env.scene["robot"].data.root_pos_w).astype(float)


def rest(env):
    return env.step(torch.zeros(N, env.single_action_space.shape[0]))


def put(env, index: int, place) -> None:
    """Move a robot, standing as it does, to a place of the plane or of space."""
    robot, ground = env.scene["robot"], env.scene.terrain.ground
    pose = robot.data.root_pose_w.clone()
    height = place[2] if len(place) > 2 else float(ground.height_at(np.array(place[0]), np.array(place[1]))) + 0.4
    pose[index, :3] = torch.tensor([place[0], place[1], height])
    robot.write_root_pose_to_sim(pose)
    env.sim.forward()


def scene_of(env):
    return env.cfg.scene.scenery.spawn.made()


# -- the environment


def test_random_steps_stay_finite(env):
    generator = torch.Generator().manual_seed(0)
    for _ in range(30):
        obs, reward, _, _, extras = env.step(2.0 * torch.rand(N, 12, generator=generator) - 1.0)
        assert all(torch.isfinite(o).all() for o in obs.values())
        assert torch.isfinite(reward).all()
        assert all(np.isfinite(float(v)) for v in extras["log"].values())


def test_robots_start_clear_of_obstacles_and_with_their_feet_on_the_ground(env):
    circles, ground, robot = footprints(scene_of(env).terrain), env.scene.terrain.ground, env.scene["robot"]
    feet = [i for i, name in enumerate(robot.body_names) if name.endswith("_foot")]
    assert len(feet) == 4
    for seed in range(15):
        env.reset(seed=seed)
        away = np.linalg.norm(roots(env)[:, None, :2] - circles[:, :2], axis=-1) - circles[:, 2]
        assert away.min() >= 0.7 - 1e-4
        at = numpy(robot.data.body_pos_w).astype(float)[:, feet]
        over = at[..., 2] - ground.height_at(at[..., 0], at[..., 1]) - 0.022  # radius of a foot
        assert over.min() > -0.03
        assert over.min(axis=1).max() < 0.3  # and they fall no more than this
        starts = env.scene.terrain.struct.env_origin.numpy()
        np.testing.assert_allclose(starts[:, :2], roots(env)[:, :2], atol=1e-4)


def test_goals_are_as_far_away_as_asked_clear_and_on_the_same_tile(env):
    circles, terrain, far = footprints(scene_of(env).terrain), env.scene.terrain, []
    for seed in range(15):
        env.reset(seed=seed)
        goal, root = goals(env), roots(env)
        far += np.linalg.norm((goal - root)[:, :2], axis=1).tolist()
        away = np.linalg.norm(goal[:, None, :2] - circles[:, :2], axis=-1) - circles[:, 2]
        assert away.min() >= 0.6 - 1e-4
        level, kind = terrain.struct.level.numpy(), terrain.struct.kind.numpy()
        low = (np.stack([level, kind], axis=1) - 0.5 * np.array([LEVELS, 2])) * TILE
        for points in (goal[:, :2], root[:, :2]):
            assert ((points >= low + 2.0 - 1e-4) & (points <= low + TILE - 2.0 + 1e-4)).all()
        height = goal[:, 2] - terrain.ground.height_at(goal[:, 0], goal[:, 1])
        default = float(env.scene["robot"].data.default_root_pose[0, 2])
        assert (np.abs(height - default) < 0.35).all()
    assert min(far) >= 10.0 - 1e-3
    assert max(far) <= 20.0 + 1e-3
    assert np.ptp(far) > 5.0


def test_the_marker_is_at_the_goal(env):
    np.testing.assert_allclose(numpy(env.scene["goal"].data.root_pos_w), goals(env), atol=1e-5)
    before = goals(env)
    put(env, 2, before[2, :2])
    rest(env)
    assert np.linalg.norm(goals(env)[2] - before[2]) > 1.0
    np.testing.assert_allclose(goals(env)[[0, 1, 3]], before[[0, 1, 3]], atol=1e-6)
    np.testing.assert_allclose(numpy(env.scene["goal"].data.root_pos_w), goals(env), atol=1e-5)


def test_a_robot_at_its_goal_succeeds_and_goes_on_to_a_harder_tile(env):
    terrain, goal = env.scene.terrain, goals(env)
    level = terrain.struct.level.numpy().copy()
    put(env, 1, goal[1, :2] + [0.3, 0.0])
    put(env, 2, goal[2, :2] + [0.0, 0.7])
    _, reward, terminated, truncated, extras = rest(env)
    assert env.success.tolist() == terminated.tolist() == [False, True, False, False]
    assert not truncated.any()
    assert reward[1] > 5.0 + reward[[0, 2, 3]].max()
    assert extras["log"]["Episode_Termination/goal_reached"] == 1.0
    after = terrain.struct.level.numpy()
    assert after[1] == level[1] + 1 if level[1] < LEVELS - 1 else after[1] in range(LEVELS)
    np.testing.assert_array_equal(after[[0, 2, 3]], level[[0, 2, 3]])
    low = (np.array([after[1], terrain.struct.kind.numpy()[1]]) - 0.5 * np.array([LEVELS, 2])) * TILE
    assert (roots(env)[1, :2] >= low).all()
    assert (roots(env)[1, :2] <= low + TILE).all()


def test_a_robot_that_gets_nowhere_goes_back_to_an_easier_tile(env):
    env.scene.terrain.struct.level.assign([2, 1, 0, 1])
    env.reset(options={"reset_mask": torch.ones(N, dtype=torch.bool)})
    level = env.scene.terrain.struct.level.numpy().copy()
    env.episode_length_buf = torch.full((N,), env.max_episode_length - 1)
    *_, truncated, _ = rest(env)
    assert truncated.all()
    np.testing.assert_array_equal(env.scene.terrain.struct.level.numpy(), np.maximum(level - 1, 0))


def test_a_robot_in_a_trunk_or_off_the_ground_is_terminated(env):
    trunk = next(i for i in scene_of(env).terrain.placed["trees"] if i.scale * i.mesh.colliders()[0].size[0] > 0.1)
    wide = trunk.scale * trunk.mesh.colliders()[0].size[0]
    x, y, z = trunk.position
    env.scene["robot"].data.root_vel_w[0, 0] = 2.0
    put(env, 0, (x - wide - 0.32, y, z + 0.5))
    pose = env.scene["robot"].data.root_pose_w.clone()
    pose[0, 3:] = torch.tensor([0.0, 0.0, 0.0, 1.0])
    env.scene["robot"].write_root_pose_to_sim(pose)
    half = 0.5 * np.array(env.scene.terrain.ground.size)
    put(env, 3, half - 1.0)
    ended = np.zeros((3, N), dtype=bool)
    for _ in range(8):
        rest(env)
        names = ("base_contact", "out_of_bounds", "goal_reached")
        ended |= np.stack([numpy(env.termination_manager.get_term(n)).astype(bool) for n in names])
        if ended[0, 0] and ended[1, 3]:
            break
    assert ended[0].tolist() == [True, False, False, False]
    assert ended[1].tolist() == [False, False, False, True]
    assert not ended[2].any()


def test_no_part_of_a_step_needs_the_host(env):
    text = env.describe()
    assert "goal marker" in text
    assert "torch" not in text
    assert "host" not in text


# -- what is registered


@pytest.mark.parametrize("name", NAMES)
def test_configs_are_valid(name):
    cfg, agent = load_cfg(name, "env"), load_cfg(name, "agent")
    cfg.validate()
    assert agent.experiment_name == f"forest_{name.split('-')[2].lower()}_quadruped"
    assert gymnasium.spec(name).vector_entry_point is not None


@pytest.mark.parametrize("task", ["Walk", "Reach"])
def test_played_are_other_woods(task):
    name = f"Stripe-Forest-{task}-Quadruped"
    cfg, play = load_cfg(f"{name}-v0", "env"), load_cfg(f"{name}-Play-v0", "env")
    made, played = cfg.scene.scenery.spawn, play.scene.scenery.spawn
    assert made.seed != played.seed
    assert isinstance(made.spec, TileGridSpec)
    assert isinstance(played.spec, ForestSpec)
    assert len(made.spec.levels) == walk.LEVELS
    densities = [level.palette["trees"].density for level in made.spec.levels]
    assert densities == sorted(densities)
    assert densities[0] < played.spec.palette["trees"].density < densities[-1]
    assert cfg.curriculum is not None
    assert play.curriculum is None
    assert cfg.scene.num_envs == 4096
    assert play.scene.num_envs == 64
    for field in ("observations", "actions", "commands", "events", "decimation", "sim"):
        assert getattr(cfg, field) == getattr(play, field), field
    assert cfg.rewards.replace(fallen=None) == play.rewards
    ends = {n for n, term in vars(play.terminations).items() if term is not None}
    assert ends == {n for n, term in vars(cfg.terminations).items() if term is not None} - {"base_contact"} | {
        "bad_orientation",
        "on_belly",
    }


def test_a_run_fits_what_is_played_and_nothing_else(tmp_path):
    name = "Stripe-Forest-Reach-Quadruped-v0"
    env, agent = load_cfg(name, "env"), load_cfg(name, "agent")
    agent.max_iterations, env.scene.num_envs, env.episode_length_s = 77, 5, 9.0
    run = RunFolder.create(tmp_path, "test")
    run.write_params(env, agent)
    run.write_task(name)
    play = load_configs(name.replace("-v0", "-Play-v0"), run)
    assert play.agent.max_iterations == 77
    assert play.env.scene.num_envs == 64
    assert play.env.episode_length_s == reach.EPISODE
    own = load_configs(name, run)
    assert own.env.scene.num_envs == 5
    assert own.env.episode_length_s == 9.0
    for other in ("Stripe-Forest-Walk-Quadruped-Play-v0", "Stripe-Forest-Walk-Quadruped-v0", "Stripe-Ant-v0"):
        with pytest.raises(UserError, match=f"is a run of {name}, not of {other}"):
            load_configs(other, run)
