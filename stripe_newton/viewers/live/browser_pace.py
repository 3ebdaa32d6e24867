# SPDX-License-Identifier: Apache-2.0
"""Browser pace: how many pictures a browser still has to draw, so that none queue up for a slow one."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import viser

__all__ = ["BrowserPace"]

_MOST_AHEAD = 2
"""Pictures that are on their way to the quickest browser: one that it draws, and the next."""
_MARKS = 4
"""Marks in turn; more than pictures can be on their way."""
_MARK = 2.5e-5
"""Relative difference of the fields of view of two marks: a hundredth of a pixel, and the least that viser sends."""
_PATIENCE_S = 2.0
"""Time after which a browser that does not answer gets another picture."""


class _Browser:
    """Pictures that were sent to a browser, and those that it has answered."""

    def __init__(self, client: viser.ClientHandle):
        self._client = client
        self.sent, self.answered = 0, 0
        self._base = float(client.camera.fov)
        client.camera.on_update(self._hear)

    @property
    def ahead(self) -> int:
        """Pictures that it has not answered."""
        return self.sent - self.answered

    def mark(self, fov: float) -> None:
        """Send a mark behind a picture: viser's browsers answer a new field of view when they draw."""
        self.sent += 1
        self._base = fov
        self._client.camera.fov = fov * (1.0 + _MARK * (self.sent % _MARKS))

    async def _hear(self, camera: viser.CameraHandle) -> None:
        """Take an answer; a coroutine, as viser calls plain functions in any order."""
        mark = (float(camera.fov) / self._base - 1.0) / _MARK
        if math.isfinite(mark) and -0.5 < mark < _MARKS - 0.5:
            behind = (self.sent - round(mark)) % _MARKS
            self.answered = max(self.answered, self.sent - behind)


class BrowserPace:
    """Holds pictures back until a browser has drawn those before.

    A browser without a graphics card draws a few pictures a second, and the way to it may be slow. Pictures that it
    cannot keep up with would wait in buffers, so that what it shows is late. Of several browsers the quickest counts.

    viser reports no pictures. So each one ends with a mark: the field of view, changed by much less than can be seen,
    which browsers report back.

    Args:
        server: The web server.
    """

    def __init__(self, server: viser.ViserServer):
        self._server = server
        self._browsers: dict[int, _Browser] = {}
        self._last = -math.inf

    def is_ready(self) -> bool:
        """Whether a browser waits for a picture, or none has answered for some time."""
        self._meet()
        ahead = [browser.ahead for browser in self._browsers.values()]
        return min(ahead, default=0) < _MOST_AHEAD or time.monotonic() > self._last + _PATIENCE_S

    def count_picture(self, fov: float) -> None:
        """Note that a picture was sent.

        Args:
            fov: The vertical field of view [rad].
        """
        self._last = time.monotonic()
        self._meet()
        for browser in self._browsers.values():
            browser.mark(fov)

    def _meet(self) -> None:
        """Learn who came and who left."""
        clients = self._server.get_clients()
        self._browsers = {
            key: self._browsers.get(key) or _Browser(client)
            for key, client in clients.items()
        }  # fmt: skip
