# SPDX-License-Identifier: Apache-2.0
"""Live viewer: a running simulation in the browser, by Newton's viser viewer."""

from __future__ import annotations

import importlib.util
import socket
from collections.abc import Sequence
from typing import TYPE_CHECKING
from urllib.parse import urlsplit

import warp as wp

from .display_model import DisplayModel
from .token_server import TokenServer
from .viewed_simulation import ViewedSimulation

if TYPE_CHECKING:
    from newton.viewer import ViewerViser

__all__ = ["LiveViewer"]

_LOOPBACK = ("127.0.0.1", "localhost", "::1")
"""Addresses that only this machine reaches."""


class LiveViewer:
    """Serves a view of chosen environments to a browser.

    Args:
        sim: The simulation; its ``state`` is read at each :meth:`update`.
        env_ids: Environments to show, each at its origin.
        port: Port of the web server; the next free one is taken if it is in use.
        host: Address that the server listens on; ``"0.0.0.0"`` also accepts other machines. Beyond this machine a
            browser needs the token that :attr:`url` has.

    Raises:
        ImportError: viser is not installed.
        OSError: This machine has no such address, or no port is free.
        IndexError: An environment that the simulation does not have.
    """

    def __init__(
        self, sim: ViewedSimulation, env_ids: Sequence[int] = (0,), *, port: int = 8080, host: str = "127.0.0.1"
    ):
        if importlib.util.find_spec("viser") is None:
            raise ImportError('the live viewer needs viser: pip install "stripe-newton[viser]"')
        from newton.viewer import ViewerViser  # needs viser, an optional dependency

        with wp.ScopedDevice(sim.device):
            self._make_scene = lambda: DisplayModel(sim, env_ids)
            self._scene = self._make_scene()
            # Always on the loopback interface: viser knows no tokens, and waits without end for a wrong address.
            own = {"host": _LOOPBACK[0], "label": "stripe-newton", "verbose": False}
            self._viewer: ViewerViser | None = ViewerViser(port=port, **own)
            self._viewer.set_model(self._scene.model)
            self._url = str(self._viewer.url)
        self._outside: TokenServer | None = None
        if host not in _LOOPBACK:
            try:
                self._outside = TokenServer(host, port, urlsplit(self._url).port or port)
            except BaseException:
                self.close()
                raise
            name = socket.gethostname() if host in ("", "0.0.0.0", "::") else host
            self._url = f"http://{name}:{self._outside.port}/?token={self._outside.token}"
        self._time = 0.0

    @property
    def url(self) -> str:
        """Address to open in a browser; with the token where other machines can reach it."""
        return self._url

    def is_running(self) -> bool:
        """Whether the viewer is still open."""
        return self._viewer is not None and bool(self._viewer.is_running())

    def update(self, dt: float = 1.0 / 60.0) -> None:
        """Show the simulation's current state.

        Args:
            dt: Simulated time since the last call [s].

        Raises:
            RuntimeError: The viewer is closed.
        """
        if self._viewer is None:
            raise RuntimeError("LiveViewer.update: the viewer is closed; make a new one")
        self._time += dt
        with wp.ScopedDevice(self._scene.model.device):
            if not self._scene.has_all_markers():
                self._scene = self._make_scene()
                self._viewer.set_model(self._scene.model)
            # The display model's state: the simulation's has all environments, the viewer some of them.
            self._scene.update()
            self._viewer.begin_frame(self._time)
            self._viewer.log_state(self._scene.state)
            self._viewer.end_frame()

    def close(self) -> None:
        """Stop the server. A second call does nothing."""
        if self._outside is not None:
            self._outside.close()
            self._outside = None
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    def __enter__(self) -> LiveViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
