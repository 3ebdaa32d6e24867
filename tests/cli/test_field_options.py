# SPDX-License-Identifier: Apache-2.0
"""Field options: an option for each field of a config, and configs that come back."""

from __future__ import annotations

import copy
import dataclasses
import pickle
from typing import Literal

import tyro
import yaml

from stripe_newton.assets import RobotNotFoundError
from stripe_newton.cli.field_options import apply_options, apply_saved, options_of
from stripe_newton.cli.tasks import load_cfg, task_ids
from stripe_newton.configclass import MISSING, configclass


@configclass
class Inner:
    gain: float = 1.0
    """How much."""
    kind: Literal["a", "b"] = "a"
    stiffness: float | dict[str, float] | None = None


@configclass
class Outer:
    flag: bool = True
    count: int | None = None
    name: str = "x"
    size: tuple[int, ...] = (3, 4)
    point: tuple[float, float, float] = (0.0, 0.0, 1.0)
    files: list[str] = []
    space: int | object = 4
    needed: int = MISSING
    unannotated = 0.5
    func: object = len
    inner: Inner = Inner()
    parts: dict[str, Inner] = {"legs": Inner(gain=2.0), "arm.*": Inner()}


def parsed(cfg: Outer, line: str = "") -> Outer:
    options = tyro.cli(type(options_of(cfg, "cfg")), args=line.split(), config=(tyro.conf.FlagConversionOff,))
    apply_options(cfg, options, "env")
    return cfg


def test_any_field_by_an_option():
    cfg = parsed(
        Outer(),
        "--flag False --count 3 --name y --size 1 2 5 --point 1 2 3 --files a b --space 9 --needed 8 "
        "--unannotated 2 --inner.gain 7 --inner.kind b --inner.stiffness 4.5 --parts.legs.gain 9",
    )
    assert (cfg.flag, cfg.count, cfg.name, cfg.size, cfg.point) == (False, 3, "y", (1, 2, 5), (1.0, 2.0, 3.0))
    assert (cfg.files, cfg.space, cfg.needed, cfg.unannotated) == (["a", "b"], 9, 8, 2.0)
    assert (cfg.inner.gain, cfg.inner.kind, cfg.inner.stiffness) == (7.0, "b", 4.5)
    assert cfg.parts["legs"].gain == 9.0
    assert cfg.func is len


def test_no_option_changes_nothing():
    cfg, untouched = Outer(), Outer()
    parsed(cfg)
    assert cfg.needed is MISSING
    assert cfg.to_dict() == untouched.to_dict()


def test_options_have_defaults_of_the_instance_and_help():
    cfg = Outer(size=(8,), name="mine")
    options = options_of(cfg, "cfg")
    assert (options.size, options.name) == ((8,), "mine")
    assert {field.name for field in dataclasses.fields(options)} >= {"flag", "count", "inner", "parts"}
    assert not hasattr(options, "func")


def test_saved_config_comes_back():
    changed = Outer(size=(9, 9), needed=3)
    changed.inner.stiffness = 3.5
    changed.parts["legs"].gain = 0.25
    changed.parts["arm.*"].gain = 4.0
    saved = yaml.safe_load(yaml.safe_dump(changed.to_dict()))
    fresh = Outer()
    assert apply_saved(fresh, saved, "env") == []
    assert fresh.to_dict() == changed.to_dict()
    assert fresh.size == (9, 9)
    assert isinstance(fresh.parts["legs"], Inner)
    saved["gone"], saved["func"] = 1, "builtins:max"
    assert apply_saved(fresh, saved, "env") == [
        "env.func: was 'builtins:max', is 'builtins:len'",
        "env.gone: was 1, the field is no longer there",
    ]


def test_configs_of_every_task_are_copied_and_pickled():
    """Sweeps and other processes need that; Warp functions and generated scenes are among the values."""
    for task in (name for name in task_ids() if name.startswith("Stripe-")):
        for kind in ("env", "agent"):
            try:
                cfg = load_cfg(task, kind)
            except RobotNotFoundError:  # its file is not on this machine
                continue
            for other in (copy.deepcopy(cfg), pickle.loads(pickle.dumps(cfg))):
                assert type(other) is type(cfg)
                assert other.to_dict() == cfg.to_dict()
