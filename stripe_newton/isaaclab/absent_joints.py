# SPDX-License-Identifier: Apache-2.0
"""Absent joints: what a task's config says of joints that the robot in the place of NVIDIA's does not have.

Expressions that match such joints alone are left out, with one log line for each robot. Joints that only the other
robot has are driven like one that NVIDIA's has.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from stripe_newton.assets import ArticulationCfg
from stripe_newton.configclass import is_config
from stripe_newton.expressions import full_match
from stripe_newton.fusion import SceneEntityCfg
from stripe_newton.managers import ActionTermCfg

from .names.nucleus import Robot
from .nucleus import robot_for
from .stand_ins import StandIn

__all__ = ["leave_out_absent_joints"]

_log = logging.getLogger(__name__)


def leave_out_absent_joints(cfg: object, scene: object) -> None:
    """Leave out what an environment's config says of absent joints, in place.

    Args:
        cfg: Config of the environment.
        scene: Config of its scene, whose fields are assets.
    """
    for name, asset in vars(scene).items():
        robot = robot_for(asset.spawn) if isinstance(asset, ArticulationCfg) else None
        if robot is None or not robot.absent:
            continue
        choice = _Choice(robot)
        choice.clean_asset(asset)
        for part in _parts(cfg):
            if isinstance(part, SceneEntityCfg) and part.name == name:
                choice.clean_entity(part)
            elif isinstance(part, ActionTermCfg) and part.asset_name == name:
                choice.clean_fields(part)
        if choice.dropped:
            _log.warning("'%s' has no joints %s: they are left out", name, ", ".join(sorted(choice.dropped)))


def _parts(value: object) -> Iterator[object]:
    """All configs in a config."""
    if isinstance(value, Mapping):
        for item in value.values():
            yield from _parts(item)
    elif is_config(value) and not isinstance(value, StandIn):
        yield value
        for item in vars(value).values():
            yield from _parts(item)


class _Choice:
    """Chooses among the expressions of a config those that concern joints which the robot has."""

    def __init__(self, robot: Robot):
        self._robot = robot
        self.dropped: set[str] = set()

    def has(self, expression: str) -> bool:
        """Whether an expression matches a joint that is there, or none of NVIDIA's."""
        if any(_fits(expression, name) for name in self._robot.present):
            return True
        absent = any(_fits(expression, name) for name in self._robot.absent)
        self.dropped |= {expression} if absent else set()
        return not absent

    def clean_asset(self, cfg: ArticulationCfg) -> None:
        """Clean the initial state and the actuators, which get the joints that only the other robot has."""
        self.clean_fields(cfg.init_state)
        for group, actuator in list(cfg.actuators.items()):
            self._drive_more(actuator)
            self.clean_fields(actuator)
            if not actuator.joint_names_expr:
                del cfg.actuators[group]

    def clean_fields(self, cfg: object) -> None:
        """Clean the fields of a config that are expressions, or dicts by expression."""
        for name, value in vars(cfg).items():
            if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
                setattr(cfg, name, {key: number for key, number in value.items() if self.has(key)})
            elif name in ("joint_names", "joint_names_expr") and isinstance(value, (list, tuple)):
                setattr(cfg, name, [key for key in value if self.has(key)])

    def clean_entity(self, cfg: SceneEntityCfg) -> None:
        """Clean the joints that a term names; where none is left it has none."""
        names = cfg.joint_names
        if names is None:
            return
        kept = [key for key in ([names] if isinstance(names, str) else names) if self.has(key)]
        cfg.joint_names, cfg.joint_ids = (kept, cfg.joint_ids) if kept else (None, [])

    def _drive_more(self, actuator: Any) -> None:
        """Let an actuator drive the other robot's own joints, if it drives the one that they are like."""
        for own, like in self._robot.driven_like.items():
            if not _matches(actuator.joint_names_expr, like):
                continue
            actuator.joint_names_expr = [*actuator.joint_names_expr, own]
            for name, value in vars(actuator).items():
                if isinstance(value, Mapping):
                    numbers = [number for key, number in value.items() if _fits(key, like)]
                    setattr(actuator, name, {**value, own: numbers[0]} if numbers else value)


def _matches(expressions: Sequence[str], name: str) -> bool:
    return any(_fits(expression, name) for expression in expressions)


def _fits(expression: str, name: str) -> bool:
    try:
        return full_match(expression, name) is not None
    except re.error:  # which the scene reports when it looks for its joints
        return False
