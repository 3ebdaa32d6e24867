# SPDX-License-Identifier: Apache-2.0
"""What a simulation is made with: time step, gravity, device, solver."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

from stripe_newton.configclass import configclass

from .solver_cfg import MuJoCoSolverCfg, SolverCfg
from .spawners.materials import RigidBodyMaterialCfg

__all__ = ["SimulationCfg"]


@configclass
class SimulationCfg:
    """Settings of a :class:`Simulation`."""

    device: str | None = None
    """``"cpu"``, ``"cuda"`` or ``"cuda:N"``. Default: the first GPU where there is one, else the CPU."""
    dt: float = 1.0 / 60.0
    """Time step of the physics [s]."""
    render_interval: int = 1
    """Physics steps between updates of the live viewer of ``stripe-newton play``."""
    gravity: tuple[float, float, float] | None = (0.0, 0.0, -9.81)
    """Gravity in the world frame [m/s^2]. ``None`` takes the stage's own."""
    physics_material: RigidBodyMaterialCfg = RigidBodyMaterialCfg()
    """Material of colliders that have none of their own."""
    solver: SolverCfg = MuJoCoSolverCfg()
    """The solver and its options."""
    contact_forces: bool = False
    """Export contact forces in every step, for :meth:`SceneQuerier.get_contact_forces`."""
    observables: Sequence[str] = ()
    """What the solver reports beyond the state, by Newton's names: ``"body_qdd"`` for accelerations of bodies,
    ``"body_parent_f"`` for the wrenches of their joints."""
    on_overflow: str = "raise"
    """When contacts or constraints did not fit into the solver's buffers: ``"raise"`` or ``"warn"``, naming the size to
    set. The device reports it without being waited for, so on a GPU the message may come some steps late."""
    use_cuda_graph: bool = True
    """Replay the physics as one CUDA graph (on a GPU). Switch off to debug a kernel."""

    def problems(self) -> Iterator[tuple[str, str]]:
        if not (isinstance(self.dt, (int, float)) and math.isfinite(self.dt) and self.dt > 0):
            yield "dt", f"is {self.dt!r}, must be a positive number of seconds"
        if not isinstance(self.render_interval, int) or self.render_interval < 1:
            yield "render_interval", f"is {self.render_interval!r}, must be a whole number of steps, 1 or more"
        if self.gravity is not None and not (len(self.gravity) == 3 and all(map(math.isfinite, self.gravity))):
            yield "gravity", f"is {self.gravity!r}, must be three finite numbers [m/s^2] or None"
        if self.on_overflow not in ("raise", "warn"):
            yield "on_overflow", f"is '{self.on_overflow}', must be 'raise' or 'warn'"
        if self.device is not None and self.device.split(":")[0] not in ("cpu", "cuda"):
            yield "device", f"is '{self.device}', must be 'cpu', 'cuda' or 'cuda:N'"
