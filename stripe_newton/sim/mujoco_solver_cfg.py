# SPDX-License-Identifier: Apache-2.0
"""MuJoCo solver config: makes MuJoCo Warp's solver, or the fused step of the same physics where that is faster.

Every field is an argument of Newton's solver unless it says otherwise, and ``None`` leaves Newton's default.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from typing import ClassVar

import newton

from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.solvers import SolverFused
from stripe_newton.solvers.stand_ins import MOST_GEOMS, StandIns
from stripe_newton.solvers.static_meshes import (
    MUST,
    add_triangles_attribute,
    count_marks,
    has_triangles,
    moves_other_kinds,
)
from stripe_newton.solvers.support import why_slower
from stripe_newton.usd.contact_margins import one_margin_warning
from stripe_newton.value_types import NonNegativeFloat, NonNegativeInt, PositiveFloat, PositiveInt, WrittenPath

from .contact_capacity import contact_capacity
from .ground_contacts import use_triangles
from .many_dofs import check_dof_count
from .solver_cfg_base import SolverCfg

__all__ = ["MuJoCoSolverCfg"]

_LEAST_CONTACTS, _LEAST_ROWS = 48, 64
"""Room of a world where little can touch: MuJoCo Warp's defaults."""


@configclass
class MuJoCoSolverCfg(SolverCfg):
    """MuJoCo Warp, the default: generalized coordinates, implicit drives, its own collision detection."""

    solver_class: ClassVar[str] = "SolverMuJoCo"
    in_place: ClassVar[bool] = True
    own_fields: ClassVar[frozenset[str]] = frozenset({"fused", "fused_limbs", "triangle_contacts", "drive_limits"})

    fused: bool | None = None
    """Compute a step in one kernel (:class:`stripe_newton.solvers.SolverFused`), the same physics many times as fast.
    ``None``: where that supports the model, on a GPU one of at most 40 degrees of freedom; ``True``: an error where it
    does not; ``False``: MuJoCo Warp. No argument of the solver."""
    fused_limbs: bool | None = None
    """Step a robot that is a hub with limbs, which touch nothing that moves, in a form of the fused step for those, see
    docs/solvers.md. Default: where it is faster, on a CPU for all of them, on a GPU for hubs and limbs of at most ten
    degrees of freedom together. No argument of the solver."""

    separate_worlds: bool | None = None
    """Map each Newton world to a MuJoCo world. Default: yes."""
    njmax: NonNegativeInt | None = None
    """Constraints a world has room for. Default: those of a world in which each body lies on others."""
    njmax_nnz: NonNegativeInt | None = None
    """Non-zeros of the sparse constraint Jacobian a world has room for."""
    nconmax: NonNegativeInt | None = None
    """Contact points a world has room for. Default: as for ``njmax``, up to eight for each body that can move."""
    iterations: NonNegativeInt | None = None
    """Solver iterations. MuJoCo's default is 100."""
    ls_iterations: NonNegativeInt | None = None
    """Line search iterations. MuJoCo's default is 50."""
    ccd_iterations: NonNegativeInt | None = None
    """Iterations of convex collision detection."""
    sdf_iterations: NonNegativeInt | None = None
    """Iterations of signed distance collision detection."""
    sdf_initpoints: NonNegativeInt | None = None
    """Starting points of signed distance collision detection."""
    solver: str | None = None
    """``"newton"`` (default) or ``"cg"``."""
    integrator: str | None = None
    """``"implicitfast"`` (default), ``"euler"``, ``"implicit"``, ``"rk4"`` or ``"discrete"``."""
    cone: str | None = None
    """Friction cone: ``"pyramidal"`` (default) or ``"elliptic"``."""
    jacobian: str | None = None
    """``"auto"`` (default), ``"dense"`` or ``"sparse"``."""
    impratio: PositiveFloat | None = None
    """Ratio of frictional to normal constraint impedance."""
    tolerance: NonNegativeFloat | None = None
    """Residual at which the solver stops."""
    ls_tolerance: NonNegativeFloat | None = None
    """Residual at which the line search stops."""
    ccd_tolerance: NonNegativeFloat | None = None
    """Tolerance of convex collision detection."""
    density: NonNegativeFloat | None = None
    """Density of the medium [kg/m^3], for drag and lift."""
    viscosity: NonNegativeFloat | None = None
    """Viscosity of the medium [Pa s]."""
    wind: tuple[float, float, float] | None = None
    """Velocity of the medium [m/s]."""
    magnetic: tuple[float, float, float] | None = None
    """Global magnetic flux."""
    use_mujoco_cpu: bool = False
    """Use MuJoCo's C implementation; steps the first world only, for debugging."""
    enable_multiccd: bool | None = None
    """Up to four contact points for a pair of convex shapes."""
    enable_sleeping: bool | None = None
    """Whether resting bodies sleep (GPU only)."""
    nvmax: PositiveInt | None = None
    """Active degrees of freedom a world has room for while sleeping is enabled."""
    sleep_tolerance: NonNegativeFloat | None = None
    """Velocity below which a body may sleep."""
    disable_contacts: bool | None = None
    """Compute no contacts."""
    disable_sensors: bool | None = None
    """Compute no MuJoCo sensors."""
    save_to_mjcf: WrittenPath | None = None
    """Write the MuJoCo model to this file."""
    use_mujoco_contacts: bool | None = None
    """MuJoCo's collision detection, which takes the hull of each mesh; ``False``: Newton's pipeline. Default: MuJoCo's,
    and for static scenery with concave meshes the triangles, by the fused step or, where that has no routine, by
    Newton's pipeline."""
    use_speculative_contacts: bool = False
    """Bound the closing speed of separated contacts (needs Newton's pipeline)."""
    include_sites: bool = True
    """Export sites to MuJoCo."""
    skip_visual_only_geoms: bool = True
    """Leave visual shapes out of the MuJoCo model."""
    strict_capacity: bool = False
    """Raise when Newton's contact buffer is larger than MuJoCo's."""
    kinematic_switchable_roots: bool = False
    """Give every root an inactive weld, so that bodies can be made kinematic while running."""
    triangle_contacts: bool = True
    """Find contacts of spheres, capsules and boxes with height fields from the triangles they touch: exact, and without
    the inner edges of MuJoCo Warp's convex routine for prisms, see docs/solvers.md. Those of cylinders only in the
    fused step. No argument of the solver."""

    drive_limits: bool = False
    """Set the effort limits of drives on MuJoCo's actuators, so that a drive at its limit damps nothing, as in a file
    with ``forcerange``. Otherwise they are the joints' alone, and ``dt`` times the damping of a drive at its limit goes
    on adding to the inertia: slower than the motor, and stable whatever the inertia. With it a joint swings for ever
    once the inertia is less than half of that. No argument of the solver."""

    def register(self, builder: newton.ModelBuilder) -> None:
        SolverCfg.register(self, builder)
        if self.finds_contacts:
            # Newton's default gap makes contacts of shapes that do not touch yet, for its own pipeline to look ahead.
            # In MuJoCo each of them would take a place in the buffers and a row in the solver, for nothing.
            builder.rigid_gap = 0.0
        add_triangles_attribute(builder)

    def create(self, model: newton.Model, observables: Sequence[str] = ()) -> newton.solvers.SolverBase:
        check_dof_count(model)
        try:
            with one_margin_warning(), warnings.catch_warnings():
                # Newton maps its order of joints to MuJoCo's: tests find the same motion in several orders.
                warnings.filterwarnings("ignore", message="Joint order is not in depth-first", category=UserWarning)
                return self._create(model, observables)
        except Exception as error:
            if "stackAlloc" not in str(error):  # MuJoCo's own, when the contacts of the start do not fit its memory
                raise
            raise RuntimeError(
                "MuJoCo ran out of memory for the contacts at the start: bodies overlap there; "
                "give each asset its own 'init_state.pos'"
            ) from error

    def _create(self, model: newton.Model, observables: Sequence[str]) -> newton.solvers.SolverMuJoCo:
        """Make the solver, with Newton's collision detection if contacts with static shapes need it."""
        meshes = self.chooses_contacts and has_triangles(model)
        concave = meshes and has_triangles(model, MUST)
        stand_ins = self._stand_ins(model, observables) if meshes else None
        solver = None
        if stand_ins is not None:
            solver = self._make_with_hidden(model, observables, stand_ins)
            if solver is None and stand_ins.many:  # nor could MuJoCo Warp have so many geoms
                reason = f"{len(stand_ins.hidden)} static colliders"
                return self._with_newton_contacts(model, observables, [reason], stand_ins)
        solver = solver or self._make(model, observables)
        fused = self._configure_fused(solver, meshes)
        missing = fused.missing_triangle_contacts() if concave and fused is not None else []
        if concave and (fused is None or missing):
            return self._with_newton_contacts(model, observables, missing)
        if self.triangle_contacts and self.uses_mujoco_warp and self.finds_contacts and fused is None:
            use_triangles(solver.mjw_model)  # before the first step, which compiles kernels for the pairs there are
        return solver

    def _stand_ins(self, model: newton.Model, observables: Sequence[str]) -> StandIns | None:
        """Static shapes that need not be geoms; None if there are none, or all shapes must be geoms.

        MuJoCo's own file and arrays of contacts are to have all shapes.
        """
        has_all = self.fused is False or self.save_to_mjcf is not None or "contact_f" in observables
        return None if has_all else StandIns.of(model)

    def _make_with_hidden(
        self, model: newton.Model, observables: Sequence[str], stand_ins: StandIns
    ) -> newton.solvers.SolverMuJoCo | None:
        """Make the fused solver with shapes that are no geoms; None if it does not find their contacts."""
        if not stand_ins.by_triangles:
            return None
        solver = self._make(model, observables, stand_ins)
        fused = self._configure_fused(solver, True)
        return solver if fused is not None and fused.finds_hidden() else None

    def _with_newton_contacts(
        self, model: newton.Model, observables: Sequence[str], reasons: Sequence[str], stand_ins: StandIns | None = None
    ) -> newton.solvers.SolverMuJoCo:
        """Make the solver for contacts of Newton's collision detection, with the reasons for its description."""
        chosen = self.replace(use_mujoco_contacts=False)._make(model, observables, stand_ins)
        if isinstance(chosen, SolverFused):
            chosen.newton_contacts_for = tuple(reasons)
        return chosen

    def _configure_fused(self, solver: newton.solvers.SolverMuJoCo, meshes: bool) -> SolverFused | None:
        """The solver with its options for triangles and limbs set, if it is fused; None if it is not."""
        if not isinstance(solver, SolverFused) or solver.unsupported:
            return None
        solver.triangles, solver.static_triangles = self.triangle_contacts and self.finds_contacts, meshes
        if self.fused_limbs is not None:
            solver.limbs = self.fused_limbs
        return solver

    def _make(
        self, model: newton.Model, observables: Sequence[str], stand_ins: StandIns | None = None
    ) -> newton.solvers.SolverMuJoCo:
        """Make the fused solver, or MuJoCo Warp's where that is configured or needed for the observables."""
        if model.world_count > 1 and not (
            not self.use_mujoco_cpu if self.separate_worlds is None else self.separate_worlds
        ):
            field = "separate_worlds: is False" if self.separate_worlds is False else "use_mujoco_cpu: is True"
            raise ConfigError([f"sim.solver.{field}, which steps one environment, but num_envs is {model.world_count}"])
        arguments = {**self._buffer_sizes(model), **self.arguments()}
        if self.fused is False:
            return newton.solvers.SolverMuJoCo(model, **arguments)
        solver = SolverFused(model, fallback=self.fused is None, stand_ins=stand_ins, **arguments)
        missing = sorted(set(observables) - {str(getattr(o, "value", o)) for o in solver.supported_observables})
        if missing and self.fused:
            raise ConfigError([f"fused: is True, but the fused step does not report {', '.join(missing)}"])
        if missing and not solver.unsupported:
            solver.unsupported = f"it does not report {', '.join(missing)}"
        if self.fused is None and not solver.unsupported:
            solver.unsupported = why_slower(solver.mj_model.nv, model.device.is_cuda)
        return solver

    def _buffer_sizes(self, model: newton.Model) -> dict[str, int]:
        """Sizes of the buffers by what can touch; a size that the config gives makes all of them the solver's."""
        if not self.finds_contacts or self.separate_worlds is False or (self.njmax, self.nconmax) != (None, None):
            return {}
        fields = model.shape_count and (model.shape_type.numpy() == newton.GeoType.HFIELD).any()
        if fields and not self.triangle_contacts:
            return {}  # MuJoCo Warp finds many contacts with a field, and its own sizes are made for them
        contacts, rows = contact_capacity(model, self.chooses_contacts and has_triangles(model))
        return {"nconmax": max(_LEAST_CONTACTS, contacts), "njmax": max(_LEAST_ROWS, rows)}

    @property
    def finds_contacts(self) -> bool:
        return self.use_mujoco_contacts is not False

    def expects_newton_contacts(self, builder: newton.ModelBuilder) -> bool:
        needs = count_marks(builder, MUST) > 0 or count_marks(builder) > MOST_GEOMS
        return not self.finds_contacts or (self.chooses_contacts and needs and moves_other_kinds(builder))

    @property
    def chooses_contacts(self) -> bool:
        return self.use_mujoco_contacts is None and not self.use_mujoco_cpu and not self.disable_contacts

    @property
    def uses_mujoco_warp(self) -> bool:
        return not self.use_mujoco_cpu

    @property
    def limits_drives(self) -> bool:
        return self.drive_limits

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()
        choices = {
            "solver": ("newton", "cg"),
            "integrator": ("implicitfast", "euler", "implicit", "rk4", "discrete"),
            "cone": ("pyramidal", "elliptic"),
            "jacobian": ("auto", "dense", "sparse"),
        }
        for name, allowed in choices.items():
            value = getattr(self, name)
            if value is not None and value not in allowed:
                yield name, f"is '{value}', must be one of {', '.join(allowed)}"
        if self.use_speculative_contacts and (self.use_mujoco_contacts is not False or self.use_mujoco_cpu):
            text = "is True, which needs Newton's pipeline: use_mujoco_contacts=False and use_mujoco_cpu=False"
            yield "use_speculative_contacts", text
