# SPDX-License-Identifier: Apache-2.0
"""Camera control of the live view: frames an environment, follows its robot and turns with it."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import numpy as np

from stripe_newton.viewers.camera_framing import Follower, frame_points, good_azimuth, good_elevation
from stripe_newton.viewers.poses import yaw_of
from stripe_newton.viewers.roaming import roaming_body
from stripe_newton.viewers.viewed_simulation import ViewedSimulation
from stripe_newton.viewers.viewer_cfg import ViewerCfg

from .inbox import Inbox
from .live_scene import LiveScene
from .view_frame import WORLD, ViewFrame

if TYPE_CHECKING:
    import viser

__all__ = ["CameraControl"]

_ASPECT = 1.2
"""Width over height of the usual window beside its panels."""
_FPS = 30.0
_MOST_FRAMES = 60
_BETWEEN_LOOKS = 0.2
"""Time between two looks at what is in front of the camera [s]."""
_BEHIND_WALL = 0.05
"""Distance behind a wall from which a camera draws what is there [m]."""


class CameraControl:
    """Inputs for the camera, and the frame of the world in the scene.

    To follow a robot, the world is moved against it while the camera stays: so users turn and zoom as they like.

    Args:
        server: The web server.
        gui: Where the inputs go.
        inbox: Carries clicks to the simulation's thread.
        sim: The simulation.
        cfg: Camera of the first view.
    """

    def __init__(
        self, server: viser.ViserServer, gui: viser.GuiApi, inbox: Inbox, sim: ViewedSimulation, cfg: ViewerCfg
    ):
        self._server, self._sim, self._cfg = server, sim, cfg
        self._body = _followed_body(sim, cfg)
        by_config = cfg.origin_type.startswith("asset_") or (cfg.eye is None and cfg.follow)
        with gui.add_folder("Camera"):
            self.follow = gui.add_checkbox(
                "Follow", by_config and self._body is not None, visible=self._body is not None,
                hint="Move with the robot of the chosen environment",
            )  # fmt: skip
            self.turn = gui.add_checkbox(
                "Turn with it", cfg.origin_type == "asset_heading", visible=self._body is not None,
                hint="Keep the same side of the robot in view",
            )  # fmt: skip
            self.see_through = gui.add_checkbox(
                "See through", True, hint="Leave out walls between the camera and what it looks at"
            )
            self.fov = gui.add_slider("Field of view", 10, 100, 1, round(cfg.fov), hint="Vertical [deg]")
            self.frame_button = gui.add_button("Frame", icon="focus-centered", hint="Back to the first view")
        inbox.on_click(self.frame_button, self.frame)
        inbox.on_change(self.fov, lambda _: self._set_fov())
        self._root = server.scene.add_frame(WORLD, show_axes=False)
        self.view_frame = ViewFrame()
        """Where the world is in the scene."""
        self._yaw, self._last_picture = 0.0, time.monotonic()
        self._last_point: np.ndarray | None = None
        self._next_look = 0.0
        self._turner = Follower(4.0 * cfg.follow_time, jump=1.0e9)
        self._eye, self._target = np.array([3.0, -3.0, 2.0]), np.zeros(3)
        self.radius = 1.0
        """Size of the environment that was framed first [m]."""

    @property
    def azimuth(self) -> float:
        """Direction of the camera in the first view, about +Z from +X [rad]."""
        away = self._eye - self._target
        return math.atan2(away[1], away[0])

    @property
    def center(self) -> np.ndarray:
        """Point of the world that stands at the scene's origin [m], shape ``(3,)``."""
        return self.view_frame.center

    @property
    def fov_rad(self) -> float:
        """Vertical field of view [rad]."""
        return math.radians(float(self.fov.value))

    def to_scene(self, point: np.ndarray) -> np.ndarray:
        """A point of the world in the scene that browsers show [m], shape ``(3,)``; or points, ``(n, 3)``."""
        return self.view_frame.points(point)

    def to_world(self, point: np.ndarray) -> np.ndarray:
        """A point of the scene in the world [m], shape ``(3,)``; or points, ``(n, 3)``."""
        return self.view_frame.to_world(point)

    def look_at(self, scene: LiveScene, env_id: int) -> None:
        """Set the first view from an environment that the scene shows."""
        cfg, copy = self._cfg, scene.env_ids.index(env_id)
        points = scene.model.bounds(copy)
        middle = points.mean(axis=0) if len(points) else np.zeros(3)
        self.radius = float(np.linalg.norm(points - middle, axis=1).max(initial=0.0)) or 1.0
        self.see_through.visible = not scene.sight_line.is_free
        anchor = self._anchor(scene, env_id)
        self._start_following(anchor)
        if cfg.eye is not None and cfg.aim is not None:
            origin = np.zeros(3) if cfg.origin_type == "world" else self._origin(env_id)
            origin = anchor if cfg.origin_type.startswith("asset_") else origin
            eye, target = origin + np.asarray(cfg.eye), origin + np.asarray(cfg.aim)
        else:
            azimuth = good_azimuth(points) if cfg.azimuth is None else math.radians(cfg.azimuth)
            moves = len(scene.model.body_q) > 0
            elevation = good_elevation(points, moves) if cfg.elevation is None else math.radians(cfg.elevation)
            fov = math.radians(cfg.fov)
            eye, target = frame_points(points, azimuth, elevation, fov, _ASPECT, cfg.margin)
        self._eye, self._target = eye - anchor, target - anchor
        camera = self._server.initial_camera
        camera.position, camera.look_at = _triple(self._eye), _triple(self._target)
        camera.up, camera.fov = (0.0, 0.0, 1.0), math.radians(cfg.fov)
        camera.near, camera.far = self._near, 2000.0

    @property
    def _near(self) -> float:
        """Distance from which everything is drawn, where nothing is in between [m]."""
        return min(0.05, 0.05 * self.radius)

    def look_through(self, scene: LiveScene) -> None:
        """Leave out what is between each browser's camera and what it looks at, such as the wall of a room."""
        now = time.monotonic()
        if now < self._next_look:
            return
        self._next_look = now + _BETWEEN_LOOKS
        for client in self._server.get_clients().values():
            blocked = 0.0
            if self.see_through.value:
                eye, target = self.to_world(client.camera.position), self.to_world(client.camera.look_at)
                blocked = scene.sight_line.blocked_until(eye, target)
            client.camera.near = blocked + _BEHIND_WALL if blocked else self._near

    def frame(self) -> None:
        """Give all browsers the first view of the chosen environment, with the first field of view."""
        self.fov.value = round(self._cfg.fov)
        self._set_fov()
        for client in self._server.get_clients().values():
            with client.atomic():
                client.camera.position, client.camera.look_at = _triple(self._eye), _triple(self._target)
                client.camera.up_direction = (0.0, 0.0, 1.0)

    def jump(self, scene: LiveScene, env_id: int) -> None:
        """Go to another environment, at once."""
        self._start_following(self._anchor(scene, env_id))

    def update(self, scene: LiveScene, env_id: int, stands: bool = False) -> None:
        """Move the world for the present state; with ``stands``, leave the camera where it is in the world."""
        frames = self._frames()
        if stands:
            self._start_following(self.center)  # from there on, smoothly, when it ends
            return
        if self.follow.value:
            self._follow(self._anchor(scene, env_id), frames)
        yaw = self._heading(scene, env_id) if self.turn.value else 0.0
        if math.isfinite(yaw):  # an angle that goes on beyond pi: the filter must not see a jump to -pi
            self._yaw += math.remainder(yaw - self._yaw, 2.0 * math.pi)
        for _ in range(frames):
            self.view_frame.turn = -float(self._turner.follow(np.array([self._yaw, 0.0, 0.0]))[0])
        self._root.position, self._root.wxyz = self.view_frame.position, self.view_frame.wxyz

    def _frames(self) -> int:
        """Frames of a video since the last picture: the smoothing is in frames, pictures come as often as they can."""
        now = time.monotonic()
        last, self._last_picture = self._last_picture, now
        return min(max(round((now - last) * _FPS), 1), _MOST_FRAMES)

    def _follow(self, point: np.ndarray, frames: int) -> None:
        """Follow to a point, on a straight way in so many frames."""
        begin = point if self._last_point is None else self._last_point
        if float(np.linalg.norm(point - begin)) > max(self.radius, 0.5):  # a new episode
            self._start_following(point)
            begin = point
        self._last_point = point
        for share in np.linspace(0.0, 1.0, frames + 1)[1:]:
            self.view_frame.center = self._follower.follow(begin + share * (point - begin))

    def _start_following(self, point: np.ndarray) -> None:
        """Begin at a point."""
        self._follower, self._last_point = Follower(self._cfg.follow_time, jump=1.0e9), None
        self.view_frame.center = self._follower.follow(point)

    def _set_fov(self) -> None:
        self._server.initial_camera.fov = self.fov_rad
        for client in self._server.get_clients().values():
            client.camera.fov = self.fov_rad

    def _heading(self, scene: LiveScene, env_id: int) -> float:
        root = scene.root_of(env_id)
        return 0.0 if root is None or self._body is None else yaw_of(scene.body_q[root + self._body, 3:])

    def _origin(self, env_id: int) -> np.ndarray:
        """Where an environment starts now [m]: a terrain's curriculum moves the origins."""
        now = self._sim.env_origins if self._sim.env_origin is None else self._sim.env_origin.numpy()
        return np.asarray(now[env_id], dtype=float)

    def _anchor(self, scene: LiveScene, env_id: int) -> np.ndarray:
        """The robot that is followed, or the origin of an environment without one."""
        root = scene.root_of(env_id)
        if root is None or self._body is None:
            return self._origin(env_id)
        at = scene.body_q[root + self._body, :3].astype(float)
        return at if np.isfinite(at).all() else self.center


def _followed_body(sim: ViewedSimulation, cfg: ViewerCfg) -> int | None:
    """Body that the camera can follow: that of ``cfg.asset_name``, else the first that may go anywhere."""
    labels = [str(label).lower().split("/") for label in sim.template.body_label]
    if cfg.asset_name is not None:
        found = [i for i, parts in enumerate(labels) if cfg.asset_name.lower() in parts]
        if found:
            return found[0]
    return roaming_body(sim.template)


def _triple(point: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in point)
    return x, y, z
