# SPDX-License-Identifier: Apache-2.0
"""Events that change the model: what their terms get, and how the solver is told."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

import newton
import warp as wp

from stripe_kernels.mdp import (
    randomization_bodies,
    randomization_encoder,
    randomization_joints,
    randomization_scene,
    randomization_shapes,
)
from stripe_kernels.mdp.randomization import DISTRIBUTIONS, KEEP, OPERATIONS, Randomization
from stripe_kernels.model_data import BodyModelData, EncoderData, JointModelData, ShapeModelData
from stripe_newton.fusion import Captured, Item, SceneEntityCfg, Section, fields_read
from stripe_newton.matching import match_names
from stripe_newton.sim.mass_constants import MassConstants
from stripe_newton.sim.model_update import ModelUpdate, model_flags

from .event_cfg import EventTermCfg
from .model_checks import range_problems, solver_problems
from .model_data import MODEL_FIELDS, SCENE, ModelStructs

if TYPE_CHECKING:
    from .context import ManagerContext

__all__ = ["ModelEvents"]

_SPECS: dict[Any, Randomization] = {
    getattr(module, name): spec
    for module, specs in (
        (randomization_bodies, randomization_bodies.BODY_RANDOMIZATIONS),
        (randomization_encoder, randomization_encoder.ENCODER_RANDOMIZATIONS),
        (randomization_joints, randomization_joints.JOINT_RANDOMIZATIONS),
        (randomization_scene, randomization_scene.SCENE_RANDOMIZATIONS),
        (randomization_shapes, randomization_shapes.SHAPE_RANDOMIZATIONS),
    )
    for name, spec in specs.items()
}
_KINDS = (*MODEL_FIELDS, EncoderData)
_CODES = {"operation": OPERATIONS, "distribution": DISTRIBUTIONS}
_PRIMITIVES = {int(getattr(newton.GeoType, n)) for n in ("SPHERE", "CAPSULE", "CYLINDER", "ELLIPSOID", "BOX")}


class ModelEvents:
    """Prepares Warp terms that take structs of :mod:`stripe_kernels.model_data`, and tells the solver what they did."""

    def __init__(self, context: ManagerContext):
        self._context, self._structs = context, ModelStructs(context)
        self._changed: dict[str, set[str]] = {}
        self._constants: MassConstants | None = None

    @staticmethod
    def concerns(func: Any) -> bool:
        """Whether a term changes the model."""
        return isinstance(func, wp.Function) and any(t in _KINDS for t in func.input_types.values())

    # -- terms

    def resolve(self, path: str, term: EventTermCfg) -> dict[str, Any] | None:
        """The parameters of a term as its function takes them, or None after problems were added.

        Args:
            path: Path of the term, such as ``events.mass``.
            term: The term.
        """
        func: Any = term.func
        spec = _SPECS.get(func, Randomization())
        params: dict[str, Any] = {
            k: KEEP if v is None and k in spec.ranges else v for k, v in {**spec.defaults, **term.params}.items()
        }
        for ignored in spec.ignored:
            params.pop(ignored, None)
        problems = _give_channels(params) if "colors" in func.input_types else []
        for key, numbers in _CODES.items():
            if key in func.input_types and isinstance(params.get(key), str):
                if params[key] not in numbers:
                    problems.append(f"{key}: is '{params[key]}', must be one of {', '.join(numbers)}")
                params[key] = numbers.get(str(params[key]), 0)
        try:
            self._find(func, params)
            if not problems:
                problems += self._wrong(func, spec, params)
        except (KeyError, ValueError) as error:
            problems.append(f"asset_cfg: {error.args[0]}")
        self._context.problems += [f"{path}.params.{text}" for text in problems]
        if problems:
            return None
        self._changed.setdefault(term.mode, set()).update(self._writes(func, spec, params))
        return {k: v for k, v in params.items() if k != "shape_names"}

    def _find(self, func: Any, params: dict[str, Any]) -> None:
        """Provide the structs that a term takes, and name them and its shapes in its parameters."""
        read = fields_read(func)
        self._cfg = cfg = _entity_cfg(params, self._context)
        for name, kind in func.input_types.items():
            if kind in MODEL_FIELDS:
                owner = cfg.name if kind in (BodyModelData, JointModelData) else SCENE
                if owner == cfg.name and not hasattr(self._context.entity(owner), "layout"):
                    raise ValueError(f"'{owner}' is a sensor, must be an articulation or a rigid object")
                self._structs.get(kind, owner, read)
                params.setdefault(name, owner)
            elif kind is EncoderData:
                self._context.entity(cfg.name)
                params.setdefault(name, cfg.name)
                bias = self._context.provided.get(EncoderData, {}).get(cfg.name)
                if bias is None:
                    raise ValueError(f"'{cfg.name}' has no joint encoders, must be an articulation")
                self._context.arrays[f"encoder.{cfg.name}.bias"] = bias.bias
        if "shape_ids" in func.input_types and "shape_ids" not in params:
            params["shape_ids"] = self._shapes(_SPECS.get(func, Randomization()).shapes, params.get("shape_names"))

    def _shapes(self, kind: str, names: Any) -> list[int]:
        """Shapes of an environment that belong to the bodies meant."""
        template, asset, cfg = self._context.scene.sim.template, self._context.entity(self._cfg.name), self._cfg
        if not hasattr(asset, "layout"):
            raise ValueError(f"'{cfg.name}' is a sensor, must be an articulation or a rigid object")
        if cfg.chooses("joint") and not cfg.chooses("body"):
            raise ValueError(f"the event is about the colliders of bodies of '{cfg.name}', choose by body_names")
        bodies = {asset.layout.bodies[i] for i in cfg.indices("body", asset.layout.body_names)}
        flags = newton.ShapeFlags
        wanted = {"sites": flags.SITE, "visible shapes": flags.VISIBLE}.get(kind, flags.COLLIDE_SHAPES)
        shapes = [i for i, b in enumerate(template.shape_body) if b in bodies and template.shape_flags[i] & wanted]
        if kind == "primitives":
            shapes = [i for i in shapes if int(template.shape_type[i]) in _PRIMITIVES]
        if not shapes:
            raise ValueError(f"these bodies of '{cfg.name}' have no {kind or 'colliders'}")
        if names is not None:
            labels = [template.shape_label[i].rsplit("/", 1)[-1] for i in shapes]
            shapes = [shapes[i] for i in match_names(names, labels, what=f"shape of '{cfg.name}'")[0]]
        return shapes

    def _wrong(self, func: Any, spec: Randomization, params: dict[str, Any]) -> Iterator[str]:
        """What is wrong with the ranges of a term whose structs were found."""
        kind = next(t for t in func.input_types.values() if t in _KINDS)
        for name, (field, bound) in spec.ranges.items():
            if name not in params:
                continue
            wrong = list(range_problems(params, name, bound))
            yield from (f"{name}: {text}" for text in wrong)
            if wrong or not field or _is_kept(params[name]):
                continue
            ids, dofs = self._ids(kind, params)
            yield from (
                f"{name}: {text}"
                for text in solver_problems(self._context.scene.sim, kind, field, dofs, max(params[name]))
            )
            owner = SCENE if kind is ShapeModelData else self._cfg.name
            scales = params.get("operation") == OPERATIONS["scale"]
            if scales and not self._structs.default(kind, owner, field, ids).any():
                yield f"{name}: scales '{field}', which is 0 there: use operation 'add' or 'abs'"

    def _ids(self, kind: Any, params: dict[str, Any]) -> tuple[list[int], list[int]]:
        """Bodies, joints or shapes meant, and for joints the degrees of freedom in an environment."""
        if kind is ShapeModelData:
            return params["shape_ids"], []
        layout = self._context.entity(self._cfg.name).layout
        if kind is BodyModelData:
            return self._cfg.indices("body", layout.body_names), []
        if not layout.joint_names:
            raise ValueError(f"'{self._cfg.name}' has no joints")
        ids = self._cfg.indices("joint", layout.joint_names)
        return ids, [layout.dofs[i] for i in ids]

    @staticmethod
    def _writes(func: Any, spec: Randomization, params: dict[str, Any]) -> set[str]:
        """Arrays of the model that a term may write and the solver reads."""
        read = fields_read(func)
        kept = {field for name, (field, _) in spec.ranges.items() if name in params and _is_kept(params[name])}
        kinds = [k for k in func.input_types.values() if k in MODEL_FIELDS]
        found = {array for k in kinds for field, array in MODEL_FIELDS[k].items() if field in read - kept}
        return found - {"shape_color"}  # which solvers do not look at

    # -- items

    def mark(self, func: Any) -> list[str]:
        """Lines after the call of a term: the solver is to be told."""
        if not self.concerns(func) or not any(t in MODEL_FIELDS for t in func.input_types.values()):
            return []
        return [f"{self._mask()}[env] = True"]

    def complete(self, mode: str, items: list[Item], last: bool = False) -> list[Item]:
        """The items of a mode, with what tells the solver.

        Args:
            mode: The mode.
            items: Its items.
            last: Whether no other mode changes the model in the same step after it.
        """
        names = self._changed.get(mode)
        if not names:
            return items
        sim, mask = self._context.scene.sim, self._context.array("events.model_changed", wp.bool)
        if mode == "startup":
            return [*items, Captured("solver told of the model", partial(sim.notify, model_flags(names)))]
        update = ModelUpdate(sim, names, self._constants)
        if update.constants is not None:
            self._constants = update.constants
            self._context.arrays["model.touched"] = self._constants.touched
        title = f"solver told of {', '.join(sorted(names))}"
        title += f", in all worlds: {update.why_all_worlds}" if update.why_all_worlds else ""
        tell = Captured(title, partial(update.launch, mask), beside=last and not update.why_all_worlds)
        return [Section("events_model", [f"{self._mask()}[env] = False"]), *items, tell]

    def _mask(self) -> str:
        return self._context.scope.name("model_changed", self._context.array("events.model_changed", wp.bool))


def _entity_cfg(params: dict[str, Any], context: ManagerContext) -> SceneEntityCfg:
    given = params.get("asset_cfg")
    if isinstance(given, SceneEntityCfg):
        cfg = given
    else:
        there = context.entity_names()
        default = "robot" if "robot" in there or len(there) != 1 else there[0]
        cfg = SceneEntityCfg(given if isinstance(given, str) else default)
    params["asset_cfg"] = cfg
    return cfg


def _give_channels(params: dict[str, Any]) -> list[str]:
    """Colours by channel as a list; what is wrong with them."""
    colors = params.get("colors")
    if not isinstance(colors, Mapping):
        return []
    wrong = sorted(colors.keys() ^ {"r", "g", "b"})
    if wrong:
        return [f"colors: {', '.join(map(repr, wrong))} too many or missing, keys must be 'r', 'g' and 'b'"]
    params["colors"] = [colors[k] for k in "rgb"]
    return []


def _is_kept(pair: Any) -> bool:
    return isinstance(pair, Iterable) and all(isinstance(x, float) and math.isnan(x) for x in pair)
