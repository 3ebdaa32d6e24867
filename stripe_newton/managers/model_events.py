# SPDX-License-Identifier: Apache-2.0
"""Model events: event terms that change the model, and the items that pass their changes to the solver."""

from __future__ import annotations

import warnings
from functools import partial

import warp as wp

from stripe_newton.fusion import Code, Item, KernelLaunches, Section, code
from stripe_newton.sim.mass_constants import MassConstants
from stripe_newton.sim.model_update import ModelUpdate, model_flags

from .context import ManagerContext
from .event_cfg import EventTermCfg
from .model_data import MODEL_FIELDS, ModelStructs
from .model_term import ModelTerm, changes_model

__all__ = ["ModelEvents"]


class ModelEvents:
    """Prepares Warp terms with structs of :mod:`stripe_kernels.model_data`, and passes their changes to the solver.

    A mask marks the environments in which a term of a mode ran. After all terms of the mode, the solver's copy of the
    model is updated in these environments, by kernels that are part of the step's graph.
    """

    def __init__(self, context: ManagerContext):
        self._context, self._structs = context, ModelStructs(context)
        self._changed: dict[str, set[str]] = {}
        self._constants: MassConstants | None = None

    @staticmethod
    def concerns(func: object) -> bool:
        """Whether a term changes the model."""
        return changes_model(func)

    def resolve(self, path: str, term: EventTermCfg, func: wp.Function) -> dict[str, object] | None:
        """The parameters of a term as its function takes them; None if problems have been added to the context.

        Args:
            path: Path of the term, such as ``events.mass``.
            term: The term.
            func: Its function.
        """
        found = ModelTerm(self._context, self._structs, func, term.params)
        for text in found.without_effect():
            warnings.warn(f"{path}.params.{text}", stacklevel=2)
        problems = found.problems()
        self._context.problems += [f"{path}.params.{text}" for text in problems]
        if problems:
            return None
        self._changed.setdefault(term.mode, set()).update(found.writes())
        return found.params

    # -- items

    def mark(self, func: wp.Function) -> list[Code]:
        """Lines after the call of a term that mark the environment for the update of the solver."""
        if not any(t in MODEL_FIELDS for t in func.input_types.values()):
            return []
        return [code("{}[env] = True", self._mask_name())]

    def complete(self, mode: str, items: list[Item], last: bool = False) -> list[Item]:
        """The items of a mode, followed by the update of the solver.

        Args:
            mode: The mode.
            items: Its items.
            last: Whether no later mode changes the model in the same step.
        """
        names = self._changed.get(mode)
        if not names:
            return items
        sim = self._context.scene.sim
        if mode == "startup":
            return [*items, KernelLaunches("solver told of the model", partial(sim.notify, model_flags(names)))]
        update = ModelUpdate(sim, names, self._constants)
        if update.constants is not None:
            self._constants = update.constants
            self._context.arrays["model.touched"] = self._constants.touched
        title = f"solver told of {', '.join(sorted(names))}"
        title += f", in all worlds: {update.why_all_worlds}" if update.why_all_worlds else ""
        # It may run beside the items that follow: only the physics of the next step, or the next mode that changes the
        # model, uses the solver's copy.
        concurrent = last and not update.why_all_worlds
        tell = KernelLaunches(title, partial(update.launch, self._mask()), concurrent=concurrent, fields=frozenset())
        return [Section("events_model", [code("{}[env] = False", self._mask_name())]), *items, tell]

    def _mask(self) -> wp.array:
        return self._context.array("events.model_changed", wp.bool)

    def _mask_name(self) -> Code:
        return self._context.scope.name("model_changed", self._mask())
