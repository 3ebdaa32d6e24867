# SPDX-License-Identifier: Apache-2.0
"""Configs of terms in the Isaac Lab dialect: those of the package with Isaac Lab's other fields."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from stripe_newton import managers as native
from stripe_newton.configclass import MISSING, configclass

__all__ = ["ActionTermCfg", "CommandTermCfg", "ManagerTermBaseCfg", "ObservationTermCfg", "RecorderManagerBaseCfg"]

_NOT_DRAWN = {"debug_vis": "actions and commands are not drawn"}


@configclass
class ManagerTermBaseCfg:
    """A function and its parameters."""

    func: Callable[..., object] = MISSING
    params: dict[str, Any] = {}


@configclass
class ObservationTermCfg(native.ObservationTermCfg):
    """:class:`stripe_newton.managers.ObservationTermCfg`; without modifiers the field is None."""

    modifiers: Sequence[native.ModifierCfg] | None = None


@configclass
class ActionTermCfg(native.ActionTermCfg):
    """Base of configs of a user's action terms."""

    class_type: type | None = MISSING
    asset_name: str = MISSING
    debug_vis: bool = False
    clip: dict[str, tuple[float, float]] | None = None

    IGNORED: ClassVar[dict[str, str]] = _NOT_DRAWN


@configclass
class CommandTermCfg(native.CommandTermCfg):
    """Base of configs of a user's command terms."""

    scalar_first: ClassVar[bool] = True
    """Poses of seven numbers have quaternions (w, x, y, z)."""
    class_type: type | None = MISSING

    IGNORED: ClassVar[dict[str, str]] = _NOT_DRAWN


@configclass
class RecorderManagerBaseCfg(native.RecorderManagerBaseCfg):
    """:class:`stripe_newton.managers.RecorderManagerBaseCfg`; states in files are (w, x, y, z)."""

    quaternion_order: str = "wxyz"
