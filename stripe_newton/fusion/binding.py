# SPDX-License-Identifier: Apache-2.0
"""From a term and its parameters to a call in generated source."""

from __future__ import annotations

import difflib
import inspect
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
import warp as wp

from stripe_kernels.data import ActionData, ArticulationData, EpisodeData, Parameter
from stripe_kernels.model_data import EncoderData
from stripe_kernels.terrain import TerrainData
from stripe_newton.configclass import configclass
from stripe_newton.matching import match_names, match_values

from .entity import SceneEntityCfg, names_of

__all__ = ["TermCall", "TermState", "bind_term", "fields_read"]

_RETURNS: dict[str, Any] = {
    "reward": float,
    "metric": float,
    "termination": bool,
    "curriculum": float,
    "modifier": float,
}
_SCALARS = {float: float, wp.float32: float, int: int, wp.int32: int, bool: bool, wp.bool: bool}
_NUMPY = {wp.int32: np.int32, wp.bool: np.bool_}
_VECTORS = (wp.vec2, wp.vec3, wp.vec4, wp.quat)
_PARTS = {"ray_ids": "num_rays", "direction_ids": "num_directions"}
"""Arguments that name parts of a sensor, and what it calls their number."""
_AXES = ("x", "y", "z", "roll", "pitch", "yaw")


@configclass
class TermState:
    """An array that terms keep from step to step; terms that name it alike share it."""

    name: str = "state"
    """What it is called."""
    dtype: Any = float
    """Warp type of an element."""
    shape: Sequence[int] = ()
    """Shape for one environment."""


@dataclass
class TermCall:
    """A term with its arguments found."""

    function: str
    """Name of the function in the source."""
    arguments: list[str]
    """Expressions; ``{out}`` stands for where an observation is written."""
    names: list[str] = field(default_factory=list)
    """Names of the arguments."""
    counts: dict[str, int] = field(default_factory=dict)
    """Lengths of index arrays by argument, and ``num_actions``, ``num_command``, ``num_objects`` where they apply."""

    def expression(self, out: str | None = None, sliced: Sequence[str] = (), span: str = "") -> str:
        """Source of the call.

        Args:
            out: Where an observation is written.
            sliced: Arguments of which only a part is passed.
            span: That part, as ``first:last``.
        """
        arguments = [a.replace("{out}", out or "") for a in self.arguments]
        for i, name in enumerate(self.names):
            if name in sliced:
                arguments[i] += f"[{span}]"
        return f"{self.function}({', '.join(arguments)})"


def bind_term(
    context: Any, func: Any, params: Mapping[str, Any], where: str, kind: str, fixed: Mapping[str, str] | None = None
) -> TermCall | None:
    """Find what each argument of a term is, by its annotation and its name.

    Args:
        context: The manager context.
        func: A Warp function.
        params: What the config says.
        where: Path of the term, such as ``rewards.alive``; tuned numbers are kept below it.
        kind: ``"observation"``, ``"reward"``, ``"termination"``, ``"event"``, ``"command"``, ``"action"``,
            ``"curriculum"`` or ``"metric"``.
        fixed: Expressions of arguments that the manager knows.

    Returns:
        The call, or None after problems were added to ``context.problems``.
    """
    if not isinstance(func, wp.Function):
        context.problems.append(f"{where}.func: is {func!r}, must be a Warp function (@wp.func)")
        return None
    return _Binding(context, func, dict(params), where, kind, dict(fixed or {})).run()


def fields_read(func: wp.Function) -> set[str]:
    """Names of attributes that a Warp function reads, itself or through the functions it calls."""
    found: set[str] = set()
    todo, seen = [func], set()
    while todo:
        function = todo.pop()
        if id(function) in seen:
            continue
        seen.add(id(function))
        source = function.adj.source
        found.update(re.findall(r"\.([A-Za-z_]\w*)", source))
        space = function.func.__globals__
        for name in set(re.findall(r"[A-Za-z_][\w.]*(?=\()", source)):
            thing: Any = space.get(name.split(".")[0])
            for part in name.split(".")[1:]:
                thing = getattr(thing, part, None)
            if isinstance(thing, wp.Function) and thing.func is not None:
                todo.append(thing)
    return found


class _Missing(Exception):
    """An argument that cannot be found; says what would be right."""


