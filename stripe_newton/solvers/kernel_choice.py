# SPDX-License-Identifier: Apache-2.0
"""Kernel choice: which form and which options the fused step's kernel has for a model and for what is read of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import newton
import numpy as np

from .kernel_buffers import KernelBuffers
from .limb_form import LimbForm, why_no_limbs
from .model_tables import ModelTables
from .newton_layout import NewtonLayout
from .pair_division import PairDivision
from .step_kernel import KernelOptions, has_few_worlds

__all__ = ["KernelChoice"]

_LANES = 8, 32
"""Threads of a GPU that share a world: of a model that has no more bodies and degrees of freedom, and of others."""


@dataclass(frozen=True)
class KernelChoice:
    """Choice of a kernel. What a kernel can do beside advancing the state costs registers, so it has only what is used.

    There are two forms of the step: a general one, and one for a hub with limbs (:class:`.limb_form.LimbForm`), which
    is faster on a GPU for most legged robots and lacks some features.
    """

    solver: newton.solvers.SolverMuJoCo
    division: PairDivision
    """The pairs of geoms whose contacts the kernel finds."""
    buffers: KernelBuffers
    """Memory of the kernel, which is there for what somebody reads."""
    newton_layout: NewtonLayout | None
    """Where Newton has joints, bodies and controls, if the kernel reads and writes its state."""
    per_step: frozenset[str]
    """Names of what each physics step may have to do, see :class:`.per_step.PerStep`."""
    limbs: bool | None
    """Whether to take the form for a hub with limbs where there is one; None for where it is faster."""

    def tables(self) -> ModelTables:
        """The constants of the model, with limbs if its form is that for a hub with limbs."""
        data, device = self.solver.mjw_data, self.solver.model.device
        tables = ModelTables.of(
            self._limited_model(),
            int(data.njmax),
            self.buffers.max_contacts,
            self.division.pairs,
            limbs=self.limbs is not False and not self.beyond_limbs,
            losses=bool(np.any(self.solver.mjw_model.dof_frictionloss.numpy())),
            newton=self.newton_layout,
        )
        if tables.limbs is not None and self.limbs is None and device.is_cuda and not tables.limbs.suits_gpu:
            return replace(tables, limbs=None)
        return tables

    def options(self, limbs: LimbForm | None) -> KernelOptions:
        """The options of the kernel, whose form has these limbs, if any."""
        opt: mujoco.MjOption = self.solver.mj_model.opt
        return KernelOptions(
            lanes=self._lanes(limbs),
            few_worlds=limbs is not None and has_few_worlds(int(self.solver.mjw_data.nworld), self._lanes(limbs)),
            tolerance=float(self.solver.mjw_model.opt.tolerance.numpy()[0]),
            iterations=opt.iterations,
            ls_iterations=opt.ls_iterations,
            given_contacts=bool(self.division.external_kinds),
            accelerations=self.buffers.bodies is not None,
            contacts=self.buffers.fills_contacts,
            contact_forces=self.buffers.contact_forces is not None,
            kinematic_bodies=self._has_kinematic_bodies(),
            per_step=self.per_step,
        )

    @property
    def beyond_limbs(self) -> str:
        """Features in use that the form for a hub with limbs does not have; empty if it has all."""
        features = {
            "contacts of other collision detection": bool(self.division.external_kinds),
            "contacts in MuJoCo Warp's arrays": self.buffers.fills_contacts,
            "accelerations of bodies": self.buffers.bodies is not None,
            "external wrenches": "wrenches" in self.per_step,
        }
        return ", ".join(name for name, is_used in features.items() if is_used)

    def why_no_limbs(self) -> str:
        """Reason why the form for a hub with limbs cannot be taken."""
        reason = self.beyond_limbs
        return f"asked for: {reason}" if reason else why_no_limbs(self.solver.mj_model, self.division.pairs)

    def _lanes(self, limbs: LimbForm | None) -> int:
        if not self.solver.model.device.is_cuda:
            return 1
        if limbs is not None:
            return limbs.slots
        few, many = _LANES
        return few if max(self.solver.mj_model.nbody, self.solver.mj_model.nv) <= few else many

    def _has_kinematic_bodies(self) -> bool:
        """Whether any body is kinematic: none may become it later, see ``why_unsupported``."""
        flags = self.solver.model.body_flags
        return flags is not None and bool(np.any(flags.numpy() & int(newton.BodyFlags.KINEMATIC)))

    def _limited_model(self) -> mujoco.MjModel:
        """The compiled model with the limits that MuJoCo Warp's has now: drives may have got some."""
        limited = self.solver.mjw_model.actuator_forcelimited.numpy().astype(bool)
        self.solver.mj_model.actuator_forcelimited[:] = limited
        return self.solver.mj_model
