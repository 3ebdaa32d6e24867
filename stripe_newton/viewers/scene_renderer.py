# SPDX-License-Identifier: Apache-2.0
"""Scene renderer: pictures of a running simulation, ray traced on its device without a display or OpenGL."""

from __future__ import annotations

import math
from collections.abc import Sequence

import newton
import numpy as np
import warp as wp

from .camera_framing import (
    USUAL_AZIMUTH,
    Follower,
    camera_axes,
    frame_points,
    good_azimuth,
    good_elevation,
    views_around,
)
from .display_model import DisplayModel
from .lighting import lighting_from
from .roaming import roaming_body
from .sight_line import SightLine
from .tracer import Tracer
from .viewed_simulation import ViewedSimulation
from .viewer_cfg import ViewerCfg
from .widening import WideningView

__all__ = ["SceneRenderer"]

_OTHER_SIDES = (0.0, 45.0, -45.0, 90.0, -90.0, 135.0, -135.0, 180.0)
"""Turns from the usual direction of a camera to others that are tried where walls hide what it looks at [deg]."""
_HIGHER = (0.0, 40.0, 65.0)
"""Elevations that are tried there [deg], each from all sides: over a wall one sees down, but not through a ceiling."""
_FROM_WALL = 0.05
"""Distance of a camera from the wall that it is moved in front of [m]."""
_NEAREST = 0.15
"""Least share of a camera's distance that it is moved to."""


