# SPDX-License-Identifier: Apache-2.0
"""The camera's own renderer against Newton's camera sensor: depths, normals, labels, colours and shadows."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import torch
import warp as wp
from scipy.spatial.transform import Rotation

from stripe_newton.scene import InteractiveScene
from stripe_newton.sensors import CameraCfg, PinholeCameraCfg, camera_renderer
from stripe_newton.sensors.camera_renderer import MOST_LISTED_STATICS, CameraRenderer
from stripe_newton.sensors.newton_renderer import NewtonRenderer
from tests.helpers.ray_world import add_field, body, place, random_poses, ray_scene
from tests.helpers.small_scenes import DT

WIDTH, HEIGHT, ENVS = 61, 43, 3
LENS = PinholeCameraCfg(
    focal_length=20.0, horizontal_aperture=30.0, horizontal_aperture_offset=1.5, clipping_range=(0.2, 9.0)
)
DOWN = CameraCfg.OffsetCfg(
    pos=(0.1, 0.0, 0.2), rot=tuple(Rotation.from_euler("yx", [0.7, 0.2]).as_quat()), convention="world"
)
TYPES = ["rgb", "distance_to_image_plane", "distance_to_camera", "normals", "instance_id_segmentation"]
KINDS = ("box", "sphere", "capsule", "cylinder", "cone", "ellipsoid")


def add_kind(builder: newton.ModelBuilder, kind: str, pose: wp.transform, **options) -> None:
    """A primitive of about 0.4 m."""
    sizes = {
        "box": {"hx": 0.2, "hy": 0.15, "hz": 0.3},
        "sphere": {"radius": 0.25},
        "capsule": {"radius": 0.12, "half_height": 0.2},
        "cylinder": {"radius": 0.15, "half_height": 0.25},
        "cone": {"radius": 0.2, "half_height": 0.25},
        "ellipsoid": {"rx": 0.3, "ry": 0.15, "rz": 0.2},
    }
    getattr(builder, f"add_shape_{kind}")(-1, xform=pose, **sizes[kind], **options)


def scatter(builder: newton.ModelBuilder, count: int, seed: int) -> None:
    """Primitives of all kinds at random poses about the origin."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        turn = Rotation.random(random_state=rng).as_quat()
        at = [*rng.uniform(-2.5, 2.5, 2), rng.uniform(-0.2, 0.6)]
        pose = wp.transform(wp.vec3(*map(float, at)), wp.quat(*map(float, turn)))
        color = tuple(map(float, rng.uniform(0.1, 1.0, 3)))
        add_kind(builder, KINDS[i % len(KINDS)], pose, color=color, label=f"/World/things/{i}")


