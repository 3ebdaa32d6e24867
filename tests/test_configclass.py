# SPDX-License-Identifier: Apache-2.0
"""Config classes: fields, copies, inheritance, and what validation says."""

from __future__ import annotations

import copy
import dataclasses
import math
import pickle
import warnings
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from stripe_newton.configclass import MISSING, ConfigError, configclass, is_config, resolve_name
from tests.helpers.config_examples import PartCfg, PlainCfg, RobotCfg, robot


def test_mutable_defaults_are_copied_at_every_depth():
    a, b = robot(), robot()
    a.part.names.append("b")
    a.parts["leg"].mass = 9.0
    a.pair[0].names.append("c")
    a.gains[0] = 5.0
    assert b.part.names == ["a"]
    assert b.parts["leg"].mass == 1.0
    assert b.pair[0].names == ["a"]
    assert b.gains[0] == 1.0
    assert robot().part.names == ["a"]
    p, q = PlainCfg(), PlainCfg()
    p.rows[0].append(3)
    p.part.mass = 0.0
    assert q.rows == [[1, 2], [3]]
    assert q.part.mass == 4.0


def test_attributes_without_annotation_are_fields():
    names = [f.name for f in dataclasses.fields(PlainCfg)]
    assert names == ["decimation", "scale", "nothing", "rows", "part", "square", "func", "kind"]
    cfg = PlainCfg(decimation=4, nothing="x")
    assert (cfg.decimation, cfg.nothing, cfg.method(), cfg.double) == (4, "x", 4, 8)
    assert cfg.square(3) == 9  # functions are values, not bound methods
    assert cfg.func is math.cos
    assert cfg.kind is dict
    cfg.double = 20
    assert cfg.decimation == 10


def test_class_variables_are_no_fields():
    assert RobotCfg.counter == 7
    assert "counter" not in robot().to_dict()


def test_inheritance():
    @configclass
    class Base:
        steps: int = 1
        items: list[int] = [1]
        part: PartCfg = PartCfg()
        rate: float = 0.5

    @configclass
    class Child(Base):
        steps = 5
        items = [2]
        part = PartCfg(mass=8.0)
        rate: float | None  # another type, the same default
        items_two: list[int] = [3]

    child = Child()
    assert (child.steps, child.items, child.part.mass, child.rate, child.items_two) == (5, [2], 8.0, 0.5, [3])
    assert Child.__dataclass_fields__["steps"].type == "int"
    child.items.append(0)
    child.items_two.append(0)
    assert (Child().items, Child().items_two, Base().items, Base().steps) == ([2], [3], [1], 1)

    @configclass
    class Mixin:
        extra: list[int] = [7]

    @configclass
    class Both(Child, Mixin):
        pass

    assert (Both().extra, Both().steps) == ([7], 5)


def test_reannotated_mutable_default_is_kept():
    @configclass
    class Child(PartCfg):
        names: tuple[str, ...] | list[str]

    child = Child()
    child.names.append("z")
    assert Child().names == ["a"]


def test_post_init_runs_and_can_call_up():
    @configclass
    class Derived(RobotCfg):
        path = "p"

        def __post_init__(self):
            super().__post_init__()
            self.part.mass = 6.0

    assert Derived().part.mass == 6.0
    assert Derived().replace(device="cuda:0").part.mass == 6.0


def test_post_init_of_a_later_base_runs():
    @configclass
    class Fields:
        device = "cuda:1"

    @configclass
    class Heavy(RobotCfg):
        def __post_init__(self):
            super().__post_init__()
            self.part.mass = 6.0

    @configclass
    class Both(Fields, Heavy):
        path = "p"

    assert (Both().device, Both().part.mass) == ("cuda:1", 6.0)


def test_field_objects_and_fields_without_default():
    @configclass
    class Cfg:
        first: int
        second: list = dataclasses.field(default_factory=lambda: [1])
        third: int

    cfg = Cfg()
    assert cfg.first is MISSING
    assert cfg.third is MISSING
    assert cfg.second == [1]
    assert Cfg(1, [], 3).third == 3


def test_nested_config_class():
    @configclass
    class Outer:
        @configclass
        class Group:
            size: int = 3

        group: Group = Group()

    assert [f.name for f in dataclasses.fields(Outer)] == ["group"]
    assert Outer().group.size == 3


def test_replace_and_copy_share_nothing():
    a = robot()
    b = a.replace(path="other.usd", part=a.part.replace(mass=5.0))
    c = a.copy()
    b.parts["leg"].mass = 0.0
    c.pair[1].names.append("x")
    b.gains[0] = -1.0
    assert (a.path, a.part.mass, a.parts["leg"].mass, a.pair[1].names, a.gains[0]) == (
        "robot.usd",
        1.0,
        1.0,
        ["a"],
        1.0,
    )
    assert (b.path, b.part.mass, b.func) == ("other.usd", 5.0, math.sin)
    assert type(c) is RobotCfg


@pytest.mark.parametrize("duplicate", [copy.copy, copy.deepcopy, lambda c: pickle.loads(pickle.dumps(c))])
def test_copies_of_the_standard_library(duplicate):
    cfg = RobotCfg(seed=3)
    new = duplicate(cfg)
    assert new.path is MISSING
    assert new.to_dict() == cfg.to_dict()
    assert is_config(new)
    with pytest.raises(AttributeError, match="did you mean 'seed'"):
        new.sed = 1
    if duplicate is not copy.copy:
        new.part.names.append("x")
        assert cfg.part.names == ["a"]


