# SPDX-License-Identifier: Apache-2.0
"""Application of the Isaac Lab dialect: what scripts start before their imports, and the settings they read.

There is no application behind it: nothing has to be started, and no setting has an effect.
"""

from __future__ import annotations

import argparse
import logging
from collections.abc import Mapping
from types import SimpleNamespace

__all__ = ["AppLauncher", "SimulationApp", "get_settings", "log_error", "log_info", "log_warn", "settings"]

_log = logging.getLogger(__name__)


class SimulationApp:
    """Isaac Sim's application: it runs from its creation until :meth:`close`."""

    def __init__(self, launch_config: Mapping[str, object] | None = None, experience: str = ""):
        """Any configuration is taken, and has no effect."""
        self.config = dict(launch_config or {})
        self._running = True

    def is_running(self) -> bool:
        """Whether :meth:`close` has not been called."""
        return self._running

    def is_exiting(self) -> bool:
        """Whether :meth:`close` has been called."""
        return not self._running

    def update(self) -> None:
        """Nothing: there is no window whose events would have to be handled."""

    def close(self, wait_for_replicator: bool = True, skip_cleanup: bool = False) -> None:
        """End the application: :meth:`is_running` is false from now on."""
        self._running = False


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
        group.add_argument("--device", default="cuda:0", help="device of the simulation: cpu, cuda, cuda:N")
        group.add_argument("--verbose", action="store_true", help="has no effect")
        group.add_argument("--info", action="store_true", help="has no effect")
        group.add_argument("--experience", default="", help="has no effect")
        group.add_argument("--rendering_mode", choices=("performance", "balanced", "quality"), help="has no effect")
        group.add_argument("--kit_args", default="", help="has no effect")
        group.add_argument("--anim_recording_enabled", action="store_true", help="has no effect")


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
