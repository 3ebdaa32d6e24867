# SPDX-License-Identifier: Apache-2.0
"""Pictures of a running simulation, ray traced on its device: no display, no OpenGL."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from newton.sensors import SensorCamera

from stripe_kernels.picture import SAMPLES, Look, mark_edges, resolve_edges, shade_pixels, shadow_casters

from .camera import Follower, camera_axes, frame_points, good_azimuth
from .display_model import DisplayModel
from .lighting import Lighting, lighting_from
from .viewer_cfg import ViewerCfg

__all__ = ["SceneRenderer"]

_TALLEST = 25.0
"""How far above what is shown something may stand and still cast its shadow there [m]."""

_TILES = ((0.8, 0.1), (1.4, 0.25), (25.0, 1.0), (120.0, 5.0), (math.inf, 25.0))
"""Side of the ground's squares [m] by the camera's distance: pairs of a largest distance and a side."""


class SceneRenderer:
    """Renders chosen environments of a simulation together, in one picture.

    Args:
        sim: The simulation; its ``state`` is read at each :meth:`render`.
        cfg: Camera and picture.
        env_ids: Environments to show; default the one that ``cfg.env_index`` names.

    Raises:
        ConfigError: ``cfg`` has a problem.
        IndexError: An environment that the simulation does not have.
        ValueError: ``cfg.asset_name`` matches no body.
    """

    def __init__(self, sim: Any, cfg: ViewerCfg, env_ids: Sequence[int] | None = None):
        cfg.validate()
        self.cfg = cfg
        self._width, self._height = (int(n) for n in cfg.resolution)
        env_ids = [cfg.env_index] if env_ids is None else [int(i) for i in env_ids]
        with wp.ScopedDevice(sim.device):
            self._scene = DisplayModel(sim, env_ids, cfg.floor, cfg.recolor)
            self._setup_camera(sim, env_ids)
            away = self._eye - self._target
            lighting = lighting_from(sim.lights, azimuth=math.atan2(away[1], away[0]))
            self._tracer = _Tracer(self._scene, cfg, lighting)

    @property
    def eye(self) -> np.ndarray:
        """Camera position of the next frame before following [m], world frame, shape (3,)."""
        return self._eye.copy()

    @property
    def target(self) -> np.ndarray:
        """Point in the middle of the next frame before following [m], world frame, shape (3,)."""
        return self._target.copy()

    def look(self, eye: Sequence[float], target: Sequence[float], follow: bool = False) -> None:
        """Put the camera at ``eye`` and look at ``target`` [m], world frame.

        Args:
            eye: Camera position.
            target: Point in the middle of the picture.
            follow: Keep moving with the robots from here; otherwise the camera stands still.
        """
        camera_axes(np.asarray(eye, dtype=float), np.asarray(target, dtype=float))
        self._eye, self._target = np.array(eye, dtype=float), np.array(target, dtype=float)
        self._follow(self._movable if follow else self._movable[:0])

    def render(self) -> np.ndarray:
        """The picture of the simulation's current state: sRGB, uint8, shape (height, width, 3)."""
        if self._tracer is None:
            raise RuntimeError("SceneRenderer.render: the renderer is closed; make a new one")
        with wp.ScopedDevice(self._scene.model.device):
            poses = self._scene.update()
            shift = self._shift(poses)
            return self._tracer.render(self._eye + shift, self._target + shift, self._reach(poses, shift))

    def close(self) -> None:
        """Give back the memory that the renderer holds. A second call does nothing."""
        self._tracer = None  # type: ignore[assignment]

    def _setup_camera(self, sim: Any, env_ids: Sequence[int]) -> None:
        cfg, scene = self.cfg, self._scene
        points = scene.bounds()
        middle = points.mean(axis=0) if len(points) else np.zeros(3)
        self._radius = float(np.linalg.norm(points - middle, axis=1).max(initial=0.0)) or 1.0
        self._center, self._spread = middle, 0.0
        free = _free_roots(sim.template)
        self._movable = np.array([r + b for r in scene.roots for b in free], dtype=int)
        if cfg.eye is None or cfg.lookat is None:
            aspect = self._width / self._height
            azimuth = good_azimuth(points) if cfg.azimuth is None else math.radians(cfg.azimuth)
            elevation, fov = math.radians(cfg.elevation), math.radians(cfg.fov)
            self._eye, self._target = frame_points(points, azimuth, elevation, fov, aspect, cfg.margin)
            self._follow(self._movable if cfg.follow else self._movable[:0])
            return
        origin, followed = np.zeros(3), self._movable[:0]
        if cfg.origin_type != "world":
            first = env_ids[0] if cfg.env_index not in env_ids else cfg.env_index
            now = getattr(sim, "env_origin", None)  # a terrain moves the origins
            origin = np.asarray(sim.env_origins[first] if now is None else now.numpy()[first], dtype=float)
        if cfg.origin_type == "asset_root":
            copy = list(env_ids).index(cfg.env_index) if cfg.env_index in env_ids else 0
            body = scene.roots[copy] + _root_body(sim.template, cfg.asset_name)
            followed = np.array([body])
            origin = scene.body_q[body, :3].astype(float)
        self._eye, self._target = origin + np.asarray(cfg.eye), origin + np.asarray(cfg.lookat)
        self._follow(followed)

    def _follow(self, bodies: np.ndarray) -> None:
        """From here on the camera moves with the mean position of ``bodies``, indices into the display state."""
        self._follow_bodies = bodies
        self._follower = Follower(self.cfg.follow_time, jump=max(self._radius, 0.5))
        at = self._scene.body_q[bodies, :3].astype(float) if len(bodies) else np.zeros((1, 3))
        self._rest = np.nan_to_num(at.mean(axis=0))

    def _shift(self, poses: np.ndarray) -> np.ndarray:
        """How far the camera has moved with what it follows since it was set up, shape (3,)."""
        if len(self._follow_bodies) == 0:
            return np.zeros(3)
        at = poses[self._follow_bodies, :3].astype(float)
        at = at[np.isfinite(at).all(axis=1)]
        if len(at) == 0:
            return np.zeros(3)
        return self._follower.follow(at.mean(axis=0)) - self._rest

    def _reach(self, poses: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, float]:
        """Centre and radius [m] of the ball in which shadows are cast. It grows in steps, so that shadows stay calm."""
        center = self._center + shift
        if len(poses):
            far = np.linalg.norm(poses[:, :3] - center, axis=1)
            far = far[np.isfinite(far)]
            self._spread = max(self._spread, self._radius)
            limit = 4.0 * self._radius
            while len(far) and self._spread < min(float(far.max()), limit):
                self._spread *= 1.25
        return center, 1.1 * max(self._spread, self._radius)


