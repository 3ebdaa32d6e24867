# SPDX-License-Identifier: Apache-2.0
"""Scene pictures: a generated scene from above and at eye level, drawn without a simulation."""

from __future__ import annotations

import math
from collections.abc import MutableSequence, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import newton
import numpy as np
import warp as wp
from PIL import Image
from pxr import Usd

from stripe_newton.scene.scenery import add_scenery, read_scenery
from stripe_newton.usd import Light, read_lights
from stripe_newton.viewers import SceneRenderer, ViewerCfg, VisualizationMarkers
from stripe_newton.viewers.camera_framing import frame_points

if TYPE_CHECKING:
    from stripe_newton.sim.body_choice import BodyChoice

    from .scene_spec import Scene

__all__ = ["EYE_HEIGHT", "ScenePictures", "StillLife", "still_life"]

EYE_HEIGHT = 1.2
"""Height of the camera above the ground [m]."""
_OVERSAMPLING = 2
"""Rays along each side of a pixel; their mean is the pixel."""
_FOV_ABOVE, _FOV = 46.0, 58.0
"""Vertical fields of view from above and at eye level [deg]."""
_ELEVATION, _FRAMED = 26.0, 33.0
"""From above: angle of the camera above the scene, and the part of its field of view that the scene fills [deg]."""
_HAZE = 0.004
"""Haze at eye level [1/m]."""
_SIGHT = 40.0
"""Distance beyond which a farther sight does not make a better view [m]."""