class SceneRenderer:
    """Renders chosen environments of a simulation together in one picture.

    Attributes:
        env_ids: Environments that are shown.

    Args:
        sim: The simulation; its ``state`` is read at each :meth:`render`.
        cfg: Camera and picture.
        env_ids: Environments to show; default the one that ``cfg.env_index`` names and its neighbours.

    Raises:
        ConfigError: ``cfg`` has a problem.
        IndexError: An environment that the simulation does not have.
        ValueError: ``cfg.asset_name`` matches no body.
    """

    _widening: WideningView | None
    """View that moves back where a fixed robot reaches out of the picture; None for other cameras."""

    def __init__(self, sim: ViewedSimulation, cfg: ViewerCfg, env_ids: Sequence[int] | None = None):
        cfg.validate()
        is_gpu = wp.get_device(sim.device).is_cuda
        self._width, self._height = cfg.size_on(is_gpu)
        sizes = {"resolution": (self._width, self._height), "shadow_resolution": cfg.shadow_size_on(is_gpu)}
        self.cfg = self._traced = cfg = cfg.replace(**sizes)
        env_ids = _nearest(sim, cfg.env_index, cfg.num_shown) if env_ids is None else [int(i) for i in env_ids]
        self.env_ids = env_ids
        # Warp's current device is global: several simulations may use different ones.
        with wp.ScopedDevice(sim.device):
            self._eye, self._target = np.zeros(3), np.zeros(3)
            self._make_scene = lambda: DisplayModel(
                sim, env_ids, cfg.floor, cfg.recolor, cfg.natural, horizon=cfg.horizon
            )
            self._scene = self._make_scene()
            self._setup_camera(sim, env_ids)
            self._seen_from = self._eye, self._target
            # Not of this camera: a sun that the scene lacks shines the same in all pictures and camera sensors.
            self._lighting = lighting_from(sim.lights, azimuth=USUAL_AZIMUTH)
            self._open_tracer: Tracer | None = Tracer(self._scene, cfg, self._lighting)

    @property
    def _tracer(self) -> Tracer:
        if self._open_tracer is None:
            raise RuntimeError("SceneRenderer: the renderer is closed; make a new one")
        return self._open_tracer

    def distances(self, origins: np.ndarray, directions: np.ndarray, limit: float) -> np.ndarray:
        """Distance to the scenery from each origin (n, 3) along each unit direction (m, 3), shape (n, m) [m].

        Only ``natural`` scenery counts, not robots. Where there is none, the distance is ``limit`` [m].
        """
        tracer = self._tracer.scenery
        if tracer is None:
            return np.full((len(origins), len(directions)), limit)
        return tracer.distances(origins, directions, limit)

    @property
    def eye(self) -> np.ndarray:
        """Camera position [m], world frame, shape (3,), before it moves with the robots that it follows."""
        return self._eye.copy()

    @property
    def target(self) -> np.ndarray:
        """Point in the middle of the picture [m], world frame, shape (3,), before it moves with the robots."""
        return self._target.copy()

    def look(
        self, eye: Sequence[float], target: Sequence[float], follow: bool = False, fov: float | None = None
    ) -> None:
        """Put the camera at ``eye`` and look at ``target`` [m], world frame.

        Args:
            eye: Camera position.
            target: Point in the middle of the picture.
            follow: Move with the robots from now on; otherwise the camera stands still.
            fov: Vertical field of view [deg]. None: unchanged.
        """
        if fov is not None:
            self._tracer.set_fov(fov)
            self._traced = self._traced.replace(fov=fov)
        camera_axes(np.asarray(eye, dtype=float), np.asarray(target, dtype=float))  # raises if they are one point
        self._eye, self._target = np.array(eye, dtype=float), np.array(target, dtype=float)
        self._is_close_up, self._walls, self._widening = False, SightLine(), None
        self._follow(self._movable if follow else self._movable[:0])

    def render(self) -> np.ndarray:
        """Render the current state of the simulation: sRGB, uint8, shape (height, width, 3).

        Raises:
            RuntimeError: the renderer is closed.
        """
        tracer = self._tracer
        with wp.ScopedDevice(self._scene.model.device):
            if not self._scene.has_all_markers():
                self._scene = self._make_scene()
                tracer = self._open_tracer = Tracer(self._scene, self._traced, self._lighting)
            poses = self._scene.update()
            # Copies of eye and target move, so that look() and the properties stay what was set.
            shift = self._shift(poses)
            eye, target = self._eye + shift, self._target + shift
            if self._widening is not None:
                eye, target = self._widening.show(self._scene.bounds())
            if self._turns:
                eye, target = self._behind(poses[self._follow_bodies[0]], eye, target, self._rest + shift)
            elif not self._walls.is_free:
                eye = self._in_front_of_walls(eye, target)
            self._seen_from = eye, target
            return tracer.render(eye, target, self._shadow_region(poses, shift, eye, target))

    def project(self, points: np.ndarray) -> np.ndarray:
        """Where the last picture shows points.

        Args:
            points: World frame, shape ``(n, 3)`` [m].

        Returns:
            Column and row from the upper left corner, shape ``(n, 2)`` [px]; NaN for points behind the camera.
        """
        eye, target = self._seen_from
        seen = (np.asarray(points, dtype=float) - eye) @ camera_axes(eye, target)
        scale = 0.5 * self._height / math.tan(0.5 * math.radians(self._traced.fov))
        depth = np.where(seen[:, 2] < -1.0e-6, -seen[:, 2], np.nan)
        middle = 0.5 * np.array([self._width, self._height])
        return middle + scale * seen[:, :2] / depth[:, None] * (1.0, -1.0)

    def close(self) -> None:
        """Release the memory of the renderer. A second call does nothing."""
        self._open_tracer = None

    def _setup_camera(self, sim: ViewedSimulation, env_ids: Sequence[int]) -> None:
        """Set eye, target and what they follow, automatically or as the config says."""
        cfg, scene, self._is_close_up = self.cfg, self._scene, False
        self._walls = SightLine()
        self._widening = None
        points = scene.bounds()
        middle = points.mean(axis=0) if len(points) else np.zeros(3)
        self._radius = float(np.linalg.norm(points - middle, axis=1).max(initial=0.0)) or 1.0
        self._center, self._spread = middle, 0.0
        body = roaming_body(sim.template)
        self._movable = np.array([] if body is None else [root + body for root in scene.roots], dtype=int)
        if cfg.eye is None or cfg.aim is None:
            aspect = self._width / self._height
            azimuth = good_azimuth(points) if cfg.azimuth is None else math.radians(cfg.azimuth)
            moves = sim.template.body_count > 0
            elevation = good_elevation(points, moves) if cfg.elevation is None else math.radians(cfg.elevation)
            fov = math.radians(cfg.fov)
            followed = self._movable if cfg.follow else self._movable[:0]
            walls = scene.sight_line() if len(followed) else SightLine()
            # In a room the usual direction may be that of the wall beside the robot.
            free_choice = cfg.azimuth is None and not walls.is_free
            turns, higher = (_OTHER_SIDES, _HIGHER) if free_choice else ((0.0,), (0.0,))
            views = [
                frame_points(
                    points, azimuth + math.radians(turn), max(elevation, math.radians(up)), fov, aspect, cfg.margin
                )
                for up in higher
                for turn in turns
            ]
            self._follow(followed)
            self._look_past(walls, views)
            if cfg.follow and not len(self._movable) and scene.body_count and len(points):
                view = (azimuth, elevation, fov, aspect, cfg.margin)
                self._widening = WideningView(points, view, cfg.follow_time)
            return
        origin, followed = np.zeros(3), self._movable[:0]
        if cfg.origin_type != "world":
            first = env_ids[0] if cfg.env_index not in env_ids else cfg.env_index
            # A terrain's curriculum moves the origins after the environments were built.
            now = sim.env_origins if sim.env_origin is None else sim.env_origin.numpy()
            origin = np.asarray(now[first], dtype=float)
        if cfg.origin_type.startswith("asset_"):
            copy = list(env_ids).index(cfg.env_index) if cfg.env_index in env_ids else 0
            body = scene.roots[copy] + _root_body(sim.template, cfg.asset_name)
            followed = np.array([body])
            origin = scene.body_q[body, :3].astype(float)
        self._eye, self._target = origin + np.asarray(cfg.eye), origin + np.asarray(cfg.aim)
        self._follow(followed)
        self._turns = cfg.origin_type == "asset_heading"
        self._is_close_up = len(env_ids) > 1 and cfg.origin_type.startswith("asset_")
        if cfg.origin_type == "asset_root":
            self._look_past(scene.sight_line(), views_around(self._eye, self._target, _OTHER_SIDES, _HIGHER))

    def _look_past(self, walls: SightLine, views: Sequence[tuple[np.ndarray, np.ndarray]]) -> None:
        """Look from the first of some views, pairs of eye and target, from which walls hide the least."""
        self._walls, self._views = walls, list(views)
        self._choose_view(np.zeros(3))

    def _choose_view(self, shift: np.ndarray) -> None:
        """Choose among the views again, where the camera has moved by ``shift``."""
        if self._walls.is_free:
            self._eye, self._target = self._views[0]
            return
        self._eye, self._target = min(
            self._views, key=lambda view: self._walls.blocked_until(view[0] + shift, view[1] + shift)
        )

    def _follow(self, bodies: np.ndarray) -> None:
        """Move the camera with the mean position of ``bodies`` from now on, indices into the display state."""
        self._follow_bodies, self._turns = bodies, False
        # Turning is smoothed more than moving: the whole picture swings with it. No jump counts as a new episode.
        self._heading, self._near = Follower(4.0 * self.cfg.follow_time, jump=1.0e9), 1.0
        self._turned = 0.0
        # A robot that moves farther than its own size within a frame was reset.
        # Slower in height: a camera that sinks with a robot would hide that it falls.
        times = self.cfg.follow_time * np.array([1.0, 1.0, 4.0])
        self._jump = max(self._radius, 0.5)
        self._follower = Follower(times, jump=self._jump)
        at = self._scene.body_q[bodies, :3].astype(float) if len(bodies) else np.zeros((1, 3))
        self._rest = self._followed_at = np.nan_to_num(at.mean(axis=0))

    def _shift(self, poses: np.ndarray) -> np.ndarray:
        """Displacement of the camera with the bodies that it follows since it was set up, shape (3,)."""
        if len(self._follow_bodies) == 0:
            return np.zeros(3)
        at = poses[self._follow_bodies, :3].astype(float)
        at = at[np.isfinite(at).all(axis=1)]  # a diverged world does not take the others' camera with it
        if len(at) == 0:
            return np.zeros(3)
        middle = at.mean(axis=0)
        if not self._walls.is_free and np.linalg.norm(middle - self._followed_at) > self._jump:
            self._choose_view(middle - self._rest)  # a new episode begins elsewhere, beside other walls
        self._followed_at = middle
        return self._follower.follow(middle) - self._rest

    def _behind(
        self, pose: np.ndarray, eye: np.ndarray, target: np.ndarray, about: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Eye and target turned with the body about a point, with the eye in front of scenery that hides the body."""
        x, y, z, w = (float(q) for q in pose[3:7])
        yaw = math.atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
        if math.isfinite(yaw):
            # An angle that goes on beyond pi: the filter must not see a jump to -pi.
            self._turned += math.remainder(yaw - self._turned, 2.0 * math.pi)
        angle = float(self._heading.follow(np.array([self._turned, 0.0, 0.0]))[0])
        c, s = math.cos(angle), math.sin(angle)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        eye, target = about + turn @ (eye - about), about + turn @ (target - about)
        away = eye - about
        length = float(np.linalg.norm(away))
        free = float(self.distances(about[None], away[None] / length, length + 0.3)[0, 0]) - 0.3
        return about + self._calm(min(max((free + self.cfg.near) / length, 0.4), 1.0)) * away, target

    def _in_front_of_walls(self, eye: np.ndarray, target: np.ndarray) -> np.ndarray:
        """The eye, moved towards its target where a wall hides that."""
        away = eye - target
        length = float(np.linalg.norm(away))
        blocked = self._walls.blocked_until(eye, target)
        share = max((length - blocked - _FROM_WALL) / length, _NEAREST) if blocked else 1.0
        return target + self._calm(share) * away

    def _calm(self, share: float) -> float:
        """Share of the camera's distance in this frame.

        In at once, so that no frame shows the inside of a trunk; back slowly, so that the picture stays calm.
        """
        self._near = share if share < self._near else min(share, self._near + 0.02)
        return self._near

    def _shadow_region(
        self, poses: np.ndarray, shift: np.ndarray, eye: np.ndarray, target: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Centre and radius [m] of the ball in which shadows are cast.

        The radius grows in steps: each change moves the texels of the shadow map and makes edges of shadows flicker.
        """
        if self._is_close_up:
            # Shadows of all robots that are shown would leave too few texels for the one in the middle.
            reach = float(np.linalg.norm(eye - target))
            return target, 1.1 * max(reach, 1.0)
        center = self._center + shift
        if len(poses):
            far = np.linalg.norm(poses[:, :3] - center, axis=1)
            far = far[np.isfinite(far)]
            self._spread = max(self._spread, self._radius)
            limit = 4.0 * self._radius
            # Bounded: one robot that falls off the world must not blur the shadows of all.
            while len(far) and self._spread < min(float(far.max()), limit):
                self._spread *= 1.25
        return center, 1.1 * max(self._spread, self._radius)


def _nearest(sim: ViewedSimulation, index: int, count: int) -> list[int]:
    """An environment and those whose origins are nearest to its own, as many as there are up to ``count``."""
    if not 0 <= index < sim.num_envs:
        return [index]  # refused where it is drawn
    away = np.linalg.norm(sim.env_origins - sim.env_origins[index], axis=1)
    away[index] = -1.0
    return [int(i) for i in np.argsort(away, kind="stable")[:count]]


def _root_body(template: newton.ModelBuilder, asset_name: str | None) -> int:
    """Index of the first body of the template whose label has ``asset_name`` in its path, in any case."""
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
