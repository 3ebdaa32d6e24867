# SPDX-License-Identifier: Apache-2.0
"""Configs whose quaternion is (w, x, y, z), as mix-ins for config classes of the package.

The field holds what the user wrote, so that copies, ``replace()``, ``to_dict()`` and YAML files agree with it. It is
converted where the package reads it, by :attr:`rot_xyzw`.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from functools import cache

import numpy as np
import torch

__all__ = ["WxyzOptionalRot", "WxyzRot"]

Quaternion = tuple[float, float, float, float]

_log = logging.getLogger(__name__)


def _unit(rot: Sequence[float]) -> Quaternion:
    """(x, y, z, w) of unit length for (w, x, y, z) of any length but 0, as PhysX takes it."""
    norm = sum(x * x for x in rot) ** 0.5
    if not 0.99 < norm < 1.01 and norm > 0.0:
        _say(tuple(rot))
        rot = [value / norm for value in rot]
    w, x, y, z = rot
    return (x, y, z, w)


@cache
def _say(rot: tuple[float, ...]) -> None:
    _log.warning("rot=%s is no unit quaternion: it is scaled to one, as Isaac Lab's simulator does", rot)


class _Wxyz:
    """A config that names the order of its ``rot`` in what it reports."""

    rot: Quaternion | None

    def __post_init__(self) -> None:
        """Take positions and velocities that are arrays as the numbers in them."""
        for name in ("pos", "rot", "lin_vel", "ang_vel"):
            value = getattr(self, name, None)
            if isinstance(value, (np.ndarray, torch.Tensor)):
                setattr(self, name, tuple(value.tolist()))

    def problems(self) -> Iterator[tuple[str, str]]:
        """Those of the class of the package, which names the other order."""
        for field, text in super().problems():  # type: ignore[misc]  # of the config class that this is mixed into
            if field != "rot":
                yield field, text
            elif not any(self.rot or ()):  # what is not of unit length is scaled
                yield field, text.replace("(x, y, z, w)", "(w, x, y, z)")


class WxyzRot(_Wxyz):
    """A config whose field ``rot`` is (w, x, y, z)."""

    rot: Quaternion

    @property
    def rot_xyzw(self) -> Quaternion:
        """The orientation as the package reads it, (x, y, z, w)."""
        return _unit(self.rot)


class WxyzOptionalRot(_Wxyz):
    """A config whose field ``rot`` is (w, x, y, z) or None."""

    rot: Quaternion | None

    @property
    def rot_xyzw(self) -> Quaternion | None:
        """The orientation as the package reads it, (x, y, z, w)."""
        if self.rot is None:
            return None
        return _unit(self.rot)