class ScenePictures:
    """Draws a scene with the ray tracer of the viewers.

    Args:
        scene: The scene.
        resolution: Width and height of the pictures [px].
        device: Device to trace on. None: the first GPU if there is one, otherwise the CPU.
    """

    def __init__(self, scene: Scene, resolution: tuple[int, int] = (960, 540), device: str | None = None):
        self.scene, self.resolution = scene, resolution
        if device is None:
            device = "cuda:0" if wp.is_cuda_available() else "cpu"
        self._sim = still_life(scene, wp.get_device(device))
        width, height = (_OVERSAMPLING * n for n in resolution)
        cfg = ViewerCfg(resolution=(width, height), natural=True, anti_aliasing=False, shadows=False)
        cfg.eye, cfg.lookat, cfg.origin_type = (0.0, 0.0, 1.0), (1.0, 0.0, 1.0), "world"
        self._renderer = SceneRenderer(self._sim, cfg)

    def birds_eye(self) -> np.ndarray:
        """A picture of the whole scene from above at an angle, uint8 (height, width, 3)."""
        ground = self.scene.terrain.ground
        # The eight corners of the box around the scene must be visible.
        x, y = np.meshgrid(*(ground.lower[i] + np.array([0.0, ground.size[i]]) for i in (0, 1)))
        low, high = float(ground.heights.min()), 0.9 * self._top()
        points = np.array([[a, b, z] for a, b in zip(x.ravel(), y.ravel(), strict=True) for z in (low, high)])
        aspect = self.resolution[0] / self.resolution[1]
        azimuth = self._sun_azimuth() + math.radians(75.0)  # light from the side models the relief
        azimuth = _towards_corner(azimuth, ground.size)
        eye, target = frame_points(points, azimuth, math.radians(_ELEVATION), math.radians(_FRAMED), aspect, 0.76)
        # Up to the horizon: without it nothing says how high the camera is.
        flat, pitch = target - eye, math.radians(_ELEVATION - 0.5 * (_FOV_ABOVE - _FRAMED))
        flat[2] = -math.hypot(flat[0], flat[1]) * math.tan(pitch)
        target = eye + flat
        # So much of the light is lost on the way, whatever the size of the scene.
        haze = 0.07 / float(np.linalg.norm(eye - target))
        return self._shot(eye, target, _FOV_ABOVE, haze, 0.8)

    def eye_level(self) -> np.ndarray:
        """A picture of the clearest view near the terrain's origin, uint8 (height, width, 3)."""
        eye, target = self.view()
        return self._shot(eye, target, _FOV, _HAZE, 1.0)

    def view(self) -> tuple[np.ndarray, np.ndarray]:
        """Eye and target [m] of :meth:`eye_level`: the best of several positions near the origin and of directions.

        The eye is outside of all colliders. Good views have nothing close to the camera, and both near and far things.
        """
        terrain = self.scene.terrain
        origin, turns = np.array(terrain.origin), np.radians(np.arange(0.0, 360.0, 15.0))
        # Positions on circles around the origin, those inside the terrain and clear of colliders.
        ring = [(r, a) for r in (1.5, 3.0, 5.0, 8.0) for a in np.radians(np.arange(0.0, 360.0, 45.0))]
        spots = np.array([[0.0, 0.0], *([r * math.cos(a), r * math.sin(a)] for r, a in ring)]) + origin[:2]
        lower = np.array(terrain.ground.lower)
        inside = ((spots > lower + 0.5) & (spots < lower + terrain.size - 0.5)).all(axis=1)
        spots = spots[inside & self._clear(spots)]
        if not len(spots):  # a scene without a free spot still gets its picture
            spots = origin[None, :2]
        eyes = np.column_stack([spots, terrain.ground.height_at(spots[:, 0], spots[:, 1]) + EYE_HEIGHT])
        seen = self._distances(eyes, turns)
        # A good view is far in the middle of the picture, has depth, nothing right in front, and sun from the side.
        middle = np.minimum(seen, _SIGHT)[:, :, 4:-4, 2:-1].mean(axis=(2, 3))
        near = np.quantile(seen, 0.06, axis=(2, 3))
        depth = np.minimum(seen, _SIGHT).std(axis=(2, 3))  # something near, something far
        light = 1.0 - 0.25 * np.cos(turns - self._sun_azimuth() - math.radians(60.0))
        score = (middle + 0.7 * depth) * np.clip((near - 1.0) / 2.5, 0.02, 1.0) * (2.0 - light)[None]
        spot, turn = np.unravel_index(int(np.argmax(score)), score.shape)
        eye, a = eyes[spot], turns[turn]
        ahead = eye[:2] + 8.0 * np.array([math.cos(a), math.sin(a)])
        # The view follows a part of the slope ahead, and looks a little up.
        rise = 0.4 * float(np.clip(terrain.ground.height_at(*ahead) + EYE_HEIGHT - eye[2], -2.5, 2.5))
        return eye, np.array([*ahead, eye[2] + 0.45 + rise])

    def _distances(self, eyes: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Distances seen from each eye in each direction, in a coarse picture, shape (eyes, turns, 17, 9) [m]."""
        across, up = np.radians(np.linspace(-40.0, 40.0, 17)), np.radians(np.linspace(-24.0, 26.0, 9))
        yaw = (turns[:, None] + across)[..., None]
        parts = np.cos(up) * np.cos(yaw), np.cos(up) * np.sin(yaw), np.broadcast_to(np.sin(up), (*yaw.shape[:2], 9))
        rays = np.stack(parts, axis=-1)
        seen = self._renderer.distances(eyes, rays.reshape(-1, 3), 4.0 * _SIGHT)
        return seen.reshape(len(eyes), *rays.shape[:3])

    def _clear(self, spots: np.ndarray) -> np.ndarray:
        """Whether positions (n, 2) are at least half a metre away from all colliders."""
        free = np.ones(len(spots), dtype=bool)
        for instance in self.scene.instances:
            away = np.linalg.norm(spots - instance.position[:2], axis=1)
            if away.min() > 12.0 * instance.scale:  # no collider reaches so far
                continue
            for collider in instance.mesh.colliders():
                reach = math.hypot(*collider.size) + math.hypot(*collider.pos[:2])
                if collider.kind in ("capsule", "cylinder") and abs(collider.rot[3]) > 0.99:  # upright
                    reach = collider.size[0] + math.hypot(*collider.pos[:2])
                free &= away > reach * instance.scale + 0.5
        return free

    def _top(self) -> float:
        """Height of the highest point of the scene [m]."""
        tall: dict[int, float] = {}
        top = float(self.scene.terrain.ground.heights.max())
        for instance in self.scene.instances:
            key = id(instance.mesh)
            if key not in tall:
                tall[key] = max((float(p.vertices[:, 2].max()) for p in instance.mesh.parts()), default=0.0)
            top = max(top, instance.position[2] + tall[key] * instance.scale)
        return top

    def _sun_azimuth(self) -> float:
        found = [light.direction for light in self._sim.lights if light.kind == "distant"]
        return math.atan2(-found[0][1], -found[0][0]) if found else math.radians(-130.0)

    def _shot(self, eye: np.ndarray, target: np.ndarray, fov: float, haze: float, exposure: float) -> np.ndarray:
        self._renderer.cfg.haze, self._renderer.cfg.exposure = haze, exposure
        self._renderer.look(eye.tolist(), target.tolist(), fov=fov)
        return np.asarray(Image.fromarray(self._renderer.render()).resize(self.resolution, Image.Resampling.BOX))


def _towards_corner(azimuth: float, size: tuple[float, float]) -> float:
    """The azimuth of the corner of a field that is nearest to ``azimuth`` [rad]: from there the field looks largest."""
    corners = [math.atan2(sy * size[1], sx * size[0]) for sx in (-1, 1) for sy in (-1, 1)]
    nearest = max(corners, key=lambda a: math.cos(a - azimuth))
    return nearest + math.radians(14.0)


@dataclass
class StillLife:
    """A scene in which nothing moves, as the viewers read it: see :class:`ViewedSimulation`."""

    device: wp.Device
    static: newton.ModelBuilder
    lights: list[Light]
    template: newton.ModelBuilder = field(default_factory=newton.ModelBuilder)
    env_origins: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))
    body_choices: Sequence[BodyChoice] = ()
    env_origin: wp.array | None = None
    state: newton.State | None = None
    num_envs: int = 1
    markers: MutableSequence[VisualizationMarkers] = field(default_factory=list)


def still_life(scene: Scene, device: wp.Device) -> StillLife:
    """A scene for the viewers, without a simulation."""
    stage, terrain = scene.stage, scene.terrain
    static = newton.ModelBuilder()
    add_scenery(static, read_scenery(stage), touched=False)
    if terrain.colors is not None:
        # Newton's Heightfield has no colours of its own: the renderer looks for this attribute.
        terrain.ground.source.colors = np.asarray(terrain.colors, dtype=np.float32)
    static.add_shape_heightfield(
        xform=wp.transform(wp.vec3(*terrain.ground.middle, 0.0), wp.quat_identity()),
        heightfield=terrain.ground.source,
        color=newton.utils.color_linear_to_srgb(terrain.color),
    )
    for part, _ in terrain.parts:
        mesh = newton.Mesh(part.vertices, part.faces.reshape(-1), compute_inertia=False, roughness=part.roughness)
        mesh.two_sided = part.double_sided  # a mark of generated scenery, see SceneryTracer
        static.add_shape_mesh(-1, mesh=mesh, color=newton.utils.color_linear_to_srgb(part.color))
    # Only the lights are populated: the stage of a forest has tens of thousands of prims.
    lights = Usd.StagePopulationMask(["/World/Light", "/World/Sun"])
    return StillLife(device, static, read_lights(Usd.Stage.OpenMasked(stage.GetRootLayer(), lights)))
