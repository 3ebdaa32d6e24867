# SPDX-License-Identifier: Apache-2.0
"""Config classes with fields of every kind, for tests.

The ``from __future__`` line makes all annotations strings.
"""

from __future__ import annotations

import enum
import math
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar

import numpy as np

from stripe_newton.configclass import MISSING, configclass


class Shape(enum.Enum):
    BOX = 1
    BALL = 2


@configclass
class PartCfg:
    mass: float = 1.0
    size: tuple[float, float] = (1.0, 2.0)
    names: list[str] = ["a"]

    def problems(self):
        if not self.mass > 0:
            yield "mass", f"is {self.mass}, must be positive"


@configclass
class RobotCfg:
    path: str = MISSING
    part: PartCfg = PartCfg()
    parts: dict[str, PartCfg] = {"leg": PartCfg(), "arm": PartCfg(mass=2.0)}
    pair: tuple[PartCfg, PartCfg] = (PartCfg(), PartCfg(mass=3.0))
    optional: PartCfg | None = None
    func: Callable[[float], float] = math.sin
    class_type: type = dict
    other_func: Callable | None = None
    shape: Shape = Shape.BOX
    folder: Path = Path("a")
    eye: tuple[float, float, float] | None = None
    seed: int | None = None
    device: str = "cpu"
    enabled: bool = True
    gains: np.ndarray = np.array([1.0, 2.0])
    counter: ClassVar[int] = 7


@configclass
class PlainCfg:
    decimation = 2
    scale = 0.5
    nothing = None
    rows = [[1, 2], [3]]
    part = PartCfg(mass=4.0)
    square = lambda x: x * x  # noqa: E731
    func = math.cos
    kind = dict
    _private = [1]

    class Inner:
        pass

    def method(self):
        return self.decimation

    @property
    def double(self):
        return 2 * self.decimation

    @double.setter
    def double(self, value):
        self.decimation = value // 2


def robot() -> RobotCfg:
    return RobotCfg(path="robot.usd")
