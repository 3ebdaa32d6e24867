# SPDX-License-Identifier: Apache-2.0
"""Shared parameters: finds the model arrays that are equal in all worlds, of which the kernel reads one row.

A model with a world for each environment has all its arrays by world, about 7 KB of them for a quadruped. Those of
thousands of worlds fit in no cache of a GPU, and reading them would take longer than computing with them. Mostly few of
them differ: what events randomise. The others are read from the first world, and stay in the cache nearest to the
threads.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import mujoco
import newton
import numpy as np
import torch
import warp as wp

from .model_tables import PARAMETERS

__all__ = [
    "SharedParameters", "parameter_arrays", "parameters_of_flags", "parameters_of_newton", "places_of_springs",
]  # fmt: skip

_WEIGHTS = frozenset({"weight", "dof_weight", "solref_limit", "bias"})
"""Numbers that follow from masses and armatures: inverse weights, stiffness of limits, damping of drives."""
_BODIES = frozenset({"mass", "com", "inertia", "inertia_quat", "gravcomp"}) | _WEIGHTS
_JOINTS = _WEIGHTS | {
    "body_pos", "body_quat", "joint_pos", "joint_axis", "spring", "qpos0", "range", "limit_margin", "solimp_limit",
    "loss", "damping", "armature", "stiffness", "solref_loss", "solimp_loss", "joint_force", "gain", "bias", "gear",
    "ctrl_range", "force_range",
}  # fmt: skip
_SHAPES = frozenset({
    "geom_pos", "geom_quat", "geom_size", "geom_friction", "geom_margin", "geom_solmix", "geom_solref", "geom_solimp",
    "pair_margin", "pair_solref", "pair_solreffriction", "pair_solimp", "pair_friction", "site_pos", "site_quat",
})  # fmt: skip
_OTHERS = frozenset({"gravity", "timestep", "equality", "solref_equality", "solimp_equality"})
_ALL = _BODIES | _JOINTS | _SHAPES | _OTHERS
_OF_NEWTON: dict[str, frozenset[str]] = {
    "gravity": frozenset({"gravity"}),
    "joint_friction": frozenset({"loss"}),
    "joint_damping": frozenset({"damping"}),
    "joint_armature": _WEIGHTS | {"armature"},
    "joint_stiffness": frozenset({"stiffness"}),
    "joint_limit_lower": frozenset({"range"}),
    "joint_limit_upper": frozenset({"range"}),
    "joint_effort_limit": frozenset({"joint_force", "force_range"}),
    "joint_target_ke": frozenset({"gain", "bias"}),
    "joint_target_kd": frozenset({"gain", "bias", "damping"}),
    "shape_material_mu": frozenset({"geom_friction", "pair_friction"}),
    "shape_material_mu_torsional": frozenset({"geom_friction", "pair_friction"}),
    "shape_material_mu_rolling": frozenset({"geom_friction", "pair_friction"}),
    "shape_transform": frozenset({"geom_pos", "geom_quat"}),
    "shape_scale": frozenset({"geom_pos", "geom_quat", "geom_size"}),
    "shape_gap": frozenset({"geom_margin", "pair_margin"}),
    "shape_margin": frozenset({"geom_margin", "pair_margin"}),
}
"""Parameters that follow from arrays of Newton's model; of other arrays see :func:`parameters_of_newton`."""


_FLAGS = newton.ModelFlags
_OF_FLAGS: dict[newton.ModelFlags, frozenset[str]] = {
    _FLAGS.BODY_INERTIAL_PROPERTIES: _BODIES,
    _FLAGS.SHAPE_PROPERTIES: _SHAPES,
    _FLAGS.MODEL_PROPERTIES: frozenset({"gravity"}),
    _FLAGS.JOINT_PROPERTIES: _JOINTS,
    _FLAGS.JOINT_DOF_PROPERTIES: _JOINTS,
    _FLAGS.JOINT_DOF_FORCE_PROPERTIES: _JOINTS,
    _FLAGS.JOINT_DOF_INERTIAL_PROPERTIES: _JOINTS,
    _FLAGS.JOINT_REFERENCE_POSE_PROPERTIES: _JOINTS,
    _FLAGS.ACTUATOR_PROPERTIES: _JOINTS,
}
"""Parameters that follow from what Newton's flags name; any flag that is not here may mean all of them."""


