# SPDX-License-Identifier: Apache-2.0
"""Config watch: numbers that users change in the configs of running terms take effect."""

from __future__ import annotations

from collections.abc import Iterator

import torch

from stripe_newton.configclass import is_config
from stripe_newton.fusion import Parameters

__all__ = ["ConfigWatch"]

Value = float | tuple[float, ...]


class ConfigWatch:
    """Configs of terms of kernels that a user may change in place, as a curriculum in torch does::

        env.command_manager.get_term("base_velocity").cfg.ranges.lin_vel_x = (-2.0, 2.0)

    A config is compared with what it was once it has been handed out: at the start of a step, and after each torch
    term that may change one.
    """

    def __init__(self, parameters: Parameters):
        self._parameters = parameters
        self._configs: dict[str, tuple[object, dict[str, Value]]] = {}
        self._handed_out: set[str] = set()

    def add(self, path: str, cfg: object) -> None:
        """Watch the config of a term, whose numbers are parameters below ``path``."""
        self._configs[path] = cfg, dict(_numbers(cfg))

    def hand_out(self, path: str) -> None:
        """Note that a user has got a config."""
        self._handed_out.add(path)

    def take(self) -> None:
        """Take the numbers that have changed.

        Raises:
            ValueError: for a number that is no parameter, and so cannot change while the environment runs.
        """
        for path in self._handed_out:
            cfg, before = self._configs[path]
            for key, value in _numbers(cfg):
                if before.get(key) == value:
                    continue
                if f"{path}.{key}" not in self._parameters:
                    raise ValueError(f"{path}.{key}: cannot change while the environment runs")
                self._parameters[f"{path}.{key}"] = value
                before[key] = value


def _numbers(cfg: object) -> Iterator[tuple[str, Value]]:
    """Numbers of a config and of the configs in it, by path; fields that are ignored are left out."""
    for name, value in vars(cfg).items():
        if name in getattr(cfg, "IGNORED", ()):
            continue
        if is_config(value):
            yield from ((f"{name}.{key}", number) for key, number in _numbers(value))
            continue
        number = value.tolist() if isinstance(value, torch.Tensor) else value
        if isinstance(number, (bool, int, float)):
            yield name, number
        elif isinstance(number, (list, tuple)) and number and all(isinstance(v, (int, float)) for v in number):
            yield name, tuple(number)