def _free_roots(template: Any) -> list[int]:
    """Bodies of the template that hang on a free joint, or on none."""
    import newton

    held = {int(c) for c in template.joint_child}
    free = [
        int(child)
        for kind, parent, child in zip(template.joint_type, template.joint_parent, template.joint_child)
        if int(parent) < 0 and int(kind) in (int(newton.JointType.FREE), int(newton.JointType.DISTANCE))
    ]
    return free[:1] or [b for b in range(template.body_count) if b not in held][:1]


def _root_body(template: Any, asset_name: str | None) -> int:
    """Index of the first body of the template whose label has ``asset_name`` in its path."""
    labels = [str(label) for label in template.body_label]
    if not labels:
        raise ValueError("viewer.origin_type: 'asset_root' needs a body to follow, but the environment has none")
    if asset_name is None:
        return 0
    for i, label in enumerate(labels):
        if asset_name.lower() in (part.lower() for part in label.split("/")):
            return i
    known = sorted({part for label in labels for part in label.split("/")[:-1] if part}) or labels
    raise ValueError(f"viewer.asset_name: no body has '{asset_name}' in its path; there is {', '.join(known)}")


class _Tracer:
    """The frames' buffers and the passes over them: shadow map, one ray a pixel, more rays on edges."""

    def __init__(self, scene: DisplayModel, cfg: ViewerCfg, lighting: Lighting):
        self._scene, self._cfg, self._lighting = scene, cfg, lighting
        self._device = scene.model.device
        self._width, self._height = (int(n) for n in cfg.resolution)
        self._tan_y = math.tan(0.5 * math.radians(cfg.fov))
        self._tan_x = self._tan_y * self._width / self._height
        config = SensorCamera.RenderConfig(
            enable_textures=scene.textured, enable_backface_culling=False, enable_ambient_lighting=False
        )
        self._sensor = SensorCamera(scene.model, default_render_config=config, load_textures=scene.textured)
        pixels = self._width * self._height
        self._rays = wp.array(self._pinhole(), dtype=wp.vec3f, device=self._device)
        self._main = self._images(pixels)
        self._picture = wp.empty(pixels * 3, dtype=wp.uint8, device=self._device)
        self._colors = wp.array(scene.colors, dtype=wp.vec3f, device=self._device)
        self._is_ground = wp.array(scene.is_ground.astype(np.int32), dtype=wp.int32, device=self._device)
        self._transform = wp.zeros(1, dtype=wp.transformf, device=self._device)
        size = cfg.shadow_resolution if cfg.shadows and lighting.to_sun[2] > 0.05 else 0
        self._shadow_size = size
        self._shadow_images = self._images(size * size) if size else {}
        self._casters = wp.empty(max(size * size, 1), dtype=wp.float32, device=self._device)
        self._sun_axes = camera_axes(lighting.to_sun, np.zeros(3))
        self._capacity = pixels // 3 if cfg.anti_aliasing else 0
        if self._capacity:
            self._edge_count = wp.zeros(1, dtype=wp.int32, device=self._device)
            self._edge_pixels = wp.empty(self._capacity, dtype=wp.int32, device=self._device)
            self._edge_rays = wp.empty((self._capacity * SAMPLES, 2), dtype=wp.vec3f, device=self._device)
            self._edge_images = self._images(self._capacity * SAMPLES)

    def render(self, eye: np.ndarray, target: np.ndarray, reach: tuple[np.ndarray, float]) -> np.ndarray:
        """One frame, uint8 (height, width, 3)."""
        look = self._look(eye, target, *reach)
        if self._shadow_size:
            self._trace_shadows(look)
        pose = _pose(eye, camera_axes(eye, target))
        pixels = self._width * self._height
        self._trace(pose, self._rays, self._main, (self._height, self._width))
        shared = [self._colors, self._is_ground, self._casters, self._picture]
        surface = [self._main[k] for k in ("depth", "shape", "normal")]
        args = [look, *surface, self._main["albedo"], *shared]
        wp.launch(shade_pixels, dim=pixels, inputs=args, device=self._device)
        if self._capacity:
            self._smooth_edges(look, pose, surface, shared)
        return np.array(self._picture.numpy()).reshape(self._height, self._width, 3)  # on the CPU numpy() shares memory

    def _smooth_edges(self, look: Look, pose: np.ndarray, surface: list[wp.array], shared: list[wp.array]) -> None:
        self._edge_count.zero_()
        args = [look, *surface[1:], self._capacity, self._edge_count, self._edge_pixels, self._edge_rays]
        wp.launch(mark_edges, dim=self._width * self._height, inputs=args, device=self._device)
        count = min(int(self._edge_count.numpy()[0]), self._capacity)
        if count == 0:
            return
        rays = self._edge_rays[: count * SAMPLES].reshape((1, count * SAMPLES, 1, 2))
        images = {k: v[: count * SAMPLES] if v.size else v for k, v in self._edge_images.items()}
        self._trace(pose, rays, images, (1, count * SAMPLES))
        fine = [images[k] for k in ("depth", "shape", "normal", "albedo")]
        wp.launch(resolve_edges, dim=count, inputs=[look, self._edge_pixels, *fine, *shared], device=self._device)

    def _trace_shadows(self, look: Look) -> None:
        """Distances along parallel rays from the sun over the region of ``look``; other kernels read them."""
        size, half = self._shadow_size, look.shadow_half
        center = np.array([look.shadow_center[i] for i in range(3)])
        pose = _pose(center + look.shadow_start * self._lighting.to_sun, self._sun_axes)
        if getattr(self, "_shadow_half", None) != half:
            self._shadow_half = half
            self._shadow_rays = wp.array(_parallel(size, half), dtype=wp.vec3f, device=self._device)
        images = self._shadow_images
        self._trace(pose, self._shadow_rays, images, (size, size))
        args = [size, images["depth"], images["shape"], self._is_ground, self._casters]
        wp.launch(shadow_casters, dim=size * size, inputs=args, device=self._device)

    def _trace(self, pose: np.ndarray, rays: wp.array, images: dict[str, wp.array], size: tuple[int, int]) -> None:
        self._transform.assign(pose[None].astype(np.float32))
        shaped = {k: v.reshape((1, *size)) for k, v in images.items() if v.size}
        self._sensor.update(
            self._scene.state,
            self._transform,
            rays,
            depth_image=shaped["depth"],
            shape_index_image=shaped["shape"],
            normal_image=shaped["normal"],
            albedo_image=shaped.get("albedo"),
        )

    def _images(self, count: int) -> dict[str, wp.array]:
        kinds = {"depth": wp.float32, "shape": wp.uint32, "normal": wp.vec3f, "albedo": wp.uint32}
        sizes = {"albedo": count if self._scene.textured else 0}
        return {k: wp.zeros(sizes.get(k, count), dtype=t, device=self._device) for k, t in kinds.items()}

    def _pinhole(self) -> np.ndarray:
        """Rays through the middle of each pixel, camera frame, shape (height, width, 1, 2, 3)."""
        x = ((np.arange(self._width) + 0.5) / self._width * 2.0 - 1.0) * self._tan_x
        y = (1.0 - (np.arange(self._height) + 0.5) / self._height * 2.0) * self._tan_y
        rays = np.zeros((self._height, self._width, 1, 2, 3), dtype=np.float32)
        rays[..., 0, 1, 0], rays[..., 0, 1, 1], rays[..., 0, 1, 2] = x[None], y[:, None], -1.0
        rays[..., 1, :] /= np.linalg.norm(rays[..., 1, :], axis=-1, keepdims=True)
        return rays

    def _look(self, eye: np.ndarray, target: np.ndarray, center: np.ndarray, radius: float) -> Look:
        look, axes, sun = Look(), camera_axes(eye, target), self._sun_axes
        distance = float(np.linalg.norm(eye - target))
        look.width, look.height, look.tan_x, look.tan_y = self._width, self._height, self._tan_x, self._tan_y
        for name, value in zip(("eye", "right", "up", "back"), (eye, *axes.T)):
            setattr(look, name, wp.vec3f(*value))
        for name in ("to_sun", "sun", "sky", "ground", "horizon", "zenith"):
            setattr(look, name, wp.vec3f(*getattr(self._lighting, name)))
        reach = max(distance, 6.0)
        look.fog_start = 1.2 * reach
        look.fog_length = 9.0 * reach / self._cfg.fog if self._cfg.fog > 0 else 0.0
        look.tile = next(side for limit, side in _TILES if distance <= limit)
        look.shadow_size, look.shadow_half = self._shadow_size, radius
        look.shadow_start = 2.0 * radius + _TALLEST
        texel = 2.0 * radius / max(self._shadow_size, 1)  # whole texels only, or the shadows' edges crawl
        local = center @ sun
        local[:2] = np.round(local[:2] / texel) * texel
        look.shadow_center = wp.vec3f(*(sun @ local))
        look.shadow_x, look.shadow_y = wp.vec3f(*sun[:, 0]), wp.vec3f(*sun[:, 1])
        return look


def _parallel(size: int, half: float) -> np.ndarray:
    """Parallel rays over a square of side ``2 half`` [m], camera frame, shape (size, size, 1, 2, 3)."""
    at = ((np.arange(size) + 0.5) / size * 2.0 - 1.0) * half
    rays = np.zeros((size, size, 1, 2, 3), dtype=np.float32)
    rays[..., 0, 0, 0], rays[..., 0, 0, 1], rays[..., 0, 1, 2] = at[None], -at[:, None], -1.0
    return rays


def _pose(position: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Position and the quaternion (xyzw) of a rotation whose columns are ``axes``, shape (7,)."""
    quat = wp.quat_from_matrix(wp.mat33f(*axes.astype(float).reshape(-1)))
    return np.array([*position, *quat])
