# SPDX-License-Identifier: Apache-2.0
"""Configs whose quaternion is (w, x, y, z), as mix-ins for config classes of the package.

The field holds what the user wrote, so that copies, ``replace()``, ``to_dict()`` and YAML files agree with it. It is
converted where the package reads it, by :attr:`rot_xyzw`.
"""

from __future__ import annotations

from collections.abc import Iterator

__all__ = ["WxyzOptionalRot", "WxyzRot"]

Quaternion = tuple[float, float, float, float]


class _Wxyz:
    """A config that names the order of its ``rot`` in what it reports."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Those of the class of the package, which names the other order."""
        for field, text in super().problems():  # type: ignore[misc]  # of the config class that this is mixed into
            yield field, text.replace("(x, y, z, w)", "(w, x, y, z)") if field == "rot" else text


class WxyzRot(_Wxyz):
    """A config whose field ``rot`` is (w, x, y, z)."""

    rot: Quaternion

    @property
    def rot_xyzw(self) -> Quaternion:
        """The orientation as the package reads it, (x, y, z, w)."""
        w, x, y, z = self.rot
        return (x, y, z, w)


class WxyzOptionalRot(_Wxyz):
    """A config whose field ``rot`` is (w, x, y, z) or None."""

    rot: Quaternion | None

    @property
    def rot_xyzw(self) -> Quaternion | None:
        """The orientation as the package reads it, (x, y, z, w)."""
        if self.rot is None:
            return None
        w, x, y, z = self.rot
        return (x, y, z, w)
