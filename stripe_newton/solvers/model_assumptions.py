# SPDX-License-Identifier: Apache-2.0
"""Model assumptions: what the fused step takes for given about a model's arrays, and whether it still holds.

A launch reads parameters that all worlds share from the first world, no reference coordinates where all are zero, and
no anchors of free joints and balls where all are at the bodies' origins. These are addresses in the launch arguments,
so that graphs which were recorded with them must be recorded again when an assumption falls.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import newton
import numpy as np
import warp as wp

from .shared_parameters import (
    SharedParameters,
    parameter_arrays,
    parameters_of_flags,
    parameters_of_newton,
    places_of_springs,
)  # fmt: skip

__all__ = ["ModelAssumptions"]

_AT_ORIGIN = np.array([0, 0, 0, 0, 0, 0, 1])
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
        self._solver, self._model = solver, model
        self.shared = SharedParameters(lambda: parameter_arrays(solver), lambda: places_of_springs(solver.mj_model))
        self._compares_worlds, self._has_references, self._has_anchors = True, True, True

    @property
    def references(self) -> wp.array | None:
        """Reference coordinates of the joints, shape ``(joint_dof_count,)``; None if all are zero, as mostly."""
        return self._reference_array if self._has_references else None

    @property
    def _reference_array(self) -> wp.array | None:
        return getattr(getattr(self._model, "mujoco", None), "dof_ref", None)

    @property
    def anchors(self) -> tuple[wp.array | None, wp.array | None]:
        """Anchors of the joints in parents and children, ``wp.transform``, shape ``(joint_count,)``; None if those that
        the kernel looks at are no other places than the bodies' origins."""
        return (self._model.joint_X_p, self._model.joint_X_c) if self._has_anchors else (None, None)

    def find(self) -> None:
        """Find out what holds. It waits for the device, and so does nothing while a graph is recorded."""
        self.shared.find()
        self._find_references()
        self._find_anchors()

    def expect_changes(self, names: Iterable[str]) -> bool:
        """Assume nothing more of what follows from some arrays of Newton's model.

        Returns:
            Whether anything was assumed.
        """
        names = set(names)
        is_stale = self.shared.expect_changes(parameters_of_newton(names))
        if not self._has_anchors and names & {"joint_X_p", "joint_X_c"}:
            self._has_anchors = is_stale = True
        return is_stale

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
        if has_kernel and flags & newton.ModelFlags.JOINT_PROPERTIES:
            is_stale = self._find_anchors() or is_stale
        return is_stale

    def _find_references(self) -> bool:
        """Find out whether any joint has a reference coordinate; return whether that has changed."""
        references, had = self._reference_array, self._has_references
        if references is not None and not references.device.is_capturing:
            self._has_references = bool(np.any(references.numpy()))
        return self._has_references != had

    def _find_anchors(self) -> bool:
        """Find out whether free joints and balls have anchors of their own; return whether that has changed."""
        had, model = self._has_anchors, self._model
        if model.device.is_capturing or model.joint_count == 0:
            return False
        turning = np.isin(model.joint_type.numpy(), (int(newton.JointType.FREE), int(newton.JointType.BALL)))
        anchors = np.concatenate([a.numpy()[turning] for a in (model.joint_X_p, model.joint_X_c)])
        # Mocap bodies are where the anchors of fixed joints say.
        self._has_anchors = self._solver.mj_model.nmocap > 0 or bool(np.any(anchors != _AT_ORIGIN))
        return self._has_anchors != had
