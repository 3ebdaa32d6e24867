# SPDX-License-Identifier: Apache-2.0
"""Cameras: pose, depth and normals against closed forms, labels, colour, periods, and pictures as observations."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_newton.assets import RigidObjectCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv, mdp
from stripe_newton.managers import ObservationTermCfg, SceneEntityCfg
from stripe_newton.noise import UniformNoiseCfg
from stripe_newton.sensors import CameraCfg, PinholeCameraCfg, TiledCameraCfg
from stripe_newton.viewers import SceneRenderer, ViewerCfg
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg
from tests.helpers.manager_world import observation_group
from tests.helpers.ray_world import SceneryCfg, body, place, random_poses, ray_scene
from tests.helpers.small_scenes import DT

WIDTH, HEIGHT = 32, 24
LENS = PinholeCameraCfg(focal_length=20.0, horizontal_aperture=24.0, clipping_range=(0.2, 12.0))
EVERY = ["rgb", "distance_to_image_plane", "distance_to_camera", "normals"]
BODY = "{ENV_REGEX_NS}/Body/camera"
CENTRE, RADIUS, GROUND = np.array([0.4, 0.2, 0.5]), 0.5, -0.3
RED = (0.9, 0.1, 0.1)


def cfg(**changes):
    made = CameraCfg(prim_path=BODY, width=WIDTH, height=HEIGHT, data_types=EVERY, spawn=LENS)
    return made.replace(**changes)


def add_plane(template, static):
    static.add_shape_plane(plane=(0.0, 0.0, 1.0, -GROUND), width=0.0, length=0.0, label="/World/ground/plane")


def add_sphere(template, static):
    add_plane(template, static)
    pose = wp.transform(wp.vec3(*CENTRE), wp.quat_identity())
    static.add_shape_sphere(-1, xform=pose, radius=RADIUS, color=RED, label="/World/ball/sphere")


def pixel_rays(rotation):
    """Rays of all pixels, unit length, from the camera's matrix; ``rotation`` of frames with x forward and z up."""
    fx = WIDTH * LENS.focal_length / LENS.horizontal_aperture
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5 - WIDTH / 2, np.arange(HEIGHT) + 0.5 - HEIGHT / 2)
    rays = np.stack([np.ones_like(x), -x / fx, -y / fx], axis=-1)
    slant = 1.0 / np.linalg.norm(rays, axis=-1)
    return (rays * slant[..., None]) @ rotation.as_matrix().swapaxes(-1, -2)[:, None], slant


TILT = Rotation.from_euler("y", 0.9)
"""From a body that looks ahead to a camera that looks down."""
DOWN = CameraCfg.OffsetCfg(pos=(0.1, 0.0, 0.2), rot=tuple(TILT.as_quat()), convention="world")


def ray_lengths(start, rays):
    """Closed form of the lengths to plane and sphere."""
    with np.errstate(divide="ignore", invalid="ignore"):
        plane = (GROUND - start[..., 2]) / rays[..., 2]
        to = CENTRE - start
        along = (to * rays).sum(-1)
        ball = along - np.sqrt(RADIUS**2 - (to**2).sum(-1) + along**2)
    plane = np.where(plane > 0.0, plane, np.inf)
    return plane, np.where(ball > 0.0, ball, np.inf)