def parameter_arrays(solver: newton.solvers.SolverMuJoCo) -> dict[str, wp.array]:
    """The arrays of MuJoCo Warp's model and data that the kernel reads parameters from, by their names in the kernel.

    Args:
        solver: The solver that owns the model.
    """
    owners = {"": solver.mjw_model, "opt": solver.mjw_model.opt, "data": solver.mjw_data}
    paths = {name: path.rpartition(".") for name, path in PARAMETERS.items()}
    return {name: getattr(owners[owner], field) for name, (owner, _, field) in paths.items()}


def places_of_springs(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Places that the kernel reads in arrays with a number for each coordinate: those of hinges and slides.

    Free bodies are at another place in each world, as their worlds lie side by side.
    """
    single = np.isin(model.jnt_type, (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE))
    return dict.fromkeys(("qpos0", "spring"), model.jnt_qposadr[single])


def parameters_of_newton(names: Iterable[str]) -> frozenset[str]:
    """Parameters that may change with arrays of Newton's model.

    Args:
        names: Names of attributes of ``newton.Model``.
    """
    groups = {"body_": _BODIES, "joint_": _JOINTS, "shape_": _SHAPES}
    found = [_OF_NEWTON.get(n) or next((g for p, g in groups.items() if n.startswith(p)), _ALL) for n in names]
    return frozenset().union(*found)


def parameters_of_flags(flags: newton.ModelFlags | int) -> frozenset[str]:
    """Parameters that may change with the properties that flags name.

    Args:
        flags: As for ``SolverBase.notify_model_changed``.
    """
    found, left = frozenset[str](), int(flags)
    for flag, parameters in _OF_FLAGS.items():
        if left & int(flag):
            found |= parameters
            left &= ~int(flag)
    return _ALL if left else found


class SharedParameters:
    """The parameters of which all worlds have the same, as far as is known.

    Attributes:
        names: Their names, as in the source of the kernel.
    """

    def __init__(
        self,
        arrays: Callable[[], Mapping[str, wp.array]],
        places: Callable[[], Mapping[str, np.ndarray]] = dict,
    ):
        """Know of none yet.

        Args:
            arrays: Returns the arrays of the parameters, whose first dimension is the world.
            places: Returns which of a world's numbers are read, of arrays of which that is not all.
        """
        self._arrays, self._places = arrays, places
        self._varying: frozenset[str] = frozenset()
        self.names: frozenset[str] = frozenset()

    def find(self) -> None:
        """Compare the worlds. It waits for the device, and so does nothing while a graph is recorded."""
        arrays = self._arrays()
        if not any(a.device.is_capturing for a in arrays.values()):
            places, asked = self._places(), _ALL - self._varying
            self.names = frozenset(n for n, a in arrays.items() if n in asked and _is_shared(a, places.get(n)))

    def expect_changes(self, parameters: frozenset[str]) -> bool:
        """Share some parameters no more, as they may differ from now on.

        Returns:
            Whether any were shared: graphs that were recorded before read those of one world.
        """
        self._varying |= parameters
        lost = self.names & parameters
        self.names -= parameters
        return bool(lost)

    def check(self, parameters: frozenset[str]) -> bool:
        """Compare the worlds again in some parameters, which may have changed.

        Returns:
            Whether any are shared no more.
        """
        arrays, places = self._arrays(), self._places()
        asked = parameters & self.names
        return self.expect_changes(frozenset(n for n in asked if not _is_shared(arrays[n], places.get(n))))


def _is_shared(array: wp.array, places: np.ndarray | None) -> bool:
    """Whether an array has equal numbers for all worlds, at some places of their rows or at all."""
    if array.shape[0] < 2 or array.size == 0:
        return False
    rows = wp.to_torch(array).reshape(array.shape[0], -1)
    if places is not None:
        rows = rows[:, torch.as_tensor(places, device=rows.device, dtype=torch.long)]
    return bool((rows == rows[:1]).all())
