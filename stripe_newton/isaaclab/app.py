# SPDX-License-Identifier: Apache-2.0
"""Application of the Isaac Lab dialect: what scripts start before their imports, and the settings they read.

There is no application behind it: nothing has to be started, and no setting has an effect. Scripts that run until their
window is closed end by the option ``--stop_after`` or the environment variable ``ISAACLAB_STOP_AFTER``, and draw a
picture of their last state with ``--picture`` or ``ISAACLAB_PICTURE``.
"""

from __future__ import annotations

import argparse
import logging
import os
from collections.abc import Mapping
from types import SimpleNamespace

import warp as wp

from .latest_simulation import latest_simulation

__all__ = [
    "AppLauncher",
    "SimulationApp",
    "get_settings",
    "log_error",
    "log_info",
    "log_warn",
    "save_picture",
    "settings",
]

_log = logging.getLogger(__name__)


STOP_AFTER, PICTURE = "ISAACLAB_STOP_AFTER", "ISAACLAB_PICTURE"
"""Environment variables: number of times that :meth:`SimulationApp.is_running` says yes, and the file of a picture."""


class SimulationApp:
    """Isaac Sim's application: it runs from its creation until :meth:`close`, or for a number of steps.

    Attributes:
        config: The configuration, of which ``stop_after`` and ``picture`` have an effect.
    """

    def __init__(self, launch_config: Mapping[str, object] | None = None, experience: str = ""):
        """Take the configuration."""
        self.config = dict(launch_config or {})
        self._running = True
        steps = self.config.get("stop_after") or os.environ.get(STOP_AFTER)
        self._steps_left = None if steps is None else int(str(steps))
        self._picture = self.config.get("picture") or os.environ.get(PICTURE)

    def is_running(self) -> bool:
        """Whether :meth:`close` has not been called; with a number of steps, whether fewer were begun.

        A loop asks this once a step. The picture is drawn where the answer is no for the first time.
        """
        if self._running and self._steps_left is not None:
            self._steps_left -= 1
            if self._steps_left < 0:
                self._end()
        return self._running

    def _end(self) -> None:
        self._running = False
        if self._picture:
            save_picture(str(self._picture))

    def is_exiting(self) -> bool:
        """Whether :meth:`close` has been called."""
        return not self._running

    def update(self) -> None:
        """Nothing: there is no window whose events would have to be handled."""

    def close(self, wait_for_replicator: bool = True, skip_cleanup: bool = False) -> None:
        """End the application: :meth:`is_running` is false from now on."""
        if self._running:
            self._end()


def save_picture(path: str) -> None:
    """Write a picture of the latest simulation, from the camera of ``sim.set_camera_view``.

    Raises:
        RuntimeError: there is no simulation.
    """
    sim = latest_simulation()
    if sim is None:
        raise RuntimeError(f"no picture '{path}': there is no simulation")
    # Viewers load when a picture is drawn: most scripts draw none.
    from stripe_newton.viewers import SceneRenderer, save_image

    renderer = SceneRenderer(sim, sim.camera, range(sim.num_envs))
    save_image(path, renderer.render())
    renderer.close()


class AppLauncher:
    """Isaac Lab's launcher, with the arguments that it adds to a script's parser."""

    def __init__(
        self, launcher_args: argparse.Namespace | Mapping[str, object] | None = None, **kwargs: object
    ) -> None:
        """Take the arguments of the command line; those of Isaac Sim's window have no effect."""
        given = vars(launcher_args) if isinstance(launcher_args, argparse.Namespace) else launcher_args
        self._app = SimulationApp({**(given or {}), **kwargs})

    @property
    def app(self) -> SimulationApp:
        """The application, which is running."""
        return self._app

    @staticmethod
    def add_app_launcher_args(parser: argparse.ArgumentParser) -> None:
        """Add Isaac Lab's options of the application to a parser. ``--device`` is the one that counts."""
        group = parser.add_argument_group("app_launcher arguments")
        group.add_argument("--headless", action="store_true", help="has no effect: nothing opens a window")
        group.add_argument("--livestream", type=int, default=-1, choices=(0, 1, 2), help="has no effect")
        group.add_argument("--enable_cameras", action="store_true", help="has no effect: cameras always work")
        group.add_argument("--xr", action="store_true", help="has no effect")
        group.add_argument("--device", default=_default_device(), help="device of the simulation: cpu, cuda, cuda:N")
        group.add_argument("--stop_after", type=int, help="number of steps after which the application ends")
        group.add_argument("--picture", help="file of a picture of the last state, .png")
        group.add_argument("--verbose", action="store_true", help="has no effect")
        group.add_argument("--info", action="store_true", help="has no effect")
        group.add_argument("--experience", default="", help="has no effect")
        group.add_argument("--rendering_mode", choices=("performance", "balanced", "quality"), help="has no effect")
        group.add_argument("--kit_args", default="", help="has no effect")
        group.add_argument("--anim_recording_enabled", action="store_true", help="has no effect")


def _default_device() -> str:
    return "cuda:0" if wp.get_cuda_device_count() else "cpu"


class _Settings:
    """Carbonite's settings: values that were set are remembered, all others are ``None``."""

    def __init__(self) -> None:
        self._values: dict[str, object] = {}

    def get(self, path: str) -> object:
        """The value that was set, or ``None``."""
        return self._values.get(path)

    get_as_bool = get_as_int = get_as_float = get_as_string = get

    def set(self, path: str, value: object) -> None:
        """Remember a value. It has no effect."""
        self._values[path] = value

    set_bool = set_int = set_float = set_string = set


_settings = _Settings()


def get_settings() -> _Settings:
    """The settings of this process."""
    return _settings


settings = SimpleNamespace(get_settings=get_settings)
"""The module ``carb.settings``."""


def log_info(message: str) -> None:
    """Log a message of level info."""
    _log.info(message)


def log_warn(message: str) -> None:
    """Log a warning."""
    _log.warning(message)


def log_error(message: str) -> None:
    """Log an error."""
    _log.error(message)