def test_normals_of_large_boxes_have_no_holes():
    """Newton's sensor leaves them zero on faces that are farther away than some eight metres."""

    def add_hall(template, static):
        static.add_shape_box(-1, xform=wp.transform((0, 0, -20), wp.quat_identity()), hx=60.0, hy=60.0, hz=1.0)
        static.add_shape_box(-1, xform=wp.transform((0, 0, 30), wp.quat_identity()), hx=90.0, hy=90.0, hz=90.0)

    lens = PinholeCameraCfg(focal_length=20.0, horizontal_aperture=24.0, clipping_range=(0.2, 200.0))
    ahead = CameraCfg.OffsetCfg(convention="world")
    scene = ray_scene(cfg(spawn=lens, offset=ahead, data_types=["normals"]), add_hall, 1)
    # Normals of a box point outwards, also where a ray leaves it.
    for pitch, normal in ((1.2, (0.0, 0.0, 1.0)), (0.0, (1.0, 0.0, 0.0)), (-1.2, (0.0, 0.0, 1.0))):
        turn = Rotation.from_euler("y", pitch)
        place(scene, np.concatenate([[0.3, 0.1, 0.7], turn.as_quat()])[None])
        scene.sensors["rays"].update(DT)
        found = scene.sensors["rays"].data.output["normals"].numpy()
        np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1.0, atol=1e-5)
        np.testing.assert_allclose(found[0, HEIGHT // 2, WIDTH // 2], normal, atol=1e-5)


def test_depths_and_normals_are_those_of_geometry():
    poses = random_poses(4, seed=3)
    scene = ray_scene(cfg(offset=DOWN, background_color=(0.66, 0.77, 0.88)), add_sphere, 4)
    place(scene, poses)
    camera = scene.sensors["rays"]
    camera.update(DT)
    data = camera.data
    turn = Rotation.from_quat(poses[:, 3:])
    start = poses[:, :3] + turn.apply(DOWN.pos)
    np.testing.assert_allclose(data.pos_w.numpy(), start, atol=1e-6)
    same = np.abs(((turn * TILT).as_quat() * data.quat_w_world.numpy()).sum(-1))
    np.testing.assert_allclose(same, 1.0, atol=1e-6)
    rays, slant = pixel_rays(turn * TILT)
    plane, ball = ray_lengths(start[:, None, None], rays)
    length = np.minimum(plane, ball)
    assert ((length == ball) & np.isfinite(ball)).sum() > 100
    depth = length * slant
    got = data.output["distance_to_image_plane"][..., 0].double().numpy()
    clear = ~(np.abs(depth - 12.0) < 1e-3) & np.isclose(np.isinf(got), depth > 12.0)
    assert clear.mean() > 0.997  # at a silhouette rounding decides
    seen = clear & (depth < 12.0)
    assert seen.mean() > 0.6
    near = np.isclose(got[seen], depth[seen], atol=2e-4)
    assert near.mean() > 0.997
    far = data.output["distance_to_camera"][..., 0].double().numpy()
    assert np.isclose(far[seen & (length < 12.0)], length[seen & (length < 12.0)], atol=2e-4).mean() > 0.997
    assert np.isinf(far[clear & (length > 12.01)]).all()
    normals = data.output["normals"].double().numpy()
    point = start[:, None, None] + length[..., None] * rays
    reference = np.where((ball < plane)[..., None], (point - CENTRE) / RADIUS, [0.0, 0.0, 1.0])
    close = np.abs(normals - reference).max(-1)[seen] < 2e-3
    assert close.mean() > 0.995
    k = data.intrinsic_matrices
    assert k.shape == (4, 3, 3)
    expected = [[80 / 3, 0, 16], [0, 80 / 3, 12], [0, 0, 1]]
    np.testing.assert_allclose(k[2].numpy(), expected, rtol=1e-6)
    colour = data.output["rgb"]
    assert (colour.shape, colour.dtype) == ((4, HEIGHT, WIDTH, 3), torch.uint8)
    on_ball = torch.from_numpy(seen & (ball < plane))
    red, green, _ = colour[on_ball].double().mean(0)
    assert red > 2.0 * green
    empty = np.isinf(length) & clear
    sky = torch.tensor([round(255 * c) for c in camera.cfg.background_color], dtype=torch.uint8)
    assert (colour[torch.from_numpy(empty)] == sky).all()


@pytest.mark.parametrize("name", ["ground", "ball"])
def test_a_camera_looks_through_what_it_is_not_to_see(name):
    poses = random_poses(4, seed=3)
    camera = cfg(offset=DOWN, data_types=["depth", "distance_to_camera"], mesh_prim_paths=[f"/World/{name}"])
    scene = ray_scene(camera, add_sphere, 4, others={"cube": body("Cube", 3.0)})
    place(scene, poses)
    place(scene, poses, "cube")  # around all cameras
    scene.sensors["rays"].update(DT)
    turn = Rotation.from_quat(poses[:, 3:])
    rays, slant = pixel_rays(turn * TILT)
    lengths = ray_lengths((poses[:, :3] + turn.apply(DOWN.pos))[:, None, None], rays)
    length = lengths[name == "ball"]
    got = scene.sensors["rays"].data.output["depth"][..., 0].double().numpy()
    depth = np.where(length * slant < 12.0, length * slant, np.inf)
    assert np.isfinite(depth).sum() > 100
    assert np.isclose(got, depth, atol=2e-4).mean() > 0.995  # at a silhouette rounding decides


def test_colours_are_those_of_pictures():
    """A camera and ``render()`` show one scene alike: light, ground, highlights, sky, colours of uncoloured shapes."""

    def add_things(template, static):
        add_sphere(template, static)
        static.add_shape_box(-1, xform=wp.transform((2.0, -1.5, 0.2), wp.quat_identity()), hx=0.4, hy=0.4, hz=0.5)

    width, height = 96, 72
    lens = PinholeCameraCfg(focal_length=20.0, horizontal_aperture=24.0, clipping_range=(0.01, 1000.0))
    ahead = CameraCfg.OffsetCfg(pos=(1.0, 0.0, 0.0), convention="world")
    scene = ray_scene(cfg(spawn=lens, offset=ahead, data_types=["rgb"], width=width, height=height), add_things, 1)
    turn = Rotation.from_euler("y", 0.15)
    place(scene, np.concatenate([[-3.5, -0.4, 1.05], turn.as_quat()])[None])
    eye = np.array([-3.5, -0.4, 1.05]) + turn.apply([1.0, 0.0, 0.0])
    scene.sensors["rays"].update(DT)
    seen = scene.sensors["rays"].data.output["rgb"][0].numpy().astype(int)
    fov = math.degrees(2.0 * math.atan(0.5 * 24.0 / 20.0 * height / width))
    view = ViewerCfg(
        eye=tuple(eye), lookat=tuple(eye + turn.apply([3.0, 0.0, 0.0])), origin_type="world", fov=fov,
        resolution=(width, height), shadows=False, anti_aliasing=False,
    )  # fmt: skip
    drawn = SceneRenderer(scene.sim, view).render().astype(int)
    apart = np.abs(seen - drawn).max(axis=-1)
    assert (apart <= 1).mean() > 0.995  # the pixels of silhouettes fall to either side
    assert np.quantile(seen.reshape(-1, 3).std(axis=1), 0.9) > 10.0


@pytest.mark.parametrize("convention", ["ros", "opengl", "world"])
def test_an_offset_means_the_same_in_every_convention(convention):
    frames = {
        "world": Rotation.identity(),
        "opengl": Rotation.from_matrix([[0, 0, -1], [-1, 0, 0], [0, 1, 0]]),
        "ros": Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
    }
    quat = tuple((TILT * frames[convention]).as_quat())
    offset = CameraCfg.OffsetCfg(pos=(0.1, 0.0, 0.2), rot=quat, convention=convention)
    scene = ray_scene(cfg(offset=offset, data_types=["depth"]), add_plane, 1)
    place(scene, random_poses(1, seed=3))
    camera = scene.sensors["rays"]
    camera.update(DT)
    turn = Rotation.from_quat(random_poses(1, seed=3)[:, 3:]) * TILT
    for name, quats in (("world", "quat_w_world"), ("ros", "quat_w_ros"), ("opengl", "quat_w_opengl")):
        expected = (turn * frames[name]).as_quat()
        same = np.abs((getattr(camera.data, quats).numpy() * expected).sum(-1))
        np.testing.assert_allclose(same, 1.0, atol=1e-6)
    rays, slant = pixel_rays(turn)
    plane, _ = ray_lengths(camera.data.pos_w.double().numpy()[:, None, None], rays)
    reference = np.where(plane * slant < 11.9, plane * slant, np.inf)
    got = camera.data.output["depth"][..., 0].numpy()
    near = (reference < 11.8) | (plane * slant > 12.1)
    np.testing.assert_allclose(got[near], reference[near], rtol=1e-4)


def test_labels_name_assets_bodies_and_shapes():
    sensor = cfg(data_types=["semantic_segmentation", "instance_segmentation_fast", "instance_id_segmentation"])
    sensor = sensor.replace(prim_path="{ENV_REGEX_NS}/Camera")
    scene = ray_scene(sensor, add_sphere, 2, others={"cube": body("Cube", 0.6)})
    camera = scene.sensors["rays"]
    camera.set_world_poses_from_view(torch.tensor([[0.0, 0.0, 4.0]] * 2), torch.tensor([[0.01, 0.0, 0.0]] * 2))
    place(scene, np.array([[0.0, -50.0, 1.0, 0, 0, 0, 1]] * 2))
    place(scene, np.array([[0.0, -0.8, 1.0, 0, 0, 0, 1], [0.0, 70.0, 1.0, 0, 0, 0, 1]]), "cube")
    camera.update(DT)
    output, info = camera.data.output, camera.data.info
    found = {}
    for kind, image in output.items():
        assert (image.shape, image.dtype) == ((2, HEIGHT, WIDTH, 1), torch.int32)
        names = info[kind]["idToLabels"]
        assert names[0] == "BACKGROUND"
        found[kind] = [{names[int(i)] for i in env.unique()} for env in image]
    cube = "/World/envs/env_0/Cube"
    assert found["semantic_segmentation"] == [
        {"/World/ground", "/World/ball", "cube"},
        {"/World/ground", "/World/ball"},
    ]
    assert found["instance_segmentation_fast"][0] == {"/World/ground", "/World/ball", cube}
    assert {"/World/ground/plane", "/World/ball/sphere"} == found["instance_id_segmentation"][1]
    shapes = found["instance_id_segmentation"][0] - found["instance_id_segmentation"][1]
    assert len(shapes) == 1
    assert shapes.pop().startswith(cube)


@pytest.mark.parametrize(("behavior", "missing"), [("none", math.inf), ("max", 12.0), ("zero", 0.0)])
def test_what_is_not_seen_has_the_depth_that_was_asked_for(behavior, missing):
    up = CameraCfg.OffsetCfg(rot=tuple(Rotation.from_euler("y", -1.2).as_quat()), convention="world")
    types = ["depth", "distance_to_camera"]
    scene = ray_scene(cfg(offset=up, data_types=types, depth_clipping_behavior=behavior), add_plane, 1)
    place(scene, np.array([[0.0, 0.0, 1.0, 0, 0, 0, 1]]))
    camera = scene.sensors["rays"]
    camera.update(DT)
    for name in types:
        assert (camera.data.output[name] == missing).all()


def test_the_near_plane_lets_the_body_that_carries_it_vanish():
    for near, first in ((0.2, None), (0.001, 0.05)):
        scene = ray_scene(
            cfg(spawn=LENS.replace(clipping_range=(near, 12.0)), offset=DOWN.replace(pos=(0, 0, 0))), add_plane
        )
        place(scene, np.tile([0.0, 0.0, 1.0, 0, 0, 0, 1], (3, 1)))
        scene.sensors["rays"].update(DT)
        depth = scene.sensors["rays"].data.output["distance_to_image_plane"]
        assert (depth.min() > 0.5) if first is None else (depth.max() < 0.12)


def test_a_period_is_obeyed_by_the_renderer():
    sensor = cfg(update_period=3 * DT, offset=DOWN, data_types=["rgb", "depth", "semantic_segmentation"])
    scene = ray_scene(sensor, add_sphere, 2)
    camera, seen = scene.sensors["rays"], []
    for step in range(5):
        if step == 4:
            camera.launch_reset(wp.array([False, True], dtype=wp.bool))
        place(scene, np.tile([0.0, 0.0, 1.0 + step, 0.0, 0.0, 0.0, 1.0], (2, 1)))
        camera.update(DT)
        seen.append({k: v.clone() for k, v in camera.data.output.items()})
    for name in seen[0]:
        assert torch.equal(seen[0][name], seen[2][name])
        assert torch.equal(seen[3][name][0], seen[4][name][0])
    depth = [s["depth"] for s in seen]
    assert (depth[2] != depth[3]).any(dim=(1, 2, 3)).tolist() == [True, True]
    assert (depth[3] != depth[4]).any(dim=(1, 2, 3)).tolist() == [False, True]
    assert not torch.equal(seen[2]["rgb"], seen[3]["rgb"])
    assert not torch.equal(seen[2]["semantic_segmentation"], seen[3]["semantic_segmentation"])
    assert camera.data.pos_w[:, 2].tolist() == pytest.approx([4.2, 5.2])
    kept = {name: wp.to_torch(array).shape for name, array in camera.arrays.items()}
    assert kept["color"] == (2, HEIGHT, WIDTH)
    assert {"clock.age", "mount", "semantic_segmentation", "distance_to_image_plane"} <= kept.keys()


def test_depths_are_noisy_and_pictures_late():
    noise = UniformNoiseCfg(n_min=0.01, n_max=0.05)
    up = CameraCfg.OffsetCfg(rot=tuple(Rotation.from_euler("y", 0.3).as_quat()), convention="world")
    made = []
    for sensor in (cfg(offset=up), cfg(offset=up, noise=noise, delay=2, depth_clipping_behavior="zero")):
        scene = ray_scene(sensor, add_sphere, 2)
        seen = []
        for step in range(5):
            place(scene, np.tile([-3.0, 0.0, 0.5 + step, 0.0, 0.0, 0.0, 1.0], (2, 1)))
            scene.sensors["rays"].update(DT)
            seen.append({k: v.clone() for k, v in scene.sensors["rays"].data.output.items()})
            seen[-1]["pos"] = scene.sensors["rays"].data.pos_w.clone()
        made.append(seen)
    sharp, late = made
    for step, before in enumerate([0, 0, 0, 1, 2]):
        for name in ("rgb", "normals", "pos"):
            assert torch.equal(late[step][name], sharp[before][name])
        for name in ("distance_to_image_plane", "distance_to_camera"):
            hit = torch.isfinite(sharp[before][name])
            assert 0.1 < hit.float().mean() < 0.95
            off = (late[step][name] - sharp[before][name])[hit]
            assert (off.min() > 0.0099) & (off.max() < 0.0501)
            assert len(off.unique()) > 200
            assert (late[step][name][~hit] == 0.0).all()
    kept = {name: wp.to_torch(array).shape for name, array in scene.sensors["rays"].arrays.items()}
    assert kept["color.ring"] == (2, 3, HEIGHT * WIDTH)
    assert kept["normals.ring"] == (2, 3, 3 * HEIGHT * WIDTH)
    assert kept["distance_to_camera.rng"] == (2,)
    camera = scene.sensors["rays"]
    camera.reset([1])
    camera.update(DT)
    assert camera.data.pos_w[:, 2].tolist() == [3.5, 4.5]
    camera.reset([1])  # between two steps, after which only the new episode is looked at
    camera.launch_observed()
    assert camera.data.pos_w[:, 2].tolist() == [3.5, 4.5]


def test_environments_see_themselves_alone_and_do_not_depend_on_each_other():
    poses, pictures = random_poses(3, seed=9), []
    for count in (1, 3):
        scene = ray_scene(cfg(offset=DOWN), add_sphere, count, others={"cube": body("Cube", 0.6)})
        place(
            scene,
            np.array([[0.5, 0.0, 0.3, 0, 0, 0, 1], [0, 90, 0, 0, 0, 0, 1], [0, 90, 0, 0, 0, 0, 1]])[:count],
            "cube",
        )
        place(scene, poses[:count])
        scene.sensors["rays"].update(DT)
        pictures.append({k: v[:1].clone() for k, v in scene.sensors["rays"].data.output.items()})
    for name in EVERY:
        assert torch.equal(pictures[0][name], pictures[1][name])


# -- as an observation


def camera_env(device: str = "cpu", **groups) -> ManagerBasedRLEnv:
    """The cartpole with a camera on its pole."""
    settings = CartpoleManagerEnvCfg(seed=4, compute_final_obs=True)
    settings.sim.device, settings.scene.num_envs = device, 2

    @configclass
    class Scene(type(settings.scene)):
        body: RigidObjectCfg = body()
        sphere = SceneryCfg(build=add_sphere)
        eye: TiledCameraCfg = TiledCameraCfg(
            prim_path="{ENV_REGEX_NS}/Robot/pole/eye", width=WIDTH, height=HEIGHT, data_types=EVERY, spawn=LENS
        )

    settings.scene = Scene(**{k: getattr(settings.scene, k) for k in settings.scene.__dataclass_fields__})
    settings.observations = {"policy": settings.observations.policy, **groups}
    return ManagerBasedRLEnv(settings)


def picture(data_type: str, **params) -> ObservationTermCfg:
    return ObservationTermCfg(
        func=mdp.image, params={"sensor_cfg": SceneEntityCfg("eye"), "data_type": data_type, **params}
    )


def test_pictures_are_observations_in_the_graph(device):
    many = observation_group({name: picture(name) for name in EVERY}, concatenate_terms=False)
    plain = observation_group({"rgb": picture("rgb", normalize=False)})
    env = camera_env(device, many=many, plain=plain)
    assert env.single_observation_space["plain"].shape == (HEIGHT, WIDTH, 3)
    assert env.single_observation_space["many"]["normals"].shape == (HEIGHT, WIDTH, 3)
    assert env.observation_manager.group_obs_dim["plain"] == (HEIGHT, WIDTH, 3)
    env.reset(seed=1)
    for _ in range(2):
        obs, *_ = env.step(torch.zeros(2, 1, device=device))
    assert obs["policy"].shape == (2, 4)
    for name in EVERY:
        expected = mdp.image(env, SceneEntityCfg("eye"), name)
        assert obs["many"][name].shape == expected.shape
        torch.testing.assert_close(obs["many"][name], expected, atol=1e-6, rtol=1e-5)
    colours = env.scene["eye"].data.output["rgb"]
    assert torch.equal(obs["plain"], colours.float())
    assert len(colours.unique()) > 10
    eager = [row for row in env.plan.rows() if "eager" in row[2]]
    assert not eager, eager
    before = obs["plain"].clone()
    env.scene["robot"].data.joint_pos[1, 0] = 100.0  # off the track: an episode ends
    obs, _, terminated, _, extras = env.step(torch.ones(2, 1, device=device))
    assert terminated.tolist() == [False, True]
    assert extras["final_obs"]["plain"].shape == (2, HEIGHT, WIDTH, 3)
    assert torch.equal(extras["final_obs"]["plain"][1], before[1])  # no picture is taken of an end
    assert not torch.equal(obs["plain"][1], before[1])
    env.close()


@pytest.mark.parametrize(
    ("group", "message"),
    [
        (lambda: observation_group({"a": picture("rgb"), "b": picture("depth")}), "group of its own"),
        (lambda: observation_group({"a": picture("heat")}), "'heat' is not among the data_types"),
        (lambda: observation_group({"a": picture("rgb", size=3)}), "'image' has no such argument"),
        (lambda: observation_group({"a": picture("rgb").replace(noise=UniformNoiseCfg())}), "noise: is set"),
        (
            lambda: observation_group({"a": ObservationTermCfg(func=mdp.image, params={"sensor_cfg": "ear"})}),
            "is 'ear', must name a camera: eye",
        ),
    ],
)
def test_wrong_picture_terms_are_named(group, message):
    with pytest.raises(ConfigError, match=message):
        camera_env(eye=group())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"data_types": ["heat"]}, r"data_types: has 'heat', must be of rgb"),
        ({"width": 0}, r"width: is 0"),
        ({"spawn": LENS.replace(clipping_range=(1.0, 0.5))}, r"spawn.clipping_range: is \(1.0, 0.5\)"),
        ({"offset": CameraCfg.OffsetCfg(convention="usd")}, r"offset.convention: is 'usd'"),
        ({"depth_clipping_behavior": "far"}, r"depth_clipping_behavior"),
        ({"mesh_prim_paths": ["/World/("]}, r"mesh_prim_paths\[0\]: is '/World/\(', which is no regular expression"),
    ],
)
def test_a_wrong_config_says_what_would_be_right(changes, message):
    with pytest.raises(ConfigError, match=message):
        cfg(**changes).validate()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mesh_prim_paths": ["/World/gruond"]}, r"mesh_prim_paths\[0\]: no visible shape at or below '/World/gruond'"),
        ({"mesh_prim_paths": [".*"], "renderer": "newton"}, r"mesh_prim_paths: cannot choose what is seen"),
    ],
)
def test_what_cannot_be_seen_is_an_error(changes, message):
    with pytest.raises(ConfigError, match=message):
        ray_scene(cfg(**changes), add_plane, 1)


def test_a_camera_on_a_body_cannot_be_put_elsewhere():
    scene = ray_scene(cfg(data_types=["depth"]), add_plane, 1)
    with pytest.raises(ConfigError, match=r"body 'Body.*' carries it"):
        scene.sensors["rays"].set_world_poses(torch.zeros(1, 3))
