# SPDX-License-Identifier: Apache-2.0
"""Fields of configs beyond those of the class: further ones by name, and those of a base or of another config."""

from __future__ import annotations

import copy
import dataclasses
import math
import operator
import pickle
from collections.abc import Callable
from typing import ClassVar

import numpy as np
import pytest

from stripe_newton.configclass import ConfigError, config_with, configclass
from stripe_newton.envs import mdp
from stripe_newton.managers import RewardTermCfg, TerminationTermCfg
from stripe_newton.value_types import PositiveFloat, PositiveInt


@configclass
class PartCfg:
    mass: float = 1.0

    def problems(self):
        if not self.mass > 0:
            yield "mass", f"is {self.mass}, must be positive"


@configclass
class BoxCfg:
    """Parts by name."""

    OPEN: ClassVar[tuple[type, ...]] = (PartCfg,)
    label: str = "box"


def test_an_open_config_takes_further_fields_of_its_kind():
    box = BoxCfg(leg=PartCfg(mass=2.0))
    box.arm = PartCfg(mass=3.0)
    assert [f.name for f in dataclasses.fields(box)] == ["label", "leg", "arm"]
    assert box.to_dict()["arm"]["mass"] == 3.0
    box.from_dict({"arm": {"mass": 4.0}})
    assert (box.arm.mass, type(box).__name__, isinstance(box, BoxCfg)) == (4.0, "BoxCfg", True)
    assert [f.name for f in dataclasses.fields(BoxCfg())] == ["label"]  # others are not affected
    bad = box.replace(head=PartCfg(mass=-1.0))
    with pytest.raises(ConfigError, match=r"head\.mass: is -1"):
        bad.validate()
    assert BoxCfg(leg=PartCfg()) == BoxCfg(leg=PartCfg()) != BoxCfg(leg=PartCfg(mass=9.0))
    for wrong in (lambda: BoxCfg(hand=1), lambda: setattr(box, "lable", "x")):
        with pytest.raises(TypeError, match=r"BoxCfg has no field '.*; a new field must be PartCfg, is "):
            wrong()


@configclass
class GroupCfg:
    """A plain group of terms, as Isaac Lab's files have it."""

    alive: RewardTermCfg = RewardTermCfg(func=mdp.is_alive, weight=1.0)


def test_a_group_of_terms_takes_further_terms_of_its_kind():
    group = GroupCfg()
    group.upright = RewardTermCfg(func=mdp.flat_orientation_l2, weight=-1.0)
    assert [f.name for f in dataclasses.fields(group)] == ["alive", "upright"]
    assert group.copy() == group
    with pytest.raises(AttributeError, match="GroupCfg has no field 'alife'; did you mean 'alive'"):
        group.alife = 2.0
    with pytest.raises(AttributeError, match="GroupCfg has no field 'fallen'"):
        group.fallen = TerminationTermCfg(func=mdp.time_out)


@pytest.mark.parametrize("duplicate", [copy.deepcopy, BoxCfg.copy, lambda c: pickle.loads(pickle.dumps(c))])
def test_copies_keep_further_fields(duplicate):
    box = BoxCfg(leg=PartCfg(mass=2.0))
    other = duplicate(box)
    assert other == box
    assert type(other) is type(box)
    other.leg.mass = 5.0
    assert box.leg.mass == 2.0


def test_config_with_gives_any_config_further_fields():
    with_tail = config_with(PartCfg(), {"tail": PartCfg(mass=0.5), "seed": 3})
    assert (with_tail.tail.mass, with_tail.seed) == (0.5, 3)
    assert not hasattr(PartCfg(), "tail")
    assert pickle.loads(pickle.dumps(with_tail)).tail.mass == 0.5


def test_the_range_of_a_base_holds_in_subclasses_that_name_the_bare_type():
    @configclass
    class Steps:
        number: PositiveInt = 1
        scale: float = 1.0

    @configclass
    class Long(Steps):
        number: int = 4
        scale: PositiveFloat = 1.0

    @configclass
    class Longer(Long):
        number = 8

    for cls in (Long, Longer):
        with pytest.raises(ConfigError, match=r"number: is 0, must be a whole number of at least 1"):
            cls(number=0).validate()
        with pytest.raises(ConfigError, match=r"scale: is 0\.0, must be a number above 0"):
            cls(scale=0.0).validate()
        cls(number=2, scale=0.5).validate()


def test_a_config_of_the_same_kind_may_take_the_place_of_another():
    @configclass
    class Actions:
        joint: mdp.JointEffortActionCfg = mdp.JointEffortActionCfg(asset_name="robot", joint_names=[".*"])

    cfg = Actions(joint=mdp.JointPositionActionCfg(asset_name="robot", joint_names=[".*"]))
    cfg.validate()
    cfg.joint = RewardTermCfg(func=len, weight=1.0)
    with pytest.raises(ConfigError, match=r"joint: is RewardTermCfg.*must be a JointEffortActionCfg"):
        cfg.validate()


class Held:
    """An object whose ``repr`` tells only where it lies in memory."""

    def __init__(self, numbers: list[float]):
        self.numbers, self.table = numbers, np.ones(3)


@configclass
class HolderCfg:
    """A config that holds such an object."""

    held: Held | None = None


def test_an_object_is_written_as_its_class_and_a_checksum_of_what_it_holds():
    """Else a run would say that its task has changed each time it is loaded."""
    one, same, other = (HolderCfg(held=Held(x)).to_dict() for x in ([1.0, 2.0], [1.0, 2.0], [1.0, 2.5]))
    assert one == same != other
    assert one["held"].startswith(f"{__name__}.Held, checksum ")
    cfg = HolderCfg(held=Held([1.0, 2.0]))
    held = cfg.held
    cfg.from_dict(one)
    assert cfg.held is held


def test_a_function_takes_as_many_arguments_as_its_annotation_says():
    @configclass
    class Calls:
        law: Callable[[int, int], float] = max
        anything: Callable[..., float] = max

    class Law:
        def __init__(self, first: int, second: int, third: int = 0):
            pass

    for law in (Law, lambda *args: 0.0, math.pow, operator.add, dict.get):
        Calls(law=law, anything=float).validate()
    for law in (float, math.sin, lambda a, *, b: 0.0, lambda: 0.0):
        with pytest.raises(ConfigError, match=r"law: is .*, must be a function or class of 2 arguments"):
            Calls(law=law).validate()
