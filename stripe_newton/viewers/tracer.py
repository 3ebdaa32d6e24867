# SPDX-License-Identifier: Apache-2.0
"""Tracer: one frame of a display model, with rays by Newton's camera sensor and shading by own kernels."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import warp as wp
from newton.sensors import SensorCamera

from stripe_kernels.box_normals import fill_box_normals
from stripe_kernels.picture import SAMPLES, mark_edges, resolve_edges, shade_pixels, shadow_casters
from stripe_kernels.picture_light import Look
from stripe_kernels.picture_parts import gather_rays, scatter_hits, trace_planes
from stripe_newton.thread_pool import ThreadPool
from stripe_newton.threads import available_cores

from .camera_framing import camera_axes
from .display_model import DisplayModel
from .lighting import Lighting
from .look import lit_look
from .picture_parts import Part, PictureParts, View
from .viewer_cfg import ViewerCfg

if TYPE_CHECKING:
    from .scenery_tracer import SceneryTracer

__all__ = ["Tracer"]

_MOST_THREADS = 8
"""Threads that shade a picture on the CPU."""

_LEAST_FOR_THREAD = 16384
"""Pixels from which on another thread helps."""

_NO_SHAPE = 0xFFFFFFFF
"""Index of the shape that a ray hit, if it hit none."""

_TALLEST = 25.0
"""Height above the shown region up to which things cast their shadow into it [m]."""

_FARTHEST = 3.0e4
"""Length of the rays [m]: to the horizon."""

_KEY = 0.16
"""Mean linear brightness of scenery in a picture, before highlights are compressed."""
_EXPOSE_EVERY = 5
"""Frames between two measurements of the brightness of the scenery, each of which copies it to the host."""

_TILES = ((0.8, 0.1), (1.4, 0.25), (25.0, 1.0), (120.0, 5.0), (math.inf, 25.0))
"""Pairs of the camera's largest distance and the side of the ground's squares at it [m]."""


class Tracer:
    """Buffers of a frame and the passes over them: shadow map, one ray per pixel, more rays on edges.

    On the CPU a frame reuses what it can of the frame before, see :class:`PictureParts`. The picture stays the same.
    """

    def __init__(self, scene: DisplayModel, cfg: ViewerCfg, lighting: Lighting):
        self._scene, self._cfg, self._lighting = scene, cfg, lighting
        self._device = scene.model.device
        self._width, self._height = cfg.size_on(self._device.is_cuda)
        config = SensorCamera.RenderConfig(
            enable_textures=scene.textured,
            enable_backface_culling=False,
            enable_ambient_lighting=False,
            max_distance=_FARTHEST,
        )
        # Newton's sensor finds what each ray hits; lights, shadows and fog are computed from that here.
        self._sensor = SensorCamera(scene.model, default_render_config=config, load_textures=scene.textured)
        pixels = self._width * self._height
        self.set_fov(cfg.fov)
        self._main = self._images(pixels)
        self._picture = wp.empty(pixels * 3, dtype=wp.uint8, device=self._device)
        self._colors = wp.array(scene.colors, dtype=wp.vec3f, device=self._device)
        self._is_ground = wp.array(scene.is_ground.astype(np.int32), dtype=wp.int32, device=self._device)
        self._transform = wp.zeros(1, dtype=wp.transformf, device=self._device)
        # No shadows of a sun at the horizon: they would be longer than the shadow map reaches.
        size = cfg.shadow_size_on(self._device.is_cuda) if cfg.shadows and lighting.to_sun[2] > 0.05 else 0
        self._shadow_size = size
        self._shadow_images = self._images(size * size) if size else {}
        self._casters = wp.empty(max(size * size, 1), dtype=wp.float32, device=self._device)
        self._sun_axes = camera_axes(lighting.to_sun, np.zeros(3))
        self._shadow_half = math.nan  # equal to no size, so that the first frame makes the rays
        still = np.zeros(len(scene.colors) if len(scene.scenery) else 0, dtype=np.int32)
        still[scene.scenery] = 1
        self._still = wp.array(still, dtype=wp.int32, device=self._device)
        self._all_pixels = wp.array(np.arange(pixels), dtype=wp.int32, device=self._device)
        self._parts: PictureParts | None = None
        if self._device.is_cpu and PictureParts.serves(scene):
            self._use_parts(PictureParts(scene, (self._width, self._height), size))
        self._pool = ThreadPool(_MOST_THREADS, "shade")
        self._frames_shaded = 0
        self.scenery: SceneryTracer | None = None
        if len(scene.scenery):
            from .scenery_tracer import SceneryTracer  # here, as its kernels and scipy take long to import

            self.scenery = SceneryTracer(scene)
        # Room for a third of the pixels; beyond that, pixels on edges stay as they are.
        self._capacity = pixels // 3 if cfg.anti_aliasing else 0
        if self._capacity:
            self._edge_count = wp.zeros(1, dtype=wp.int32, device=self._device)
            self._edge_pixels = wp.empty(self._capacity, dtype=wp.int32, device=self._device)
            self._edge_rays = wp.empty((self._capacity * SAMPLES, 2), dtype=wp.vec3f, device=self._device)
            self._edge_images = self._images(self._capacity * SAMPLES)

    def _use_parts(self, parts: PictureParts) -> None:
        """Trace no more of the picture than the parts that need it."""
        self._parts, index = parts, parts.planes
        poses = self._scene.model.shape_transform.numpy()[index]
        planes = wp.array(poses, dtype=wp.transformf, device=self._device)
        self._planes = [planes, wp.array(index, dtype=wp.uint32, device=self._device)]
        most = max(self._width * self._height, self._shadow_size**2)
        self._some_rays = wp.empty((most, 2), dtype=wp.vec3f, device=self._device)
        self._some_images = self._images(most)

    def set_fov(self, fov: float) -> None:
        """Set the vertical field of view [deg]. The exposure starts anew at the next frame."""
        self._tan_y = math.tan(0.5 * math.radians(fov))
        self._tan_x = self._tan_y * self._width / self._height
        self._rays = wp.array(self._pinhole(), dtype=wp.vec3f, device=self._device)
        self._exposure, self._frames = 1.0, 0

    def render(self, eye: np.ndarray, target: np.ndarray, reach: tuple[np.ndarray, float]) -> np.ndarray:
        """One frame, uint8 (height, width, 3)."""
        look = self._look(eye, target, *reach)
        axes = camera_axes(eye, target)
        pose, count = _pose(eye, axes), self._width * self._height
        rays = self._rays.reshape((count, 2))
        pixels, part = self._all_pixels, None
        if self._parts is not None:
            center = np.array([look.shadow_center[i] for i in range(3)])
            view = View(eye, axes, (self._tan_x, self._tan_y), self._sun_axes, center, look.shadow_half)
            part = self._parts.choose(view)
            pixels = self._indices(part.pixels)
        if self._shadow_size and pixels.size:
            self._trace_shadows(look, part)
        # The sensor first: scenery overwrites a pixel where it is nearer.
        if part is None:
            self._trace(pose, self._rays, self._main, (self._height, self._width))
        elif pixels.size:
            self._trace_part(pose, rays, part)
        if self.scenery is not None:
            self.scenery.trace(look, rays, self._casters, self._main)
            look.exposure = self._exposure = self._expose()
        if pixels.size:
            self._shade(look, pose, pixels)
        # A copy: on the CPU numpy() shares the memory that the next frame is written to.
        return np.array(self._picture.numpy()).reshape(self._height, self._width, 3)

    def _shade(self, look: Look, pose: np.ndarray, pixels: wp.array) -> None:
        """Shade listed pixels, and smooth the edges among them."""
        shared = [self._colors, self._is_ground, self._casters]
        surface = [self._main[k] for k in ("depth", "shape", "normal")]
        args = [look, *surface, self._main["albedo"], *shared, self._main["detail"], self._picture]
        self._share(args, pixels)
        if self._capacity:
            self._smooth_edges(look, pose, surface, shared, pixels)

    def _share(self, args: list[object], pixels: wp.array) -> None:
        """Shade listed pixels, on the CPU in parts that threads compute beside each other."""
        count = pixels.size
        parts = 1 if self._device.is_cuda else min(available_cores(), _MOST_THREADS, 1 + count // _LEAST_FOR_THREAD)
        size = -(-count // parts)

        def shade(first: int) -> None:
            some = pixels[first : min(first + size, count)]  # Warp takes no end beyond the array's
            wp.launch(shade_pixels, some.size, [*args, some], device=self._device)

        if parts == 1 or self._frames_shaded == 0:  # the first one compiles and loads the kernel
            size = count
            shade(0)
        else:
            list(self._pool.executor.map(shade, range(0, count, size)))
        self._frames_shaded += 1

    def _expose(self) -> float:
        """Exposure that makes the scenery as bright as in a photograph. It adapts slowly, as a camera does."""
        if (self._frames % _EXPOSE_EVERY) == 0:
            detail = self._main["detail"].numpy()[::7]  # every seventh pixel says enough
            light = detail[detail[:, 3] < 0.0, :3].mean(axis=1)  # w < 0: pixels of scenery, see picture_scenery.py
            if len(light) > 64:
                level = math.exp(float(np.log(light + 0.01).mean()))
                wanted = self._cfg.exposure * float(np.clip(_KEY / level, 0.8, 4.0))
                self._exposure += (wanted - self._exposure) * (1.0 if self._frames == 0 else 0.3)
        self._frames += 1
        return self._exposure

    def _smooth_edges(
        self, look: Look, pose: np.ndarray, surface: list[wp.array], shared: list[wp.array], pixels: wp.array
    ) -> None:
        self._edge_count.zero_()
        found = [self._edge_count, self._edge_pixels, self._edge_rays]
        args = [look, *surface[1:], self._still, pixels, self._capacity, *found]
        wp.launch(mark_edges, dim=pixels.size, inputs=args, device=self._device)
        # Reading the number waits for the device, and saves tracing rays for all the room that there is.
        count = min(int(self._edge_count.numpy()[0]), self._capacity)
        if count == 0:
            return
        rays = self._edge_rays[: count * SAMPLES].reshape((1, count * SAMPLES, 1, 2))
        images = {k: v[: count * SAMPLES] if v.size else v for k, v in self._edge_images.items()}
        self._trace(pose, rays, images, (1, count * SAMPLES))
        if self.scenery is not None:
            self.scenery.trace(look, self._edge_rays[: count * SAMPLES], self._casters, images)
        fine = [images[k] for k in ("depth", "shape", "normal", "albedo")]
        args = [look, self._edge_pixels, *fine, *shared, images["detail"], self._picture]
        wp.launch(resolve_edges, dim=count, inputs=args, device=self._device)

    def _trace_shadows(self, look: Look, part: Part | None) -> None:
        """Trace the shadow map: distances along parallel rays from the sun over the region of ``look``."""
        size, half = self._shadow_size, look.shadow_half
        center = np.array([look.shadow_center[i] for i in range(3)])
        pose = _pose(center + look.shadow_start * self._lighting.to_sun, self._sun_axes)
        if self._shadow_half != half:
            self._shadow_half = half
            self._shadow_rays = wp.array(_parallel(size, half), dtype=wp.vec3f, device=self._device)
        images = self._shadow_images
        if part is None:
            self._trace(pose, self._shadow_rays, images, (size, size))
        else:
            if not part.is_same_view:
                images["shape"].fill_(_NO_SHAPE)
            self._trace_listed(pose, self._shadow_rays.reshape((size * size, 2)), part.texels, images)
        args = [size, images["depth"], images["shape"], self._is_ground, self._casters]
        wp.launch(shadow_casters, dim=size * size, inputs=args, device=self._device)

    def _trace_part(self, pose: np.ndarray, rays: wp.array, part: Part) -> None:
        """Trace a part of the picture: by the sensor where shapes may be, elsewhere planes alone."""
        self._trace_listed(pose, rays, part.traced, self._main)
        if len(part.plain):
            self._transform.assign(pose[None].astype(np.float32))
            plain, images = self._indices(part.plain), [self._main[k] for k in ("depth", "shape", "normal")]
            args = [self._transform, rays, plain, *self._planes, _FARTHEST, *images]
            wp.launch(trace_planes, dim=plain.size, inputs=args, device=self._device)

    def _trace_listed(self, pose: np.ndarray, rays: wp.array, pixels: np.ndarray, images: dict[str, wp.array]) -> None:
        """Trace the listed ones of rays, shape (n, 2), into their places in images."""
        count = len(pixels)
        if count == 0:
            return
        index, listed = self._indices(pixels), self._some_rays[:count]
        wp.launch(gather_rays, dim=count, inputs=[rays, index, listed], device=self._device)
        some = {k: v[:count] if v.size else v for k, v in self._some_images.items()}
        self._trace(pose, listed.reshape((1, count, 1, 2)), some, (1, count))
        kinds = ("depth", "shape", "normal")
        args = [index, *(some[k] for k in kinds), *(images[k] for k in kinds)]
        wp.launch(scatter_hits, dim=count, inputs=args, device=self._device)

    def _indices(self, values: np.ndarray) -> wp.array:
        """An array of indices for kernels on the CPU, which shares the memory."""
        return wp.array(values, dtype=wp.int32, device=self._device, copy=False)

    def _trace(self, pose: np.ndarray, rays: wp.array, images: dict[str, wp.array], size: tuple[int, int]) -> None:
        self._transform.assign(pose[None].astype(np.float32))
        if not self._scene.model.bvh_shape_count_enabled:  # nothing that the sensor could trace
            images["shape"].fill_(_NO_SHAPE)
            return
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
        model, state = self._scene.model, self._scene.state
        args = [self._transform, rays, shaped["shape"], model.shape_type, model.shape_scale, model.shape_body]
        args += [model.shape_transform, state.body_q, shaped["normal"]]
        wp.launch(fill_box_normals, dim=(1, *size), inputs=args, device=self._device)

    def _images(self, count: int) -> dict[str, wp.array]:
        kinds = {"depth": wp.float32, "shape": wp.uint32, "normal": wp.vec3f, "albedo": wp.uint32, "detail": wp.vec4f}
        # Images that nobody reads stay empty, which saves their memory and the time to write them.
        sizes = {"albedo": count if self._scene.textured else 0, "detail": count if len(self._scene.scenery) else 0}
        return {k: wp.zeros(sizes.get(k, count), dtype=t, device=self._device) for k, t in kinds.items()}

    def _pinhole(self) -> np.ndarray:
        """Rays through the middle of each pixel, camera frame, shape (height, width, 1, 2, 3)."""
        x = ((np.arange(self._width) + 0.5) / self._width * 2.0 - 1.0) * self._tan_x
        y = (1.0 - (np.arange(self._height) + 0.5) / self._height * 2.0) * self._tan_y
        rays = np.zeros((self._height, self._width, 1, 2, 3), dtype=np.float32)
        rays[..., 0, 1, 0], rays[..., 0, 1, 1], rays[..., 0, 1, 2] = x[None], y[:, None], -1.0
        # Directions of length 1: the sensor's depth then is the distance along the ray.
        rays[..., 1, :] /= np.linalg.norm(rays[..., 1, :], axis=-1, keepdims=True)
        return rays

    def _look(self, eye: np.ndarray, target: np.ndarray, center: np.ndarray, radius: float) -> Look:
        distance = float(np.linalg.norm(eye - target))
        look = lit_look(self._lighting, distance, self._cfg.fog)
        axes, sun = camera_axes(eye, target), self._sun_axes
        look.width, look.height, look.tan_x, look.tan_y = self._width, self._height, self._tan_x, self._tan_y
        for name, value in zip(("eye", "right", "up", "back"), (eye, *axes.T)):
            setattr(look, name, wp.vec3f(*value))
        if self.scenery is not None:
            look.near, look.haze, look.air = self._cfg.near, self._cfg.haze, self.scenery.air_at(eye)
            look.exposure = self._exposure
        # Squares as large as makes sense at this distance: smaller ones would be noise.
        look.tile = next(side for limit, side in _TILES if distance <= limit)
        look.shadow_size, look.shadow_half = self._shadow_size, radius
        # Rays of the shadow map start above everything that may cast a shadow into the region.
        look.shadow_start = 2.0 * radius + _TALLEST
        # The map moves by whole texels only, or the edges of shadows would crawl as the camera moves.
        texel = 2.0 * radius / max(self._shadow_size, 1)
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