def add_torus(builder: newton.ModelBuilder, at: tuple[float, float, float], smooth: bool, label: str) -> None:
    """A ring of triangles, with or without normals of its vertices, scaled differently along its axes."""
    u, v = np.meshgrid(np.linspace(0, 2 * np.pi, 25)[:-1], np.linspace(0, 2 * np.pi, 13)[:-1], indexing="ij")
    ring = np.stack([np.cos(u) * np.cos(v), np.sin(u) * np.cos(v), np.sin(v)], axis=-1).reshape(-1, 3)
    middle = np.stack([np.cos(u), np.sin(u), np.zeros_like(u)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(24), np.arange(12), indexing="ij")
    a, b = i * 12 + j, (i + 1) % 24 * 12 + j
    c, d = (i + 1) % 24 * 12 + (j + 1) % 12, i * 12 + (j + 1) % 12
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    mesh = newton.Mesh(0.3 * middle + 0.1 * ring, faces.ravel(), normals=ring if smooth else None)
    pose = wp.transform(wp.vec3(*at), wp.quat_rpy(0.4, 0.3, 0.2))
    builder.add_shape_mesh(-1, mesh=mesh, xform=pose, scale=(1.0, 1.5, 2.0), color=(0.8, 0.5, 0.3), label=label)


def add_few(template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
    static.add_shape_plane(plane=(0.0, 0.0, 1.0, 0.3), width=0.0, length=0.0, label="/World/ground/plane")
    scatter(static, 12, seed=2)
    add_torus(static, (0.4, 0.3, 0.5), True, "/World/rings/smooth")
    add_torus(static, (-0.6, -0.4, 0.4), False, "/World/rings/flat")


def add_many(template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
    add_field(template, static)
    scatter(static, MOST_LISTED_STATICS + 12, seed=4)
    add_torus(static, (0.4, 0.3, 0.7), True, "/World/rings/smooth")


def put(scene: InteractiveScene) -> None:
    """Put the camera at three poses, and a cube before two of them."""
    at = np.array([[0.6, 0.2, 0.4], [5.0, 5.0, 5.0], [0.9, -0.4, 0.5]])
    place(scene, np.concatenate([at, [[0.0, 0.0, 0.38, 0.92]] * ENVS], axis=1), "cube")
    place(scene, random_poses(ENVS, seed=7))


def pictures(build, shadows: bool = False, **changes) -> dict[str, dict[str, np.ndarray]]:
    """Images of three poses by both renderers, and the classes of the renderers."""
    found = {}
    for renderer in ("auto", "newton"):
        camera = CameraCfg(prim_path="{ENV_REGEX_NS}/Body/eye", width=WIDTH, height=HEIGHT, data_types=TYPES)
        camera = camera.replace(spawn=LENS, offset=DOWN, renderer=renderer, shadows=shadows, **changes)
        scene = ray_scene(camera, build, ENVS, others={"cube": body("Cube", 0.5)})
        put(scene)
        eye = scene.sensors["rays"]
        assert isinstance(eye.renderer, CameraRenderer if renderer == "auto" else NewtonRenderer)
        assert eye.renderer.describe() in eye.describe()
        eye.update(DT)
        found[renderer] = {name: image.numpy().copy() for name, image in eye.data.output.items()}
        found[renderer]["features"] = getattr(eye.renderer, "features", None)
    return found


def check_alike(found: dict[str, dict[str, np.ndarray]], share: float = 0.998) -> None:
    own, theirs = found["auto"], found["newton"]
    # Newton's rays all have the length of those to the corners: in the middle it shows colours beyond the far plane.
    within = (np.isfinite(theirs["distance_to_image_plane"]) | (theirs["instance_id_segmentation"] == 0))[..., 0]
    assert within.mean() > 0.9
    labels = own["instance_id_segmentation"] == theirs["instance_id_segmentation"]
    assert labels[within].mean() > share  # the pixels of silhouettes fall to either side
    assert len(np.unique(own["instance_id_segmentation"])) > 8
    for name in ("distance_to_image_plane", "distance_to_camera"):
        near = np.isclose(own[name], theirs[name], atol=5e-4, rtol=1e-4)  # infinities are close to each other
        assert near.mean() > share, name
    normals = np.abs(own["normals"] - theirs["normals"]).max(axis=-1)
    assert (normals[within] < 5e-3).mean() > share - 0.002
    colours = np.abs(own["rgb"].astype(int) - theirs["rgb"].astype(int)).max(axis=-1)
    assert (colours[within] <= 1).mean() > share
    assert own["rgb"].std() > 15.0


def test_a_few_shapes_are_those_of_newtons_sensor():
    found = pictures(add_few)
    assert not found["auto"]["features"].tree
    assert not found["auto"]["features"].field
    check_alike(found)


def test_a_height_field_and_many_static_shapes_are_those_of_newtons_sensor():
    found = pictures(add_many, background_color=(0.2, 0.4, 0.6))
    assert found["auto"]["features"].tree
    assert found["auto"]["features"].field
    check_alike(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("paths", "alone"),
    [
        (["/World/ground"], lambda template, static: add_field(template, static)),
        (["/World/rings/.*"], lambda template, static: add_torus(static, (0.4, 0.3, 0.7), True, "/World/rings/smooth")),
        (["{ENV_REGEX_NS}/Cube"], lambda template, static: None),
    ],
)
@pytest.mark.parametrize("most_listed", [MOST_LISTED_STATICS, 0])
def test_pictures_of_some_prims_are_those_of_a_scene_without_the_others(paths, alone, most_listed, monkeypatch):
    monkeypatch.setattr(camera_renderer, "MOST_LISTED_STATICS", most_listed)

    def picture(build, cube: bool, **changes) -> dict[str, np.ndarray]:
        lens = LENS.replace(clipping_range=(0.35, 20.0))  # beyond the body that carries it
        camera = CameraCfg(
            prim_path="{ENV_REGEX_NS}/Body/eye", width=WIDTH, height=HEIGHT, spawn=lens, offset=DOWN,
            data_types=["distance_to_image_plane", "normals", "rgb"], background_color=(0.2, 0.4, 0.6), **changes,
        )  # fmt: skip
        scene = ray_scene(camera, build, ENVS, others={"cube": body("Cube", 3.0)})
        place(scene, poses)
        place(scene, poses if cube else poses - [0.0, 0.0, 90.0, 0.0, 0.0, 0.0, 0.0], "cube")  # around the camera
        eye = scene.sensors["rays"]
        eye.update(DT)
        return {name: image.numpy().copy() for name, image in eye.data.output.items()}

    cube, poses = "Cube" in paths[0], random_poses(ENVS, seed=7)
    some, expected = picture(add_many, cube, mesh_prim_paths=paths), picture(alone, cube)
    assert np.isfinite(expected["distance_to_image_plane"]).sum() > 50
    for name, image in expected.items():
        assert np.isclose(some[name], image, atol=1e-4).mean() > 0.999, name


@pytest.mark.parametrize("build", [add_few, add_many])
def test_shadows_are_those_of_newtons_sensor(build):
    plain, shadowed = pictures(build), pictures(build, shadows=True)
    check_alike(shadowed, share=0.99)  # a point at the edge of a shadow falls to either side
    dark = (shadowed["auto"]["rgb"].astype(int) - plain["auto"]["rgb"].astype(int)).max(axis=-1) < -10
    assert dark.mean() > 0.02


def test_depth_alone_is_the_depth_of_all_images():
    every = pictures(add_many)["auto"]["distance_to_image_plane"]
    camera = CameraCfg(prim_path="{ENV_REGEX_NS}/Body/eye", width=WIDTH, height=HEIGHT, data_types=["depth"])
    scene = ray_scene(camera.replace(spawn=LENS, offset=DOWN), add_many, ENVS, others={"cube": body("Cube", 0.5)})
    put(scene)
    scene.sensors["rays"].update(DT)
    np.testing.assert_array_equal(scene.sensors["rays"].data.output["depth"].numpy(), every)


def test_a_camera_inside_and_behind_things_sees_as_newtons_sensor_does():
    """Boxes around the camera and shapes through its near plane: rectangles of pixels must not be too small."""

    def add_room(template, static):
        static.add_shape_box(-1, xform=wp.transform((0, 0, 1), wp.quat_identity()), hx=3.0, hy=2.0, hz=1.5, label="/r")
        for i, at in enumerate([(0.35, 0.0, 1.2), (0.0, 0.1, 1.0), (-0.4, 0.3, 1.3), (0.5, 0.3, 1.6)]):
            static.add_shape_capsule(-1, xform=wp.transform(at, wp.quat_rpy(0.5, 1.0, 0.2 * i)), radius=0.1,
                                     half_height=0.6, color=(0.9, 0.3, 0.1 * i), label=f"/c{i}")  # fmt: skip

    found = pictures(add_room)
    own, theirs = found["auto"], found["newton"]
    near = np.isclose(own["distance_to_image_plane"], theirs["distance_to_image_plane"], atol=5e-4)
    assert near.mean() > 0.998
    assert np.isfinite(own["distance_to_image_plane"]).mean() > 0.9


def test_what_the_own_renderer_does_not_draw_is_left_to_newtons():
    pixels = np.full((4, 4, 3), 200, dtype=np.uint8)

    def add_textured(template, static):
        vertices = np.array([[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]], dtype=float)
        uvs = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=np.float32)
        mesh = newton.Mesh(vertices, np.array([0, 1, 2, 0, 2, 3]), uvs=uvs, texture=pixels, compute_inertia=False)
        static.add_shape_mesh(-1, mesh=mesh, label="/World/cloth")

    camera = CameraCfg(prim_path="{ENV_REGEX_NS}/Body/eye", width=16, height=12, data_types=["rgb"], offset=DOWN)
    scene = ray_scene(camera, add_textured, 1)
    eye = scene.sensors["rays"]
    assert isinstance(eye.renderer, NewtonRenderer)
    assert "a mesh has a texture" in eye.unavailable["to_sun"]
    place(scene, np.array([[0.0, 0.0, 1.0, 0, 0, 0, 1]]))
    eye.update(DT)
    assert eye.data.output["rgb"].float().std() >= 0.0
    assert torch.equal(eye.data.to_sun, eye.data.default_to_sun)