class _Binding:
    def __init__(
        self, context: Any, func: wp.Function, params: dict[str, Any], where: str, kind: str, fixed: dict[str, str]
    ):
        self.context, self.func, self.params, self.where, self.kind, self.fixed = (
            context, func, params, where, kind, fixed,
        )  # fmt: skip
        self.types: dict[str, Any] = dict(func.input_types)
        self.defaults = {
            k: p.default for k, p in inspect.signature(func.func).parameters.items() if p.default is not p.empty
        }
        self.used: set[str] = set()
        self.counts: dict[str, int] = {}
        self.entity: SceneEntityCfg | None = None
        self.sensor: SceneEntityCfg | None = None
        self.chosen: dict[str, list[str]] = {}
        self.problems: list[str] = []

    def run(self) -> TermCall | None:
        self._check_return()
        arguments = []
        for name, kind in self.types.items():
            try:
                arguments.append(self._argument(name, kind))
            except (_Missing, ValueError, KeyError) as error:
                text = error.args[0] if error.args else str(error)
                self.problems.append(f"{self.where}.params.{name}: {text}")
        ids, sensor_ids = (self.counts.get(n) for n in ("body_ids", "sensor_body_ids"))
        if None not in (ids, sensor_ids) and ids != sensor_ids:
            text = f"sensor_cfg names {sensor_ids} bodies, asset_cfg {ids}; they must be the same, in the same order"
            self.problems.append(f"{self.where}.params: {text}")
        ours, others = (self.chosen.get(n, []) for n in ("body_ids", "sensor_body_ids"))
        if ours != others and sorted(ours) == sorted(others):
            text = f"sensor_cfg names {', '.join(others)}, asset_cfg {', '.join(ours)}; set preserve_order in both"
            self.problems.append(f"{self.where}.params: {text}")
        takes = [n for n in self.types if n not in ("env", "out", "rng")]
        for extra in self.params.keys() - self.used - {"asset_cfg"}:
            near = difflib.get_close_matches(extra, takes, n=1)
            hint = f"; did you mean '{near[0]}'?" if near else f"; it takes {', '.join(takes) or 'none'}"
            self.problems.append(f"{self.where}.params.{extra}: '{self._name}' has no such argument{hint}")
        self.context.problems += self.problems
        if self.problems:
            return None
        return TermCall(self.context.scope.function(self.func), arguments, list(self.types), self.counts)

    @property
    def _name(self) -> str:
        return str(self.func.func.__name__)

    def _check_return(self) -> None:
        wanted, note = _RETURNS.get(self.kind), self.func.func.__annotations__.get("return")
        if isinstance(note, str):
            note = eval(note, self.func.func.__globals__)
        note = _SCALARS.get(note, note)
        if self.kind in _RETURNS and note is not wanted:
            has = "has no return annotation" if note is None else f"returns {getattr(note, '__name__', note)}"
            note = _RETURNS[self.kind].__name__
            text = f"'{self._name}' {has}, a {self.kind} must be annotated '-> {note}'"
            self.problems.append(f"{self.where}.func: {text}")
        if self.kind == "observation" and "out" not in self.types:
            self.problems.append(
                f"{self.where}.func: '{self._name}' has no argument 'out: wp.array[float]', to which an observation "
                "writes its numbers"
            )

    def _take(self, *keys: str) -> Any:
        for key in keys:
            if key in self.params:
                self.used.add(key)
                return self.params[key]
        return None

    # -- one argument

    def _argument(self, name: str, kind: Any) -> str:
        context, scope = self.context, self.context.scope
        if name in self.fixed:
            return self.fixed[name]
        if name == "env":
            return "env"
        if name == "out" and self.kind == "observation":
            return "{out}"
        if name in ("rng", "step") and name not in self.params:
            return name
        if name == "step_dt" and name not in self.params:
            return str(context.parameters.add("step_dt", context.step_dt, float))
        if kind is EpisodeData:
            return "episode"
        if kind is Parameter:
            return scope.name(f"{self.where}_{name}", self._reference())
        if kind is ArticulationData:
            return self._articulation(name)
        if kind is ActionData:
            return self._actions(name)
        if kind in context.provided:
            return self._provided(name, kind)
        if isinstance(kind, wp.array) or (getattr(kind, "dtype", None) is not None and not _is_vector(kind)):
            return self._array(name, kind)
        if kind in _SCALARS or _is_vector(kind):
            return self._number(name, kind)
        value = self._take(name)
        if value is not None and getattr(value, "_cls", None) is kind:
            return str(scope.name(name, value))
        what = getattr(kind, "key", None) or getattr(kind, "__name__", kind)
        if value is None and hasattr(kind, "vars"):
            raise _Missing(f"'{self._name}' needs a {what}, of which the environment has none")
        raise _Missing(f"is {value!r}, '{self._name}' needs {what}")

    def _number(self, name: str, kind: Any) -> str:
        value = self._take(name)
        if value is None:
            if name not in self.defaults:
                raise _Missing(f"is missing, '{self._name}' needs it")
            value = self.defaults[name]
        kind = _SCALARS.get(kind, kind)
        return str(self.context.parameters.add(f"{self.where}.{name}", value, kind))

    def _cfg(self, *keys: str) -> SceneEntityCfg | None:
        value = self._take(*keys)
        if isinstance(value, str):
            value = SceneEntityCfg(value)
        if value is not None and not isinstance(value, SceneEntityCfg):
            raise _Missing(f"is {value!r}, must be a SceneEntityCfg")
        return value

    def _articulation(self, name: str) -> str:
        keys = [name, f"{name}_cfg"] + (["asset_cfg"] if self.entity is None else [])
        cfg = self._cfg(*keys)
        if cfg is None:
            there = self.context.entity_names()
            cfg = SceneEntityCfg(name if name in there or len(there) != 1 else there[0])
        if self.entity is None:
            self.entity = cfg
        entity = self.context.entity(cfg.name)
        lacking = fields_read(self.func) & entity.data.unavailable.keys()
        for missing in sorted(lacking):
            raise _Missing(f"'{self._name}' reads '{missing}' of '{cfg.name}': {entity.data.unavailable[missing]}")
        return str(self.context.scope.name(cfg.name, entity.data.struct))

    def _indices(self, name: str, kind: str) -> list[int]:
        prefix = name.removesuffix(f"{kind}_ids").rstrip("_")
        given = self._take(name)
        cfg = self._cfg(prefix, f"{prefix}_cfg") if prefix else None
        cfg = cfg or self.entity or self.sensor or self._cfg("asset_cfg") or SceneEntityCfg()
        names = names_of(self.context.entity(cfg.name), kind)
        if names is None:
            raise _Missing(f"'{cfg.name}' has no {kind}s to choose from")
        if given is not None:
            texts = isinstance(given, str) or (given and isinstance(given[0], str))
            return match_names(given, names, what=f"{kind} of '{cfg.name}'")[0] if texts else list(given)
        other = {"joint": "body", "body": "joint"}[kind]
        if not cfg.chooses(kind) and cfg.chooses(other) and not any(n.endswith(f"{other}_ids") for n in self.types):
            about = {"joint": "joints", "body": "bodies"}[kind]
            raise _Missing(
                f"'{self._name}' is about {about} of '{cfg.name}', choose by {kind}_names, not {other}_names"
            )
        ids = cfg.indices(kind, names)
        self.chosen[name] = [names[i] for i in ids]
        return ids

    def _parts(self, name: str, count: int) -> list[int]:
        """Rays or directions of a sensor; all of them where none are chosen."""
        there, chosen = range(count), self._take(name)
        for wrong in (i for i in chosen or () if i not in there):
            raise _Missing(f"has {wrong}, the sensor has {_PARTS[name][4:]} 0 to {there[-1]}")
        return list(there if chosen is None else chosen)

    def _array(self, name: str, kind: Any) -> str:
        context = self.context
        if name == "term_ids":
            keys = self._take("term_keys", name)
            ids = match_names(keys or ".*", context.termination_names, what="termination term")[0]
            return self._constant(name, ids, kind)
        for what in ("joint", "body"):
            if name.endswith(f"{what}_ids"):
                ids = self._indices(name, what)
                self.counts[name] = len(ids)
                return str(context.scope.name(f"{what}_ids", context.index_array(ids)))
        many = _PARTS.get(name, "")
        if many in self.counts:
            parts = self._parts(name, self.counts[many])
            self.counts[name] = len(parts)
            return str(context.scope.name(name, context.index_array(parts)))
        value = self._take(name)
        if value is None and kind.ndim == 2 and "body_ids" in self.counts:  # the term's own memory, a column a body
            value = TermState(f"{self.where}.{name}", kind.dtype, (self.counts["body_ids"],))
        if value is None:
            raise _Missing(f"is missing, '{self._name}' needs {kind}")
        if isinstance(value, TermState):
            if _same_type(value.dtype, kind.dtype) and len(value.shape) + 1 == kind.ndim:
                return str(
                    context.scope.name(value.name, context.array(f"state.{value.name}", value.dtype, *value.shape))
                )
            raise _Missing(
                f"is a state of {value.dtype.__name__}, shape {tuple(value.shape)}, '{self._name}' needs {kind}"
            )
        if isinstance(value, torch.Tensor):
            value = wp.from_torch(value, dtype=kind.dtype)
        if isinstance(value, wp.array):
            return str(context.scope.name(name, value))
        if isinstance(value, Mapping) and kind.dtype is wp.vec2:
            wrong = value.keys() - set(_AXES)
            if wrong:
                raise _Missing(f"has {', '.join(map(repr, sorted(wrong)))}, keys must be among {', '.join(_AXES)}")
            value = [value.get(axis, (0.0, 0.0)) for axis in _AXES]
        elif isinstance(value, (Mapping, int, float)):
            entity = context.entity((self.entity or SceneEntityCfg()).name)
            names = [entity.data.joint_names[i] for i in self._indices("joint_ids", "joint")]
            found = match_values(value, names, what="joint")
            missing = [n for i, n in enumerate(names) if i not in found]
            if missing:
                raise _Missing(f"has no value for {', '.join(missing)}")
            value = [found[i] for i in range(len(names))]
        return self._constant(name, value, kind)

    def _constant(self, name: str, value: Any, kind: Any) -> str:
        data: Any = np.array(value, dtype=_NUMPY.get(kind.dtype, np.float32))
        size = len(data) if data.ndim else 1
        array = self.context.shared(f"{self.where}.{name}", kind.dtype, size)
        try:
            array.assign(data)
        except (RuntimeError, ValueError, TypeError):
            raise _Missing(f"is {value!r}, must be {size} times {kind.dtype.__name__}") from None
        return str(self.context.scope.name(f"{self.where}_{name}", array))

    def _provided(self, name: str, kind: Any) -> str:
        there: dict[str, Any] = self.context.provided[kind]
        general = [
            k for k in ("command_name", "pool_name", "sensor_cfg") if k in self.params and kind is not TerrainData
        ]
        wanted = self._take(name, f"{name}_name", f"{name}_cfg", *general)
        cfg = wanted if isinstance(wanted, SceneEntityCfg) else None
        wanted = cfg.name if cfg else wanted
        if wanted is None and kind is EncoderData and len(there) > 1:
            owner = self.entity or self._cfg("asset_cfg")
            wanted = owner.name if owner is not None else None
        if wanted is None and len(there) == 1:
            wanted = next(iter(there))
        what = getattr(kind, "key", "struct").rpartition(".")[2]
        if wanted not in there:
            asked = "is missing" if wanted is None else f"is '{wanted}'"
            raise _Missing(f"{asked}, must name a {what}: {', '.join(there) or 'none there'}")
        value = there[wanted]
        sensor = self.context.scene.sensors.get(wanted)
        if sensor is not None and sensor.struct is value:
            self.sensor = cfg or SceneEntityCfg(wanted)
            self.counts |= sensor.counts
            reasons = getattr(sensor, "unavailable", {})
            for missing in sorted(fields_read(self.func) & reasons.keys()):
                raise _Missing(f"'{self._name}' reads '{missing}' of '{wanted}': {reasons[missing]}")
        command = getattr(value, "command", None)
        if command is not None:
            self.counts["num_command"] = command.shape[1]
        active = getattr(value, "active", None)
        if active is not None:
            self.counts["num_objects"] = active.shape[1]
        return str(self.context.scope.name(wanted, value))

    def _actions(self, name: str) -> str:
        there = self.context.provided.get(ActionData, {})
        if not there:
            raise _Missing(f"'{self._name}' needs actions, of which the environment has none")
        whole = next(iter(there.values()))
        term = self._take("action_name")
        if term is None:
            self.counts["num_actions"] = whole.action.shape[1]
            return str(self.context.scope.name("actions", whole))
        if term not in self.context.action_slices:
            raise _Missing(f"action_name is '{term}', must be one of {', '.join(self.context.action_slices)}")
        first, size = self.context.action_slices[term]
        part = self.context.action_parts.setdefault(term, ActionData())
        part.action, part.prev_action = (
            whole.action[:, first : first + size],
            whole.prev_action[:, first : first + size],
        )
        self.counts["num_actions"] = size
        return str(self.context.scope.name(f"actions_{term}", part))

    def _reference(self) -> Parameter:
        term, address = self._take("term_name"), self._take("address")
        if term is None and address is None:
            raise _Missing("name what changes by 'term_name' (a reward) or 'address' (any parameter)")
        return self.context.parameters.reference(address or f"rewards.{term}.weight")


def _same_type(a: Any, b: Any) -> bool:
    return bool(_SCALARS.get(a, a) is _SCALARS.get(b, b))


def _is_vector(kind: Any) -> bool:
    return kind in _VECTORS