def test_unknown_names_are_refused_with_the_nearest():
    cfg = robot()
    with pytest.raises(AttributeError, match="RobotCfg has no field 'devise'; did you mean 'device'"):
        cfg.devise = "cpu"
    with pytest.raises(AttributeError, match="PartCfg has no field 'zzz'; it has mass, size, names"):
        cfg.part.zzz = 1
    with pytest.raises(AttributeError, match=r"'devise'; did you mean 'device'\?; .*'sed'; did you mean 'seed'"):
        cfg.replace(devise="cpu", sed=1)
    with pytest.raises(TypeError, match="PartCfg has no field 'mas'; did you mean 'mass'"):
        PartCfg(mas=1.0)
    cfg._private = 1  # names with an underscore are free


def test_validate_reports_everything_at_once():
    cfg = RobotCfg(part=PartCfg(mass=-1.0), optional=PartCfg(mass=math.nan))
    cfg.parts["leg"].mass = 0.0
    cfg.pair[1].mass = -3.0
    with pytest.raises(ConfigError) as error:
        cfg.validate()
    assert error.value.problems == [
        "optional.mass: is nan, must be a finite number",
        "path: is missing, RobotCfg needs a value",
        "part.mass: is -1.0, must be positive",
        "parts.leg.mass: is 0.0, must be positive",
        "pair.1.mass: is -3.0, must be positive",
    ]
    assert isinstance(error.value, ValueError)
    assert pickle.loads(pickle.dumps(error.value)).problems == error.value.problems
    robot().validate()


def test_a_check_may_meet_a_missing_value():
    @configclass
    class Cfg:
        low: float = MISSING
        high: float = 1.0

        def problems(self):
            if self.low > self.high:
                yield "low", "is above high"

    with pytest.raises(ConfigError, match=r"1 problem in .*:\n  low: is missing, Cfg needs a value$"):
        Cfg().validate()


def test_dataclasses_missing_is_the_same():
    @configclass
    class Cfg:
        a: int = dataclasses.MISSING
        b: Any = None

    assert Cfg().a is MISSING
    assert Cfg(a=1) == Cfg(a=1)
    assert Cfg(a=1) != Cfg(a=2)
    assert "a=1" in repr(Cfg(a=1))


def test_resolve_name():
    assert resolve_name("math:sin") is math.sin
    assert resolve_name("pathlib:Path.home") == Path.home
    for name, error in (("math", ValueError), ("math:nope", AttributeError), ("no_such_module:x", ImportError)):
        with pytest.raises(error):
            resolve_name(name)


def test_a_field_without_effect_warns_when_it_is_set():
    @configclass
    class Base:
        group: int = 0
        size: float = 1.0
        IGNORED: ClassVar[dict[str, str]] = {"group": "all of them collide"}

    @configclass
    class Derived(Base):
        group = 3

    assert [f.name for f in dataclasses.fields(Base)] == ["group", "size"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Base(size=2.0).validate()
    for config in (Base(group=1), Derived()):
        with pytest.warns(UserWarning, match=r"^Base\.group has no effect: all of them collide$"):
            config.validate()


def test_a_field_without_effect_warns_once():
    @configclass
    class Part:
        group: int = 0
        IGNORED: ClassVar[dict[str, str]] = {"group": "all of them collide"}

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("default")
        for _ in range(3):
            Part(group=1).validate()
    assert len(caught) == 1


# -- classes without the decorator


def test_a_subclass_without_the_decorator_is_refused_by_name():
    class Forgotten(PartCfg):
        length: float = 1.0

    text = (
        rf"^class 'Forgotten' of {__name__}, a subclass of PartCfg, has no @configclass; write @configclass above it$"
    )
    with pytest.raises(TypeError, match=text):
        Forgotten()
    with pytest.raises(TypeError, match="class 'Forgotten'"):  # its fields would be lost

        @configclass
        class Below(Forgotten):
            pass


def test_a_dataclass_in_its_place_is_refused_by_name():
    @dataclasses.dataclass
    class Wrong(PartCfg):
        length: float = 1.0

    with pytest.raises(
        TypeError, match=r"class 'Wrong' .* has @dataclass in place of @configclass; write @configclass"
    ):
        Wrong()

    @configclass
    @dataclasses.dataclass
    class Both(PartCfg):
        length: float = 1.0

    assert Both(length=2.0).length == 2.0


def test_numbers_of_numpy_become_plain_ones():
    cfg = RobotCfg(seed=np.arange(4)[3], enabled=np.bool_(True))
    cfg.part.mass = np.float32(0.5)
    assert (type(cfg.seed), type(cfg.part.mass), cfg.enabled) == (int, float, True)
    assert cfg.enabled is True
    assert type(cfg.gains) is np.ndarray


def test_values_that_cannot_be_copied_are_shared_and_refused_by_type():
    cfg = RobotCfg(path="a", func=math).copy()
    with pytest.raises(ConfigError, match=r"func: is <module 'math'.*>, must be a function"):
        cfg.validate()
