# SPDX-License-Identifier: Apache-2.0
"""Term evaluation: Warp terms called from torch code, outside of the kernels of a step."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass

import torch
import warp as wp

from stripe_kernels.term_info import observation_size
from stripe_newton.call_checks import checked_env_ids
from stripe_newton.configclass import ConfigError, is_config
from stripe_newton.fusion import Flag, Item, Plan, SceneEntityCfg, Section, Stage, bind_term, code, usage_of

from .context import ManagerContext
from .event_cfg import EventTermCfg
from .event_source import EventSource
from .model_events import ModelEvents

__all__ = ["TermEvaluation"]

_KINDS = {float: "reward", wp.float32: "reward", bool: "termination", wp.bool: "termination"}
"""Kinds of terms by the type that they return."""
_DTYPES = {"observation": float, "reward": float, "termination": wp.bool}
_RANK = 9
"""Rank of the flag of the chosen environments: it is tested after the flags of a step."""


@dataclass
class _Evaluated:
    """A term that was made into a kernel of its own.

    Attributes:
        path: Path of its parameters.
        run: Runs it.
        out: Its values; None for an event.
        given: Numbers and tuples of numbers of the last call, by argument.
        tunable: Names of those among them that are parameters and may change from call to call.
    """

    path: str
    run: Callable[[], None]
    out: torch.Tensor | None
    given: dict[str, object]
    tunable: set[str]

    def takes(self, given: Mapping[str, object]) -> bool:
        """Whether it can be run with other numbers."""
        return all(value == self.given[name] for name, value in given.items() if name not in self.tunable)


_Make = Callable[[wp.Function, Mapping[str, object], str], tuple[list[Item], "torch.Tensor | None"]]
"""Function that makes the items of a term, with its parameters at a path, and the tensor of its values."""


class TermEvaluation:
    """Evaluates Warp terms on the present state, and applies Warp events to environments that the caller chooses.

    Each combination of a function with assets, joints and bodies is made into a kernel once. Numbers are its parameters
    and may differ from call to call.
    """

    def __init__(self, context: ManagerContext):
        self._context = context
        self._known: dict[Hashable, list[_Evaluated]] = {}
        self._chosen = context.array("chosen_envs", wp.bool)

    def value(self, func: wp.Function, params: Mapping[str, object]) -> torch.Tensor:
        """Value of an observation, reward or termination term, in a new tensor.

        Args:
            func: The Warp function.
            params: Its parameters, as in the config of a term.

        Returns:
            Shape ``(num_envs, size)`` for an observation, ``(num_envs,)`` for rewards (float) and terminations (bool).

        Raises:
            ConfigError: parameters that do not fit.
        """
        made = self._made("values", func, params, self._make_value)
        made.run()
        assert made.out is not None
        return made.out.clone()

    def apply(
        self, func: wp.Function, env_ids: Sequence[int] | torch.Tensor | None, params: Mapping[str, object]
    ) -> None:
        """Run an event in the environments ``env_ids``; None means all of them.

        Raises:
            ConfigError: parameters that do not fit.
            ValueError: for environments that there are not.
        """
        chosen = self._context.torch(self._chosen)
        chosen.fill_(env_ids is None)
        if env_ids is not None:
            # The check may wait for the device: users call this outside of recorded steps.
            chosen[checked_env_ids(env_ids, self._context.num_envs, str(chosen.device))] = True
        self._made("events", func, params, self._make_event).run()
        if usage_of(func).may_use(("root_pose", "joint_pos")):
            self._context.scene.sim.forward(chosen)

    # -- construction

    def _made(self, where: str, func: wp.Function, params: Mapping[str, object], make: _Make) -> _Evaluated:
        """The kernel of a term, made at its first call, with the numbers of this call in its parameters."""
        given = {name: value for name, value in params.items() if _is_numeric(value)}
        key = (id(func), *sorted((k, _key(v)) for k, v in params.items() if k not in given), *sorted(given))
        known = self._known.setdefault(key, [])
        made = next((one for one in known if one.takes(given)), None)
        if made is None:
            made = self._compiled(where, func, params, make, given)
            known.append(made)
        for name in made.tunable:
            if made.given[name] != given[name]:
                self._context.parameters[f"{made.path}.{name}"] = given[name]  # type: ignore[assignment]  # numbers
                made.given[name] = given[name]
        return made

    def _compiled(
        self, where: str, func: wp.Function, params: Mapping[str, object], make: _Make, given: Mapping[str, object]
    ) -> _Evaluated:
        context, name = self._context, func.func.__name__
        path, before = f"{where}.evaluated_{sum(map(len, self._known.values()))}", len(context.problems)
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")  # Python shows a warning once; it is shown below
            items, out = make(func, params, path)
        for warning in caught:  # which name the term as the caller knows it, as problems do
            warnings.warn(f"'{name}'{str(warning.message).removeprefix(path)}", warning.category, stacklevel=2)
        problems = context.problems[before:]
        del context.problems[before:]
        if problems:
            raise ConfigError([f"'{name}'{text.removeprefix(path)}" for text in problems])
        stages = [Stage("term", items)]
        plan = Plan(f"evaluated_{name}", stages, context.scope, context.num_envs, context.device, use_graph=False)
        tunable = {name for name in given if f"{path}.{name}" in context.parameters}
        return _Evaluated(path, plan.run, out, dict(given), tunable)

    def _make_value(
        self, func: wp.Function, params: Mapping[str, object], path: str
    ) -> tuple[list[Item], torch.Tensor | None]:
        context, kind = self._context, _kind_of(func)
        call = bind_term(context, func, params, path, kind)
        if call is None:
            return [], None
        shape: tuple[int, ...] = ()
        if kind == "observation":
            size = observation_size(func)
            shape = (size(call.counts) if callable(size) else int(size or 0),)
        array = context.array(f"{path}.value", _DTYPES[kind], *shape)
        target = code("{}[env]", context.scope.name(f"{path}_value", array))
        line = call.expression(target) if shape else code("{} = {}", target, call.expression())
        return [Section("evaluated", [line], [func.func.__name__])], context.torch(array)

    def _make_event(
        self, func: wp.Function, params: Mapping[str, object], path: str
    ) -> tuple[list[Item], torch.Tensor | None]:
        context, name = self._context, path.removeprefix("events.")
        model = ModelEvents(context)
        source = EventSource(context, model, name, EventTermCfg(func=func, params=dict(params), mode=name))
        flag = Flag(_RANK, code("{}[env]", context.scope.name("chosen_envs", self._chosen)))
        section = Section("applied", source.calls(func), [func.func.__name__]).only(flag)
        return model.complete(name, [section], last=True), None


def _kind_of(func: wp.Function) -> str:
    """Kind of a term, by its arguments and the type that it returns.

    Raises:
        TypeError: if it is of none of the kinds that have a value.
    """
    if "out" in func.input_types:
        return "observation"
    returned = func.func.__annotations__.get("return")
    if isinstance(returned, str):  # of a module with postponed annotations
        returned = eval(returned, func.func.__globals__)
    if returned not in _KINDS:
        raise TypeError(f"'{func.func.__name__}' is no observation, reward or termination: it returns {returned!r}")
    return _KINDS[returned]


def _is_numeric(value: object) -> bool:
    """Whether a parameter is a number, or a list or tuple of numbers."""
    if isinstance(value, (list, tuple)):
        return all(isinstance(v, (bool, int, float)) for v in value)
    return isinstance(value, (bool, int, float))


def _key(value: object) -> Hashable:
    """Hashable key of a parameter: equal contents give equal keys."""
    if isinstance(value, SceneEntityCfg) or is_config(value):
        return (type(value).__name__, *((k, _key(v)) for k, v in vars(value).items()))
    if isinstance(value, Mapping):
        return tuple((k, _key(v)) for k, v in value.items())
    if isinstance(value, (list, tuple)):
        return tuple(map(_key, value))
    if isinstance(value, slice):
        return ("slice", value.start, value.stop, value.step)
    return value if isinstance(value, (str, bool, int, float, type(None))) else id(value)
