# SPDX-License-Identifier: Apache-2.0
"""Model term: structs, shapes and checked parameters of an event term that changes the model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import newton
import warp as wp

from stripe_kernels.mdp.randomization import DISTRIBUTIONS, KEEP, OPERATIONS
from stripe_kernels.model_data import BodyModelData, EncoderData, JointModelData, ShapeModelData
from stripe_kernels.term_info import randomization_of
from stripe_newton.fusion import SceneEntityCfg, usage_of
from stripe_newton.fusion.warp_types import Struct, struct_fields
from stripe_newton.matching import match_names

from .context import ManagerContext
from .model_checks import ignores_restitution, range_problems, solver_problems
from .model_data import MODEL_FIELDS, SCENE, ModelStructs

__all__ = ["ModelTerm", "changes_model"]

_KINDS = (*MODEL_FIELDS, EncoderData)
_NUMBERS = {"operation": OPERATIONS, "distribution": DISTRIBUTIONS}
"""Codes that a function takes for the names in a config, by parameter."""
_PRIMITIVES = {int(getattr(newton.GeoType, n)) for n in ("SPHERE", "CAPSULE", "CYLINDER", "ELLIPSOID", "BOX")}
_SHAPE_FLAGS = {"sites": newton.ShapeFlags.SITE, "visible shapes": newton.ShapeFlags.VISIBLE}


def changes_model(func: object) -> bool:
    """Whether an event term changes the model: a Warp function with an argument that is a struct of the model."""
    return isinstance(func, wp.Function) and any(t in _KINDS for t in func.input_types.values())


class ModelTerm:
    """An event term that changes the model: the parameters of its function, and the arrays that it writes.

    Attributes:
        params: Parameters as the function takes them; complete after :meth:`problems`.
    """

    def __init__(self, context: ManagerContext, structs: ModelStructs, func: wp.Function, params: Mapping[str, object]):
        self._context, self._structs, self._func = context, structs, func
        self._info = randomization_of(func)
        self._ignored = [name for name in params if name in self._info.ignored]
        given = {**self._info.defaults, **params}
        self.params: dict[str, Any] = {
            name: KEEP if value is None and name in self._info.ranges else value
            for name, value in given.items()
            if name not in self._info.ignored
        }
        self._cfg = self._entity()
        self.params["asset_cfg"] = self._cfg

    def _entity(self) -> SceneEntityCfg:
        """The asset of the term: by default ``robot``, or the only asset of the scene."""
        given = self.params.get("asset_cfg")
        if isinstance(given, SceneEntityCfg):
            return given
        there = self._context.entity_names()
        default = "robot" if "robot" in there or len(there) != 1 else there[0]
        return SceneEntityCfg(given if isinstance(given, str) else default)

    def without_effect(self) -> list[str]:
        """Parameters accepted only so that configs of Isaac Lab load, as ``parameter has no effect: reason``."""
        found = [f"{name} has no effect: {self._info.ignored[name]}" for name in self._ignored]
        sim = self._context.scene.sim
        for name, (field, _) in self._info.ranges.items():
            bounds = self.params.get(name)
            if field == "restitution" and bounds and any(bounds) and not _is_kept(bounds) and ignores_restitution(sim):
                found.append(f"{name} has no effect: {sim.cfg.solver.solver_class} has no restitution")
        return found

    def problems(self) -> list[str]:
        """Complete the parameters and check them.

        Returns:
            Problems, each as ``parameter: text``.
        """
        problems = [*self._number_channels(), *self._number_choices()]
        try:
            self._find_structs()
            if "shape_ids" in self._func.input_types and "shape_ids" not in self.params:
                self.params["shape_ids"] = self._shapes()
            self.params.pop("shape_names", None)
            if not problems:
                problems += self._range_problems()
        except (KeyError, ValueError) as error:
            problems.append(f"asset_cfg: {error.args[0]}")
        return problems

    def writes(self) -> set[str]:
        """Names of the arrays of ``newton.Model`` that the term may write and that solvers read."""
        usage, ranges = usage_of(self._func), self._info.ranges
        kept = {field for name, (field, _) in ranges.items() if name in self.params and _is_kept(self.params[name])}
        found = set()
        for kind in self._func.input_types.values():
            for field, array in MODEL_FIELDS.get(kind, {}).items():
                if field not in kept and (usage.unresolved or field in usage.writes):
                    found.add(array)
        return found - {"shape_color"}  # colours are for pictures alone

    # -- parameters as numbers

    def _number_channels(self) -> Iterator[str]:
        """Turn colour ranges by channel into a list in the order r, g, b; yields problems."""
        colors = self.params.get("colors")
        if "colors" not in self._func.input_types or not isinstance(colors, Mapping):
            return
        wrong = sorted(colors.keys() ^ {"r", "g", "b"})
        if wrong:
            yield f"colors: {', '.join(map(repr, wrong))} too many or missing, keys must be 'r', 'g' and 'b'"
        else:
            self.params["colors"] = [colors[k] for k in "rgb"]

    def _number_choices(self) -> Iterator[str]:
        """Turn operation and distribution into the codes that functions take; yields problems."""
        for key, numbers in _NUMBERS.items():
            choice = self.params.get(key)
            if key in self._func.input_types and isinstance(choice, str):
                if choice not in numbers:
                    yield f"{key}: is '{choice}', must be one of {', '.join(numbers)}"
                self.params[key] = numbers.get(choice, 0)

    # -- structs and shapes

    def _find_structs(self) -> None:
        """Make the structs that the term takes, and add their names to its parameters."""
        usage = usage_of(self._func)
        for name, kind in self._func.input_types.items():
            if kind in MODEL_FIELDS:
                owner = self._owner(kind)
                if owner != SCENE:
                    self._context.asset(self._cfg.name)
                self._structs.get(kind, owner, struct_fields(kind) if usage.unresolved else usage.reads | usage.writes)
                self.params.setdefault(name, owner)
            elif kind is EncoderData:
                self._context.entity(self._cfg.name)
                self.params.setdefault(name, self._cfg.name)
                encoders: Mapping[str, Any] = self._context.structs.named(EncoderData).structs
                if self._cfg.name not in encoders:
                    raise ValueError(f"'{self._cfg.name}' has no joint encoders, must be an articulation")
                self._context.arrays[f"encoder.{self._cfg.name}.bias"] = encoders[self._cfg.name].bias

    def _owner(self, kind: Struct) -> str:
        return self._cfg.name if kind in (BodyModelData, JointModelData) else SCENE

    def _shapes(self) -> list[int]:
        """Indices of the shapes in an environment that belong to the chosen bodies and are of the right kind."""
        template, cfg, kind = self._context.scene.sim.template, self._cfg, self._info.shapes
        asset = self._context.asset(cfg.name)
        if cfg.chooses("joint") and not cfg.chooses("body"):
            raise ValueError(f"the event changes shapes of bodies of '{cfg.name}', choose them by body_names")
        bodies = {asset.layout.bodies[i] for i in cfg.indices("body", asset.layout.body_names)}
        wanted = _SHAPE_FLAGS.get(kind, newton.ShapeFlags.COLLIDE_SHAPES)
        shapes = [i for i, b in enumerate(template.shape_body) if b in bodies and template.shape_flags[i] & wanted]
        if kind == "primitives":
            shapes = [i for i in shapes if int(template.shape_type[i]) in _PRIMITIVES]
        if not shapes:
            raise ValueError(f"these bodies of '{cfg.name}' have no {kind or 'colliders'}")
        names = self.params.get("shape_names")
        if names is not None:
            labels = [template.shape_label[i].rsplit("/", 1)[-1] for i in shapes]
            shapes = [shapes[i] for i in match_names(names, labels, what=f"shape of '{cfg.name}'")[0]]
        return shapes

    # -- checks

    def _range_problems(self) -> Iterator[str]:
        """Problems of the ranges, each as ``parameter: text``."""
        kind, sim = next(t for t in self._func.input_types.values() if t in _KINDS), self._context.scene.sim
        for name, (field, bound) in self._info.ranges.items():
            if name not in self.params:
                continue
            wrong = list(range_problems(self.params, name, bound))
            yield from (f"{name}: {text}" for text in wrong)
            if wrong or not field or _is_kept(self.params[name]):
                continue
            ids, dofs = self._indices(kind)
            for text in solver_problems(sim, kind, field, dofs):
                yield f"{name}: {text}"
            scales = self.params.get("operation") == OPERATIONS["scale"]
            if scales and not self._structs.default(kind, self._owner(kind), field, ids).any():
                yield f"{name}: scales '{field}', which is 0 there: use operation 'add' or 'abs'"

    def _indices(self, kind: Struct) -> tuple[list[int], list[int]]:
        """Indices of the chosen bodies, joints or shapes, and for joints their degrees of freedom in an environment."""
        if kind is ShapeModelData:
            return self.params["shape_ids"], []
        layout = self._context.asset(self._cfg.name).layout
        if kind is BodyModelData:
            return self._cfg.indices("body", layout.body_names), []
        if not layout.joint_names:
            raise ValueError(f"'{self._cfg.name}' has no joints")
        ids = self._cfg.indices("joint", layout.joint_names)
        return ids, [layout.dofs[i] for i in ids]


def _is_kept(pair: object) -> bool:
    """Whether a range is ``KEEP``, so that the quantity is not changed."""
    return isinstance(pair, Iterable) and all(isinstance(x, float) and math.isnan(x) for x in pair)
