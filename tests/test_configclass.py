# SPDX-License-Identifier: Apache-2.0
"""stripe_newton.configclass: fields, copies, dicts, errors.

The ``from __future__`` line makes all annotations strings; the classes at the end of the file's imports use that.
"""

from __future__ import annotations

import copy
import dataclasses
import enum
import math
import pickle
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from stripe_newton import trusted_code
from stripe_newton.configclass import MISSING, ConfigError, configclass, is_config, resolve_name


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


def test_to_dict_is_plain():
    data = robot().to_dict()
    assert data["part"] == {"mass": 1.0, "size": [1.0, 2.0], "names": ["a"]}
    assert data["pair"][1]["mass"] == 3.0
    assert data["func"] == "math:sin"
    assert data["class_type"] == "builtins:dict"
    assert (data["shape"], data["folder"], data["gains"], data["optional"]) == ("BOX", "a", [1.0, 2.0], None)
    assert RobotCfg().to_dict()["path"] == "MISSING"


@pytest.fixture
def own_code(monkeypatch):
    """Configs may name functions of this file and of math."""
    monkeypatch.setattr(trusted_code, "_packages", {"stripe_newton"})
    trusted_code.trust(__name__)
    trusted_code.trust("math")


@pytest.mark.usefixtures("own_code")
def test_round_trip_through_yaml():
    import yaml

    changed = robot().replace(
        optional=PartCfg(mass=7.0, size=(3.0, 4.0)),
        func=math.cos,
        class_type=Shape,
        other_func=math.tan,
        shape=Shape.BALL,
        folder=Path("b/c"),
        eye=(1.0, 2.0, 3.0),
        seed=5,
        device="cuda:1",
        enabled=False,
        gains=np.array([3.0, 4.0]),
    )
    changed.parts["arm"].names = []
    changed.pair[0].size = (9.0, 9.0)
    new = RobotCfg()
    new.from_dict(yaml.safe_load(yaml.safe_dump(changed.to_dict())))
    np.testing.assert_array_equal(new.gains, changed.gains)
    new.gains = changed.gains = 0
    assert new == changed
    assert isinstance(new.pair, tuple)
    assert isinstance(new.eye, tuple)
    assert isinstance(new.optional, PartCfg)


def test_round_trip_of_defaults_keeps_values_that_have_no_name():
    cfg = PlainCfg()
    new = PlainCfg()
    new.from_dict(cfg.to_dict())
    assert new.square is cfg.square
    assert new == cfg
    cfg = RobotCfg()
    cfg.from_dict(RobotCfg().to_dict())
    assert cfg.path is MISSING


def test_from_dict_merges_configs_and_replaces_containers():
    cfg = robot()
    cfg.from_dict({"part": {"mass": 2}, "parts": {"leg": {"mass": 3.0}}})
    assert cfg.part.mass == 2
    assert cfg.part.names == ["a"]
    assert list(cfg.parts) == ["leg"]
    assert cfg.parts["leg"].mass == 3.0
    assert cfg.parts["leg"].size == (1.0, 2.0)
    assert robot().parts["leg"].mass == 1.0


@pytest.mark.parametrize(
    ("annotation", "good", "bad"),
    [
        ("int", [1, np.int64(2)], ["a", True, [1], 2.0]),
        ("float | None", [1, 2.0, None], ["1e-3", True, math.nan, -math.inf]),
        ("Optional[str]", ["a", None], [1, False]),
        ("Union[str, Dict[str, float]]", ["a", {"b": 1.0}], []),
        ("dict[str, tuple[float, int]] | float", [1.0, {"a": [1, 2]}], ["a"]),
        ("list[int]", [[1], []], [1, "a"]),
        ("bool", [True], [1, "yes"]),
        ("Any", [1, "a", True, [1], {"a": 1}], []),
        ("SomeSpace | int", [1, "a"], []),
    ],
)
def test_values_are_held_against_the_annotation(annotation, good, bad):
    cfg = configclass(type("Cfg", (), {"__annotations__": {"x": annotation}, "__module__": __name__}))()
    for value in good:
        cfg.from_dict({"x": value})
        assert cfg.x == value
    for value in bad:
        cfg.x = None
        with pytest.raises(ConfigError, match=r"x: is .*, must be "):
            cfg.from_dict({"x": value})
        assert cfg.x is None
        cfg.x = value
        with pytest.raises(ConfigError, match=r"x: is .*, must be "):
            cfg.validate()


def test_from_dict_cannot_invent_a_config():
    with pytest.raises(ConfigError, match="parts: has no 'tail', only leg, arm; add it in Python"):
        robot().from_dict({"parts": {"tail": {"mass": 1.0}}})
    cfg = robot()
    cfg.from_dict({"optional": {"mass": 2.5}})  # here the annotation names the class
    assert cfg.optional == PartCfg(mass=2.5)
    cfg.from_dict({"optional": None})
    assert cfg.optional is None
    with pytest.raises(ConfigError, match=r"part: is None, must be a mapping of PartCfg's fields"):
        cfg.from_dict({"part": None})


def test_from_dict_reports_everything_at_once():
    cfg = robot()
    with pytest.raises(ConfigError) as error:
        cfg.from_dict(
            {
                "devise": "cpu",
                "part": {"mas": 1.0, "mass": "heavy"},
                "parts": {"leg": {"size": 1}, "arm": 3},
                "pair": [{"names": ["q"], "nam": 1}],
                "func": "math:no_such",
                "class_type": "dict",
                "shape": "RING",
                "seed": "abc",
                "device": 3,
                "enabled": 1,
            }
        )
    lines = error.value.problems
    paths = [line.split(":")[0] for line in lines]
    assert paths == [
        "devise",
        "part.mas",
        "part.mass",
        "parts.leg.size",
        "parts.arm",
        "pair.0.nam",
        "func",
        "class_type",
        "shape",
        "seed",
        "device",
        "enabled",
    ]
    text = str(error.value)
    assert text.startswith("12 problems in the configuration:\n  devise: ")
    assert "part.mass: is 'heavy', must be a finite number" in text
    assert "parts.leg.size: is 1, must be 2 finite numbers" in text
    assert "parts.arm: is 3, must be a mapping of PartCfg's fields" in text
    assert "shape: is 'RING', must be one of BOX, BALL" in text
    assert "class_type: 'dict' cannot be imported" in text
    assert "enabled: is 1, must be True or False" in text


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
