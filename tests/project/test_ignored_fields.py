# SPDX-License-Identifier: Apache-2.0
"""Config fields without effect: each is a field, says why in its docstring, and warns by name when it is set."""

from __future__ import annotations

import ast
import contextlib
import importlib
import inspect
import textwrap
import warnings
from pathlib import Path

import pytest

from stripe_newton.configclass import ConfigError

ROOT = Path(__file__).parents[2]
PACKAGES = {"stripe_newton": ROOT, "stripe_tasks": ROOT / "tasks"}


def config_classes() -> list[type]:
    """Config classes that declare fields without effect themselves."""
    found = {}
    for package, above in PACKAGES.items():
        for path in sorted((above / package).rglob("*.py")):
            if "IGNORED: ClassVar" not in path.read_text() or path.name == "configclass.py":
                continue
            module = importlib.import_module(".".join(path.relative_to(above).with_suffix("").parts))
            for value in vars(module).values():
                if inspect.isclass(value) and "IGNORED" in vars(value) and value.__module__ == module.__name__:
                    found[f"{value.__module__}.{value.__qualname__}"] = value
    return list(found.values())


CASES = [(cls, name) for cls in config_classes() for name in vars(cls)["IGNORED"]]


def another(value: object) -> object:
    """A value that is not ``value``, of its type where that is plain."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, (int, float)):
        return value + 1
    if isinstance(value, str):
        return f"{value}other"
    return "other" if value is None else None


def warnings_of(cfg: object) -> list[str]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with contextlib.suppress(ConfigError):  # of fields that must be set and are not, or of the value itself
            cfg.validate()
    return [str(w.message) for w in caught]


def test_there_is_something_to_check():
    assert len(CASES) > len(NATIVE) > 5


@pytest.mark.parametrize(("cls", "name"), CASES, ids=[f"{cls.__name__}.{name}" for cls, name in CASES])
def test_a_field_without_effect_warns_by_name_when_it_is_set(cls, name):
    assert name in cls.__dataclass_fields__
    cfg = cls()
    said = f"{cls.__name__}.{name} has no effect: {vars(cls)['IGNORED'][name]}"
    assert said not in warnings_of(cfg)
    setattr(cfg, name, another(getattr(cfg, name)))
    assert said in warnings_of(cfg)


# The dialect's fields are Isaac Lab's and documented there; what they lack here is told by IGNORED alone.
NATIVE = [(cls, name) for cls, name in CASES if not cls.__module__.startswith("stripe_newton.isaaclab.")]


@pytest.mark.parametrize(("cls", "name"), NATIVE, ids=[f"{cls.__name__}.{name}" for cls, name in NATIVE])
def test_the_docstring_of_a_field_without_effect_says_so(cls, name):
    body = ast.parse(textwrap.dedent(inspect.getsource(cls))).body[0].body
    fields = [i for i, node in enumerate(body) if isinstance(node, ast.AnnAssign) and node.target.id == name]
    text = body[fields[0] + 1]
    assert isinstance(text, ast.Expr)
    assert text.value.value.startswith("Ignored: ")


def test_terrain_warns_of_a_number_of_environments_that_is_not_the_scenes():
    from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
    from stripe_newton.sim import Simulation, SimulationCfg
    from stripe_newton.terrains import TerrainImporter, TerrainImporterCfg

    cfg = TerrainImporterCfg(prim_path="/World/ground", terrain_type="plane")
    for number, warned in ((None, False), (3, False), (4, True)):
        scene = InteractiveScene(
            InteractiveSceneCfg(num_envs=3, env_spacing=1.0), Simulation(SimulationCfg(device="cpu"))
        )
        with scene.construction(), warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            terrain = TerrainImporter(cfg.replace(num_envs=number))
        assert terrain.num_envs == 3
        assert any("num_envs is 4, the scene has 3" in str(w.message) for w in caught) == warned
