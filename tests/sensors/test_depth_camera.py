# SPDX-License-Identifier: Apache-2.0
"""Depth cameras: their noise, delays drawn for each episode, randomised mounting, and pictures for networks."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import EventTermCfg, ObservationTermCfg, SceneEntityCfg
from stripe_newton.sensors import CameraCfg, DepthNoiseCfg, PinholeCameraCfg, TiledCameraCfg
from stripe_newton.sensors.depth_noise import DepthNoise
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg
from tests.helpers.manager_world import observation_group
from tests.helpers.ray_world import add_field, place, ray_scene
from tests.helpers.small_scenes import DT

LENS = PinholeCameraCfg(focal_length=20.0, horizontal_aperture=24.0, clipping_range=(0.2, 12.0))
AHEAD = CameraCfg.OffsetCfg(rot=tuple(Rotation.from_euler("y", 0.5).as_quat()), convention="world")
EYE = SceneEntityCfg("eye")


def noisy(cfg: DepthNoiseCfg, depths: np.ndarray, due: list[bool] | None = None) -> np.ndarray:
    """Noisy depths of one image; ``depths`` of shape (num_envs, size)."""
    raw = wp.array(depths.astype(np.float32), dtype=float, device="cpu")
    noise = DepthNoise(raw, cfg, "camera")
    noise.launch(wp.array(due or [True] * len(depths), dtype=wp.bool, device="cpu"))
    return noise.out.numpy()


def test_the_error_of_a_depth_grows_as_the_config_says():
    cfg = DepthNoiseCfg(std=0.01, relative_std=0.02, quadratic_std=0.003)
    depths = np.repeat([[0.5], [2.0], [8.0]], 40_000, axis=1)
    error = noisy(cfg, depths) - depths
    wanted = 0.01 + 0.02 * depths[:, 0] + 0.003 * depths[:, 0] ** 2
    np.testing.assert_allclose(error.std(axis=1), wanted, rtol=0.02)  # 1 / sqrt(2 n) is 0.35 %
    np.testing.assert_allclose(error.mean(axis=1) / wanted, 0.0, atol=0.025)
    # Normal rather than of another shape: its fourth moment is 3.
    np.testing.assert_allclose((error**4).mean(axis=1) / error.std(axis=1) ** 4, 3.0, atol=0.2)
    neighbours = np.corrcoef(error[1, :-1], error[1, 1:])[0, 1]
    assert abs(neighbours) < 0.02


def test_pixels_are_lost_and_depths_have_steps():
    cfg = DepthNoiseCfg(std=0.05, dropout=0.1, quantization=0.04)
    depths = np.full((2, 30_000), 3.0)
    depths[:, ::5] = np.inf
    found = noisy(cfg, depths, due=[True, False])
    assert not found[1].any()  # whose image is not due
    lost = np.isinf(found[0])
    assert lost[::5].all()
    assert lost[depths[0] == 3.0].mean() == pytest.approx(0.1, abs=0.006)
    steps = found[0][~lost] / 0.04
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-4)
    assert len(np.unique(np.round(steps))) > 6


def test_what_an_environment_draws_does_not_depend_on_the_others():
    cfg, depths = DepthNoiseCfg(relative_std=0.1, dropout=0.3), np.full((3, 50), 2.0)
    three, one = noisy(cfg, depths), noisy(cfg, depths[:1])
    np.testing.assert_array_equal(three[0], one[0])
    assert (three[0] != three[1]).mean() > 0.5


def camera(**changes) -> CameraCfg:
    made = CameraCfg(prim_path="{ENV_REGEX_NS}/Body/camera", width=16, height=12, data_types=["depth"], spawn=LENS)
    return made.replace(offset=AHEAD, **changes)


def test_each_episode_draws_its_delay():
    envs, least, most = 24, 1, 3
    sharp, late = (ray_scene(c, add_field, envs) for c in (camera(), camera(delay=(least, most))))
    taken, seen = [], []
    for step in range(12):
        if step == 6:
            late.sensors["rays"].reset()
        for scene, kept in ((sharp, taken), (late, seen)):
            place(scene, np.tile([-0.5 + 0.05 * step, 0.1, 1.0, 0.0, 0.0, 0.0, 1.0], (envs, 1)))
            scene.sensors["rays"].update(DT)
            kept.append(scene.sensors["rays"].data.output["depth"].clone())
    lags = []
    for begin in (0, 6):
        # The first image of an episode stands for those before it; from the fourth on the delay shows.
        assert all(torch.equal(seen[begin][env], taken[begin][env]) for env in range(envs))
        shown = [[torch.equal(seen[begin + 5][e], taken[begin + 5 - k][e]) for k in range(5)] for e in range(envs)]
        assert all(sum(row) == 1 for row in shown)
        lags.append([row.index(True) for row in shown])
    assert set(lags[0]) == set(lags[1]) == {1, 2, 3}
    assert lags[0] != lags[1]
    assert {"lag", "delay.rng"} <= late.sensors["rays"].arrays.keys()


def test_a_wrong_delay_is_named():
    with pytest.raises(ConfigError, match=r"delay: is \(3, 1\), must be \(least, most\)"):
        camera(delay=(3, 1)).validate()
    with pytest.raises(ConfigError, match="delay"):
        camera(delay=-1).validate()


# -- in an environment


def make_env(device: str, events: dict[str, EventTermCfg], renderer: str = "auto", **groups) -> ManagerBasedRLEnv:
    """Cart-poles with a camera on the pole that sees the ground."""
    settings = CartpoleManagerEnvCfg(seed=4)
    settings.sim.device, settings.scene.num_envs = device, 16

    @configclass
    class Scene(type(settings.scene)):
        eye: TiledCameraCfg = TiledCameraCfg(
            prim_path="{ENV_REGEX_NS}/Robot/cart/eye",
            offset=TiledCameraCfg.OffsetCfg(pos=(0.1, -0.2, 0.3), rot=AHEAD.rot, convention="world"),
            width=16, height=12, data_types=["rgb", "depth", "normals"], spawn=LENS, noise=DepthNoiseCfg(std=0.01),
            renderer=renderer,
        )  # fmt: skip

    settings.scene = Scene(**{k: getattr(settings.scene, k) for k in settings.scene.__dataclass_fields__})
    settings.observations = {"policy": settings.observations.policy, **groups}
    there = {name: getattr(settings.events, name) for name in settings.events.__dataclass_fields__}
    settings.events = {**there, **events}
    return ManagerBasedRLEnv(settings)


def picture(data_type: str, **params) -> ObservationTermCfg:
    return ObservationTermCfg(func=mdp.image, params={"sensor_cfg": EYE, "data_type": data_type, **params})


def test_a_camera_is_mounted_anew_and_its_pictures_suit_networks(device):
    ranges = {"x": (-0.1, 0.0), "z": (0.05, 0.2), "pitch": (-0.2, 0.2), "yaw": (0.3, 0.4)}
    params = {"sensor_cfg": EYE, "pose_range": ranges}
    event = EventTermCfg(func=mdp.randomize_camera_pose, mode="reset", params=params)
    depth = picture("depth", channels_first=True, max_depth=3.0)
    metres = picture("depth", max_depth=3.0, normalize=False)
    many = observation_group({"depth": depth, "metres": metres}, concatenate_terms=False)
    colours, normals = (observation_group({k: picture(k, channels_first=True)}) for k in ("rgb", "normals"))
    env = make_env(device, {"mount": event}, many=many, colours=colours, normals=normals)
    assert not [row for row in env.plan.rows() if "eager" in row[2]]
    assert env.single_observation_space["colours"].shape == (3, 12, 16)
    env.reset(seed=1)
    obs, *_ = env.step(torch.zeros(16, 1, device=device))
    eye = env.scene["eye"]

    # The mounting, by SciPy.
    mount, default = (eye.data.tensors()[k].double().cpu().numpy() for k in ("mount", "default_mount"))
    base = Rotation.from_quat(default[:, 3:])
    offset = base.inv().apply(mount[:, :3] - default[:, :3])
    yaw, pitch, roll = (base.inv() * Rotation.from_quat(mount[:, 3:])).as_euler("ZYX").T
    bounds = {**dict.fromkeys(("y", "roll"), (0.0, 0.0)), **ranges}
    for name, values in zip(("x", "y", "z", "roll", "pitch", "yaw"), (*offset.T, roll, pitch, yaw), strict=True):
        low, high = bounds[name]
        assert (values > low - 1e-5).all()
        assert (values < high + 1e-5).all()
        assert values.std() == pytest.approx((high - low) / 12**0.5, rel=0.4, abs=1e-6)
    cart = env.scene["robot"].find_bodies("cart")[0][0]
    at = env.scene["robot"].data.body_pose_w[:, cart].double().cpu().numpy()
    expected = at[:, :3] + Rotation.from_quat(at[:, 3:]).apply(mount[:, :3])
    np.testing.assert_allclose(eye.data.pos_w.cpu().numpy(), expected, atol=1e-5)

    # The pictures, by NumPy.
    raw = eye.data.output["depth"][..., 0].cpu().numpy()
    assert np.isinf(raw).any()
    assert (raw < 3.0).any()
    np.testing.assert_allclose(obs["many"]["depth"][:, 0].cpu().numpy(), np.minimum(raw, 3.0) / 3.0, rtol=1e-6)
    np.testing.assert_allclose(obs["many"]["metres"][..., 0].cpu().numpy(), np.minimum(raw, 3.0), rtol=1e-6)
    for group, data_type in (("colours", "rgb"), ("normals", "normals")):
        expected = mdp.image(env, EYE, data_type, channels_first=True)
        torch.testing.assert_close(obs[group], expected, atol=1e-6, rtol=1e-5)
        assert torch.equal(expected, mdp.image(env, EYE, data_type).permute(0, 3, 1, 2))
    before = mount.copy()
    env.scene["robot"].data.joint_pos[3, 0] = 100.0  # off the track: an episode ends
    env.step(torch.zeros(16, 1, device=device))
    moved = (eye.data.mount.double().cpu().numpy() != before).any(axis=1)
    assert moved.nonzero()[0].tolist() == [3]
    env.close()


def test_each_episode_has_its_light(device):
    ranges = {"azimuth_range": (-1.0, 2.0), "elevation_range": (0.3, 1.4), "sun_range": (0.2, 1.5), "tint": 0.0}
    params = {"sensor_cfg": EYE, "sky_range": (1.0, 1.0), **ranges}
    events = {"light": EventTermCfg(func=mdp.randomize_light, mode="reset", params=params)}
    env = make_env(device, events, colours=observation_group({"rgb": picture("rgb", normalize=False)}))
    assert not [row for row in env.plan.rows() if "eager" in row[2]]
    env.reset(seed=2)
    data = env.scene["eye"].data
    light = {name: data.tensors()[name].double().cpu().numpy() for name in ("to_sun", "sun", "sky", "default_sun")}
    np.testing.assert_allclose(np.linalg.norm(light["to_sun"], axis=1), 1.0, atol=1e-6)
    elevation = np.arcsin(light["to_sun"][:, 2])
    azimuth = np.arctan2(light["to_sun"][:, 1], light["to_sun"][:, 0])
    factor = light["sun"] / light["default_sun"]
    np.testing.assert_allclose(factor, factor[:, :1].repeat(3, axis=1), rtol=1e-5)  # without a tint
    for values, (low, high) in zip((azimuth, elevation, factor[:, 0]), list(ranges.values())[:3], strict=True):
        assert ((values > low - 1e-5) & (values < high + 1e-5)).all()
        assert values.std() == pytest.approx((high - low) / 12**0.5, rel=0.4)
    # The level ground in the lower half of the picture is as bright as the sun is strong and high.
    ground = data.output["rgb"][:, 8:].float().mean(dim=(1, 2, 3)).cpu().numpy()
    strength = factor[:, 0] * light["to_sun"][:, 2]
    order = np.argsort(strength)
    assert np.corrcoef(np.argsort(order), np.argsort(np.argsort(ground)))[0, 1] > 0.95
    assert ground.max() - ground.min() > 25.0
    before = data.to_sun.clone()
    env.scene["robot"].data.joint_pos[5, 0] = 100.0  # off the track: an episode ends
    env.step(torch.zeros(16, 1, device=device))
    assert (data.to_sun != before).any(dim=1).nonzero().flatten().tolist() == [5]
    env.close()


def test_newtons_sensor_has_one_light():
    params = {"sensor_cfg": EYE, "sky_range": (1.0, 1.0), "sun_range": (0.5, 1.0)}
    params |= {"azimuth_range": (0.0, 1.0), "elevation_range": (0.5, 1.0)}
    events = {"light": EventTermCfg(func=mdp.randomize_light, mode="reset", params=params)}
    with pytest.raises(ConfigError, match="reads 'ground' of 'eye': one light for all environments"):
        make_env("cpu", events, renderer="newton")


@pytest.mark.parametrize(
    ("params", "message"),
    [
        ({"data_type": "rgb", "max_depth": 2.0}, "max_depth: is 2.0, but 'rgb' is no depth"),
        ({"data_type": "depth", "max_depth": 0.0}, "max_depth: is 0.0, must be a finite depth above 0"),
    ],
)
def test_wrong_largest_depths_are_named(params, message):
    with pytest.raises(ConfigError, match=message):
        make_env("cpu", {}, eye=observation_group({"a": picture(**params)}))
