# SPDX-License-Identifier: Apache-2.0
"""Name checks: what the terms of a config name and the scene lacks, and Warp functions of terms that do not compile."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Protocol

import warp as wp

from stripe_newton.configclass import MISSING, is_config
from stripe_newton.fusion import function_problem
from stripe_newton.fusion.scene_entity import HasNames, SceneEntityCfg
from stripe_newton.managers import ActionTermCfg, CommandTermCfg
from stripe_newton.managers.manager_base import terms_of
from stripe_newton.matching import match_names, near_matches

__all__ = ["name_problems"]


class _Scene(Protocol):
    """Part of a scene that has assets and sensors by name."""

    def __getitem__(self, key: str) -> HasNames: ...

    def keys(self) -> list[str]: ...


def name_problems(fields: Mapping[str, object], scene: _Scene) -> Iterator[str]:
    """Everything that terms name and that is not there, each as ``path: what is wrong, what there is``.

    The managers would find it, too. But they are made after the model and the solver, which takes minutes on a GPU for
    the first time.

    Args:
        fields: Configs of the managers by the name of their field, ``"commands"`` among them.
        scene: The scene; its assets and sensors know the names of their joints and bodies.
    """
    commands = [name for name, term in terms_of(fields.get("commands")).items() if term is not None]
    for field, cfg in fields.items():
        for path, value in _walk(cfg, field):
            if isinstance(value, wp.Function):
                problem = function_problem(value)
                yield from [f"{path}: '{value.func.__name__}' at {problem}"] if problem else []
            elif isinstance(value, SceneEntityCfg):
                yield from (f"{path}: {problem}" for problem in _entity_problems(value, scene))
            elif isinstance(value, (ActionTermCfg, CommandTermCfg)):
                yield from (f"{path}.{problem}" for problem in _term_problems(value, scene))
            elif path.endswith("['command_name']") and isinstance(value, str) and value not in commands:
                yield f"{path}: {_unknown('command', value, commands)}"


def _walk(value: object, path: str) -> Iterator[tuple[str, object]]:
    """A value and all that is inside it, with their paths."""
    yield path, value
    if isinstance(value, SceneEntityCfg):
        return
    if isinstance(value, Mapping):
        for key, item in value.items():
            yield from _walk(item, f"{path}.{key}" if "params" not in path else f"{path}[{key!r}]")
    elif is_config(value):
        for key in type(value).__dataclass_fields__:
            yield from _walk(getattr(value, key), f"{path}.{key}")


def _entity_problems(entity: SceneEntityCfg, scene: _Scene) -> Iterator[str]:
    if entity.name not in (there := scene.keys()):
        yield _unknown("asset or sensor", entity.name, there)
        return
    for kind in ("joint", "body"):
        names = scene[entity.name].names_of(kind) if entity.chooses(kind) else None
        if names is not None:
            try:
                entity.indices(kind, names)
            except ValueError as error:
                yield str(error)


def _term_problems(term: ActionTermCfg | CommandTermCfg, scene: _Scene) -> Iterator[str]:
    """Names of an action or a command, whose fields they are."""
    asset = getattr(term, "asset_name", MISSING)
    if not isinstance(asset, str) or asset is MISSING:
        return
    if asset not in (there := scene.keys()):
        yield f"asset_name: {_unknown('asset or sensor', asset, there)}"
        return
    for field, kind in (("joint_names", "joint"), ("body_name", "body")):
        expressions, names = getattr(term, field, None), scene[asset].names_of(kind)
        if not expressions or expressions is MISSING or not names:
            continue
        try:
            match_names(expressions, names, what=f"{kind} of '{asset}'")
        except ValueError as error:
            yield f"{field}: {error}"


def _unknown(what: str, name: str, there: list[str]) -> str:
    near = near_matches(name, there)
    hint = f"did you mean {' or '.join(near)}? " if near else ""
    return f"there is no {what} '{name}'; {hint}there is: {', '.join(there) or 'nothing'}"
