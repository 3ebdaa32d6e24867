# SPDX-License-Identifier: Apache-2.0
"""Per step: what each physics step of a launch of the fused solver computes beside MuJoCo's."""

from __future__ import annotations

from dataclasses import dataclass

import warp as wp

from stripe_kernels.actuators import JointDrives

__all__ = ["PerStep"]


@dataclass(frozen=True)
class PerStep:
    """Work at each physics step of a launch, on the state of that step; None for what is not to be done."""

    drives: JointDrives | None = None
    """Explicit actuators, whose efforts act on joints of one degree of freedom."""
    solver_drives: JointDrives | None = None
    """All joints, of which those that the solver drives are given efforts beside it, once in a launch, and have noted
    what their drives ask for in the last step. Where it is given it is the same struct as ``drives``."""
    external_wrench: wp.array | None = None
    """Wrenches about the centres of mass [N, N m], shape ``(body_count,)``. They replace the forces on bodies of
    Newton's state, and are written there in the world frame."""
    wrench_in_world: wp.array | None = None
    """Whether each of them is in the world frame or in its body's, bool, shape ``(body_count,)``."""
    velocity_limit: wp.array | None = None
    """Limits of Newton's joint velocities after the step [m/s or rad/s], shape ``(joint_dof_count,)``."""

    @property
    def kinds(self) -> frozenset[str]:
        """Names of what is to be done, which are options of the kernel."""
        found = {"drives": self.drives, "solver_drives": self.solver_drives, "wrenches": self.external_wrench}
        found |= {"velocity_limits": self.velocity_limit}
        return frozenset(name for name, given in found.items() if given is not None)
