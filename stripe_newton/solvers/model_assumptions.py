# SPDX-License-Identifier: Apache-2.0
"""Model assumptions: what the fused step takes for given about a model's arrays, and whether it still holds.

A launch reads parameters that all worlds share from the first world, and no reference coordinates where all are zero.
Both are addresses in the launch arguments, so that graphs which were recorded with them must be recorded again when
an assumption falls.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import newton
import numpy as np
import warp as wp

from .shared_parameters import SharedParameters, parameter_arrays, parameters_of_flags, parameters_of_newton

__all__ = ["ModelAssumptions"]

_JOINT_FLAGS = newton.ModelFlags.JOINT_DOF_PROPERTIES | newton.ModelFlags.JOINT_REFERENCE_POSE_PROPERTIES


class ModelAssumptions:
    """Assumptions about the model of a solver.

    Attributes:
        shared: Parameters that are the same in all worlds.
    """

    def __init__(self, solver: newton.solvers.SolverMuJoCo, model: newton.Model):
        """Assume nothing yet.

        Args:
            solver: The solver, which may not be constructed yet.
            model: Its model.
        """
        self._model = model
        self.shared = SharedParameters(lambda: parameter_arrays(solver))
        self._compares_worlds, self._has_references = True, True

    @property
    def references(self) -> wp.array | None:
        """Reference coordinates of the joints, shape ``(joint_dof_count,)``; None if all are zero, as mostly."""
        return self._reference_array if self._has_references else None

    @property
    def _reference_array(self) -> wp.array | None:
        return getattr(getattr(self._model, "mujoco", None), "dof_ref", None)

    def find(self) -> None:
        """Find out what holds. It waits for the device, and so does nothing while a graph is recorded."""
        self.shared.find()
        self._find_references()

    def expect_changes(self, names: Iterable[str]) -> bool:
        """Assume no more that worlds are the same in what follows from some arrays of Newton's model.

        Returns:
            Whether they were assumed to be.
        """
        return self.shared.expect_changes(parameters_of_newton(names))

    @contextmanager
    def changes_expected(self) -> Iterator[None]:
        """Context for changes that :meth:`expect_changes` knows of: :meth:`check` does not compare worlds."""
        self._compares_worlds = False
        try:
            yield
        finally:
            self._compares_worlds = True

    def check(self, flags: newton.ModelFlags | int, has_kernel: bool) -> bool:
        """Check what may have changed with the model.

        A recording can read nothing back, so nothing is checked in one: what it changes is known from
        :meth:`expect_changes`.

        Args:
            flags: As for ``SolverBase.notify_model_changed``.
            has_kernel: Whether a kernel has been made, so that reference coordinates have been looked at.

        Returns:
            Whether graphs that were recorded before are stale.
        """
        if not self._compares_worlds or self._model.device.is_capturing:
            return False
        is_stale = self.shared.check(parameters_of_flags(flags))
        if has_kernel and flags & _JOINT_FLAGS:
            is_stale = self._find_references() or is_stale
        return is_stale

    def _find_references(self) -> bool:
        """Find out whether any joint has a reference coordinate; return whether that has changed."""
        references, had = self._reference_array, self._has_references
        if references is not None and not references.device.is_capturing:
            self._has_references = bool(np.any(references.numpy()))
        return self._has_references != had
