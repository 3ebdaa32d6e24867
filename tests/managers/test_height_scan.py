# SPDX-License-Identifier: Apache-2.0
"""Height scan: against NumPy, with a thread for each ray in the generated kernel, with noise, in an environment."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.mdp.scan import height_scan
from stripe_kernels.sensors.ray import RayCasterData
from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import EventTermCfg, ObservationTermCfg, SceneEntityCfg
from stripe_newton.noise import GaussianNoiseCfg, NoiseModelWithAdditiveBiasCfg, UniformNoiseCfg
from stripe_newton.sensors import GridPatternCfg, RayCasterCfg
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg
from tests.helpers.manager_world import observation_group
from tests.helpers.ray_world import SceneryCfg, add_field, body, rays_of, surface_height

GRID = GridPatternCfg(resolution=0.1, size=(1.6, 1.0))
SENSOR = {"sensor_cfg": SceneEntityCfg("scanner")}
NOISE = UniformNoiseCfg(n_min=-0.1, n_max=0.1)


@wp.kernel(enable_backward=False)
def scan(sensor: RayCasterData, ray_ids: wp.array[int], offset: float, out: wp.array2d[float]):
    env = wp.tid()
    height_scan(env, sensor, ray_ids, out[env], offset)


def test_the_term_is_what_its_formula_says():
    rng, rays = np.random.default_rng(0), [5, 0, 30, 2]
    position, hits = rng.normal(size=(8, 3)), rng.normal(size=(8, 31, 3))
    hits[3, 5] = np.inf
    sensor, out = RayCasterData(), wp.zeros((8, 4), dtype=float)
    sensor.pos_w, sensor.ray_hits_w = wp.array(position, dtype=wp.vec3), wp.array(hits, dtype=wp.vec3)
    wp.launch(scan, dim=8, inputs=[sensor, wp.array(rays, dtype=int), 0.3], outputs=[out])
    np.testing.assert_allclose(out.numpy(), position[:, None, 2] - hits[:, rays, 2] - 0.3, rtol=1e-5, atol=1e-6)
    assert out.numpy()[3, 0] == -np.inf


# -- in an environment


def scan_env(
    num_envs: int = 3, device: str = "cpu", changes: Any = None, **terms: ObservationTermCfg
) -> ManagerBasedRLEnv:
    """A pole to be balanced, beside a free body that carries the scanner, over a height field."""
    cfg = CartpoleManagerEnvCfg(seed=4)
    cfg.sim.device, cfg.scene.num_envs, cfg.scene.env_spacing = device, num_envs, 0.0

    @configclass
    class Scene(type(cfg.scene)):
        body: RigidObjectCfg = body()
        field = SceneryCfg(build=add_field)
        scanner: RayCasterCfg = RayCasterCfg(
            prim_path="{ENV_REGEX_NS}/Body",
            pattern_cfg=GRID,
            ray_alignment="yaw",
            mesh_prim_paths=["/World/ground/field"],
        )

    cfg.scene = Scene(**{k: getattr(cfg.scene, k) for k in cfg.scene.__dataclass_fields__})
    cfg.scene.scanner = cfg.scene.scanner.replace(**(changes or {}))
    pose = {"x": (-0.5, 0.5), "y": (-0.5, 0.5), "z": (1.0, 2.0), "yaw": (-3.0, 3.0)}
    params = {"asset_cfg": SceneEntityCfg("body"), "pose_range": pose, "velocity_range": {}}
    cfg.events = {"body": EventTermCfg(func=mdp.reset_root_state_uniform, mode="reset", params=params)}
    cfg.observations = {"policy": observation_group(terms, enable_corruption=True)}
    return ManagerBasedRLEnv(cfg)


def expected(env: ManagerBasedRLEnv, offset: float = 0.5) -> np.ndarray:
    robot = env.scene["body"].data
    poses = torch.cat([robot.root_pos_w, robot.root_quat_w], dim=1).double().cpu().numpy()
    starts, _ = rays_of(poses, *GRID.rays(), "yaw")
    return poses[:, 2:3] - surface_height(starts[..., 0], starts[..., 1]) - offset


def test_an_environment_observes_187_heights_of_its_present_state(device):
    scan = ObservationTermCfg(func=mdp.height_scan, params=SENSOR, clip=(-1.0, 1.0), scale=2.0)
    env = scan_env(device=device, scan=scan)
    assert env.scene.sensors["scanner"].method == "height field, lookup"
    obs, _ = env.reset(seed=1)
    assert obs["policy"].shape == (3, 187)
    np.testing.assert_allclose(obs["policy"].cpu().numpy(), 2.0 * np.clip(expected(env), -1.0, 1.0), atol=1e-5)
    for _ in range(3):  # the third is a replayed graph
        env.scene["robot"].data.joint_pos[1, 0] = 100.0  # off the track: an episode ends
        before = obs["policy"].clone()
        obs, _, terminated, _, _ = env.step(torch.zeros(3, 1, device=device))
        assert terminated.tolist() == [False, True, False]
        np.testing.assert_allclose(obs["policy"].cpu().numpy(), 2.0 * np.clip(expected(env), -1.0, 1.0), atol=1e-5)
        assert (obs["policy"] != before).any(dim=1).all()
    env.close()


def test_a_thread_computes_a_ray():
    terms = {
        "plain": ObservationTermCfg(func=mdp.height_scan),  # there is but one ray caster
        "noisy": ObservationTermCfg(func=mdp.height_scan, params=SENSOR, noise=NOISE, clip=(-1.0, 1.0)),
        "some": ObservationTermCfg(func=mdp.height_scan, params={**SENSOR, "ray_ids": [7, 3], "offset": 0.0}),
    }
    env = scan_env(**terms)
    kernels = env.describe(kernels=True)
    assert "if part >= 0 and part < 2:" in kernels  # neighbouring threads are environments
    assert "part = 2 + (thread - 2 * num_envs) % 187" in kernels  # and here rays, once for both
    assert "if part >= 2 and part < 189" in kernels
    obs, _ = env.reset(seed=1)
    plain, noisy, some = obs["policy"].split([187, 187, 2], dim=1)
    np.testing.assert_allclose(some.numpy(), plain[:, [7, 3]].numpy() + 0.5, atol=1e-6)
    difference = (noisy - plain)[plain.abs() < 0.9].double()
    assert difference.abs().max() <= 0.1001
    assert abs(difference.mean()) < 0.02
    assert abs(difference.std() - 0.2 / 12**0.5) < 0.01
    state = env.get_state()
    again = env.step(torch.zeros(3, 1))[0]["policy"].clone()
    fresh = (again - obs["policy"])[:, 187:374] - (again - obs["policy"])[:, :187]
    assert fresh.abs().max() > 0.05  # other noise in another step
    env.set_state(state)
    assert torch.equal(env.step(torch.zeros(3, 1))[0]["policy"], again)
    env.close()


def test_groups_that_see_the_same_have_it_computed_once():
    scan = ObservationTermCfg(func=mdp.height_scan, params=SENSOR, noise=NOISE, clip=(-1.0, 1.0))
    other = {**SENSOR, "offset": 0.2}
    cfg = scan_env(scan=scan).cfg
    alone = ManagerBasedRLEnv(cfg.copy())
    cfg.observations["critic"] = observation_group({"scan": scan.replace(noise=None, clip=None, scale=2.0)})
    cfg.observations["lower"] = observation_group({"scan": scan.replace(noise=None, clip=None, params=other)})
    env = ManagerBasedRLEnv(cfg)
    kernels = env.describe(kernels=True)
    assert kernels.count(" height_scan(env") == 3  # two of them only if a parameter says so
    assert "part < 374" not in kernels
    for index in range(3):
        seen, lone = (e.reset(seed=1)[0] if index == 0 else e.step(torch.zeros(3, 1))[0] for e in (env, alone))
        if index == 1:  # a curriculum may tune one of them
            for e in (env, alone):
                e.context.parameters["observations.policy.scan.offset"] = 0.3
            continue
        assert torch.equal(seen["policy"], lone["policy"])  # and the same noise
        np.testing.assert_allclose(seen["critic"].numpy(), 2.0 * expected(env), atol=1e-5)
        np.testing.assert_allclose(seen["lower"].numpy(), expected(env, 0.2), atol=1e-5)
    for e in (env, alone):
        e.close()


def bias_model(std: float = 0.01) -> NoiseModelWithAdditiveBiasCfg:
    bias = UniformNoiseCfg(n_min=0.2, n_max=0.4)
    return NoiseModelWithAdditiveBiasCfg(noise_cfg=GaussianNoiseCfg(std=std), bias_noise_cfg=bias)


def test_noise_with_bias_and_history_keep_their_meaning():
    terms = {
        "biased": ObservationTermCfg(func=mdp.height_scan, params=SENSOR, noise=bias_model(std=0.0)),
        "past": ObservationTermCfg(func=mdp.height_scan, params=SENSOR, history_length=2),
    }
    env = scan_env(**terms)
    env.reset(seed=1)
    first = expected(env)
    obs, *_ = env.step(torch.zeros(3, 1))
    biased, past = obs["policy"].split([187, 374], dim=1)
    offset = biased.double().numpy() - expected(env)
    assert ((offset > 0.2) & (offset < 0.4)).all()
    assert len(np.unique(offset.round(5))) > 300
    np.testing.assert_allclose(past[:, :187].numpy(), first, atol=1e-5)
    np.testing.assert_allclose(past[:, 187:].numpy(), expected(env), atol=1e-5)
    env.close()


def test_a_noisy_late_sensor_goes_on_from_a_saved_state():
    changes = {"noise": bias_model(), "delay": 1, "drift_range": (-0.2, 0.2), "update_period": 2 * 2 / 120}
    env = scan_env(changes=changes, scan=ObservationTermCfg(func=mdp.height_scan))
    runs = []
    for _ in range(2):
        env.reset(seed=7)
        runs.append([env.step(torch.zeros(3, 1))[0]["policy"].clone() for _ in range(5)])
    assert all(map(torch.equal, *runs))
    assert not torch.equal(runs[0][0], runs[0][4])
    state = env.get_state()
    after = [env.step(torch.zeros(3, 1))[0]["policy"].clone() for _ in range(5)]
    env.set_state(state)
    assert all(torch.equal(a, env.step(torch.zeros(3, 1))[0]["policy"]) for a in after)
    assert not torch.equal(after[0], after[4])
    env.close()


@pytest.mark.parametrize("change", [{"delay": 2}, {"noise": NOISE}])
def test_a_reset_between_two_steps_is_none_of_the_others_business(change):
    runs = []
    for between in (False, True):
        env = scan_env(changes=change, scan=ObservationTermCfg(func=mdp.height_scan))
        env.reset(seed=7)
        seen = []
        for step in range(6):
            env.step(torch.full((3, 1), 0.1 * step))
            if between and step == 2:
                env.reset(options={"reset_mask": torch.tensor([False, True, False])})
            seen.append(env.scene.sensors["scanner"].data.ray_hits_w[[0, 2]].clone())
        runs.append(torch.stack(seen))
        env.close()
    assert torch.equal(*runs)
    assert not torch.equal(runs[0][4], runs[0][5])


def test_a_scan_does_not_depend_on_the_number_of_environments():
    seen = []
    for count in (2, 4):
        env = scan_env(count, scan=ObservationTermCfg(func=mdp.height_scan, params=SENSOR, noise=NOISE))
        env.reset(seed=3)
        seen.append(env.step(torch.zeros(count, 1))[0]["policy"].clone())
        env.close()
    assert torch.equal(seen[0], seen[1][:2])


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"sensor_cfg": SceneEntityCfg("scaner")}, "no asset or sensor 'scaner'; did you mean scanner"),
        ({**SENSOR, "ray_ids": [0, 187]}, "has 187, the sensor has rays 0 to 186"),
        ({**SENSOR, "ofset": 0.1}, "did you mean 'offset'"),
    ],
)
def test_wrong_parameters_are_named(params, message):
    with pytest.raises(ConfigError, match=message):
        scan_env(scan=ObservationTermCfg(func=mdp.height_scan, params=params))
