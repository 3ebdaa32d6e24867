# SPDX-License-Identifier: Apache-2.0
"""Base of the solver configs: makes a Newton solver of the fields, and says what that solver does."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar

import newton

from stripe_newton.configclass import configclass

__all__ = ["SolverCfg"]


@configclass
class SolverCfg:
    """Base of the solver configs."""

    solver_class: ClassVar[str] = ""
    """Name of the class in :mod:`newton.solvers`."""

    reduced_coordinates: ClassVar[bool] = True
    """Whether a step writes ``joint_q`` and ``joint_qd``; if not they are recovered from the bodies after it."""

    in_place: ClassVar[bool] = False
    """Whether ``step(state, state, ...)`` gives the same result as two states do, so that no second one is needed."""

    own_fields: ClassVar[frozenset[str]] = frozenset()
    """Fields that are no arguments of the solver."""

    @property
    def newton_class(self) -> type[newton.solvers.SolverBase]:
        """The solver's class."""
        return getattr(newton.solvers, self.solver_class)

    def register(self, builder: newton.ModelBuilder) -> None:
        """Declare the solver's custom attributes, so that importers fill them."""
        self.newton_class.register_custom_attributes(builder)

    def create(self, model: newton.Model, observables: Sequence[str] = ()) -> newton.solvers.SolverBase:
        """Make the solver for ``model``.

        Args:
            model: The model.
            observables: Arrays that it is going to be asked for beyond the state, by Newton's names.
        """
        return self.newton_class(model, **self.arguments())

    def arguments(self) -> dict[str, Any]:
        """The keyword arguments given to the solver: those that are not ``None``."""
        fields = ((f.name, getattr(self, f.name)) for f in dataclasses.fields(self) if f.name not in self.own_fields)
        return {name: value for name, value in fields if value is not None}

    @property
    def kind(self) -> str:
        """The solver's name in lower case: ``"mujoco"``, ``"xpbd"``, ..."""
        return self.solver_class.removeprefix("Solver").lower()

    @property
    def finds_contacts(self) -> bool:
        """Whether the solver detects collisions itself; if not, Newton's collision pipeline does."""
        return False

    @property
    def chooses_contacts(self) -> bool:
        """Whether the triangles of concave static meshes collide, rather than the hulls that MuJoCo takes."""
        return False

    def expects_newton_contacts(self, builder: newton.ModelBuilder) -> bool:
        """Whether contacts are Newton's, or probably will be once the solver has chosen."""
        return not self.finds_contacts

    @property
    def uses_mujoco_warp(self) -> bool:
        """Whether MuJoCo Warp computes the physics, so that its model and data lie on the device."""
        return False

    @property
    def limits_drives(self) -> bool:
        """Whether the effort limits of drives are set on MuJoCo's actuators, see :class:`DriveLimits`."""
        return False

    def problems(self) -> Iterator[tuple[str, str]]:
        return iter(())
