# SPDX-License-Identifier: Apache-2.0
"""Pace of the live view: poses in the scene that browsers show, and pictures that wait for slow browsers."""

from __future__ import annotations

import asyncio
import types

import numpy as np
import pytest

from stripe_newton.viewers.live import browser_pace
from stripe_newton.viewers.live.browser_pace import BrowserPace
from stripe_newton.viewers.live.view_frame import ViewFrame


def test_poses_points_and_vectors_of_the_world_are_turned_and_moved_alike():
    rotations = pytest.importorskip("scipy.spatial.transform").Rotation
    random = np.random.default_rng(0)
    frame = ViewFrame()
    frame.center, frame.turn = np.array([30.0, -4.0, 1.0]), 0.7
    turn = rotations.from_euler("z", frame.turn)
    points, quaternions = random.normal(size=(5, 3)), rotations.random(5, random_state=1)
    poses = frame.poses(np.column_stack([points, quaternions.as_quat()]))
    moved = turn.apply(points - frame.center)
    np.testing.assert_allclose(poses[:, :3], moved, atol=1e-12)
    np.testing.assert_allclose(
        (turn * quaternions).as_matrix(), rotations.from_quat(poses[:, 3:]).as_matrix(), atol=1e-12
    )
    np.testing.assert_allclose(frame.points(points), moved, atol=1e-12)
    np.testing.assert_allclose(frame.ways(points), turn.apply(points), atol=1e-12)
    np.testing.assert_allclose(frame.to_world(moved), points, atol=1e-12)


class Camera:
    """A camera as viser has it, whose browser answers when the test says so."""

    def __init__(self):
        self.fov, self._hear, self._sent = 0.8, [], []

    def __setattr__(self, name, value):
        super().__setattr__(name, value)
        if name == "fov" and hasattr(self, "_sent"):
            self._sent.append(value)

    def on_update(self, callback):
        self._hear.append(callback)

    def draw(self):
        """Draw all that has come, as a browser does, and answer with the last field of view."""
        for callback in self._hear:
            asyncio.run(callback(types.SimpleNamespace(fov=self._sent[-1])))


class Server:
    """A server with browsers."""

    def __init__(self, *cameras):
        self.clients = {key: types.SimpleNamespace(camera=camera) for key, camera in enumerate(cameras)}

    def get_clients(self):
        return self.clients


def test_pictures_wait_for_the_quickest_browser(monkeypatch):
    now = 100.0
    monkeypatch.setattr(browser_pace.time, "monotonic", lambda: now)
    quick, slow = Camera(), Camera()
    server = Server(quick, slow)
    pace = BrowserPace(server)
    sent = 0
    for _ in range(20):
        while pace.is_ready():
            pace.count_picture(0.8)
            sent += 1
        quick.draw()
    assert sent == 40  # two on their way, and then as many as it draws
    server.clients.pop(0)  # the quick one leaves
    assert not pace.is_ready()
    slow.draw()
    assert pace.is_ready()
    assert all(abs(fov / 0.8 - 1.0) < 1e-4 for fov in slow._sent)  # nobody sees it
    pace.count_picture(0.8)
    pace.count_picture(0.8)
    assert not pace.is_ready()
    now += 3.0  # its tab is hidden: it gets a picture from time to time
    assert pace.is_ready()
    pace.count_picture(0.8)
    assert not pace.is_ready()


def test_a_new_field_of_view_is_no_answer(monkeypatch):
    monkeypatch.setattr(browser_pace.time, "monotonic", lambda: 0.0)
    camera = Camera()
    pace = BrowserPace(Server(camera))
    pace.count_picture(0.8)
    pace.count_picture(0.8)
    camera.fov = 1.1  # by the slider
    camera.draw()
    assert not pace.is_ready()
    pace.count_picture(1.1)
    camera.draw()
    assert pace.is_ready()
