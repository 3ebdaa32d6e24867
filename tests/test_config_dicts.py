# SPDX-License-Identifier: Apache-2.0
"""Configs to dicts and back: plain values, round trips, merging, and what does not fit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from stripe_newton import trusted_code
from stripe_newton.configclass import MISSING, ConfigError, configclass
from tests.helpers.config_examples import PartCfg, PlainCfg, RobotCfg, Shape, robot


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
    """Configs may name what is in the module of the examples, and in math."""
    monkeypatch.setattr(trusted_code, "_packages", {"stripe_newton"})
    trusted_code.trust(Shape.__module__)
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
