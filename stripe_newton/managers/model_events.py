# SPDX-License-Identifier: Apache-2.0
"""Model events: event terms that change the model, and the items that tell the solver of their changes."""

from __future__ import annotations

from functools import partial

import warp as wp

from stripe_newton.fusion import Captured, Code, Item, Section, code
from stripe_newton.sim.mass_tree import MassConstants
from stripe_newton.sim.model_update import ModelUpdate, model_flags

from .context import ManagerContext
from .event_cfg import EventTermCfg
from .model_data import MODEL_FIELDS, ModelStructs
from .model_term import ModelTerm, changes_model

__all__ = ["ModelEvents"]


class ModelEvents:
    """Prepares Warp terms that take structs of :mod:`stripe_kernels.model_data`, and tells the solver what they did.

    A mask gathers the environments in which a term of a mode ran. After the terms of the mode the solver takes over
    what changed in those environments, all at once, by kernels that are part of the step's graph.
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
        """The parameters of a term as its function takes them, or None after problems were added.

        Args:
            path: Path of the term, such as ``events.mass``.
            term: The term.
            func: Its function.
        """
        found = ModelTerm(self._context, self._structs, func, term.params)
        problems = found.problems()
        self._context.problems += [f"{path}.params.{text}" for text in problems]
        if problems:
            return None
        self._changed.setdefault(term.mode, set()).update(found.writes())
        return found.params

    # -- items

    def mark(self, func: wp.Function) -> list[Code]:
        """Lines after the call of a term: the solver is to be told of this environment."""
        if not any(t in MODEL_FIELDS for t in func.input_types.values()):
            return []
        return [code("{}[env] = True", self._mask_name())]

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
        sim = self._context.scene.sim
        if mode == "startup":
            return [*items, Captured("solver told of the model", partial(sim.notify, model_flags(names)))]
        update = ModelUpdate(sim, names, self._constants)
        if update.constants is not None:
            self._constants = update.constants
            self._context.arrays["model.touched"] = self._constants.touched
        title = f"solver told of {', '.join(sorted(names))}"
        title += f", in all worlds: {update.obstacle}" if update.obstacle else ""
        # Beside what follows: the next to read the solver's model is the physics of the next step, or the next mode.
        beside = last and not update.obstacle
        tell = Captured(title, partial(update.launch, self._mask()), beside=beside, fields=frozenset())
        return [Section("events_model", [code("{}[env] = False", self._mask_name())]), *items, tell]

    def _mask(self) -> wp.array:
        return self._context.array("events.model_changed", wp.bool)

    def _mask_name(self) -> Code:
        return self._context.scope.name("model_changed", self._mask())
