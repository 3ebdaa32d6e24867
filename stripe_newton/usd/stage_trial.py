# SPDX-License-Identifier: Apache-2.0
"""Stage trial: load a stage and step it, as for the table in docs/stages.md."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import newton
import numpy as np
from newton.solvers import SolverMuJoCo

from .loading import load_stage
from .stage_access import StageError

__all__ = ["StageTrial", "try_stage"]


@dataclass
class StageTrial:
    """Result of a trial."""

    outcome: str
    """``steps``, ``refused`` or ``diverges``."""
    reason: str = ""
    """Reason of the refusal, or the quantity that was not finite, with its step."""
    bodies: int = 0
    dofs: int = 0
    shapes: int = 0
    mistake: float = 0.0
    """Largest difference between the coordinates of a free joint and the pose of its body before the first step."""


def try_stage(
    path: str | Path, *, steps: int = 200, worlds: int = 2, dt: float = 1.0 / 240.0, device: str = "cpu"
) -> StageTrial:
    """Load a stage, replicate it, and take ``steps`` steps of ``dt`` seconds with SolverMuJoCo.

    ``joint_q``, ``joint_qd``, ``body_q`` and ``body_qd`` must be finite after every step.
    """
    template = newton.ModelBuilder()
    try:
        report = load_stage(template, path, allow_static=False)
    except StageError as error:
        return StageTrial("refused", f"{error.prim}: {error.reason}" if error.prim else error.reason)
    builder = newton.ModelBuilder()
    SolverMuJoCo.register_custom_attributes(builder)
    builder.replicate(template, worlds)  # as for environments
    model = builder.finalize(device=device)
    solver, state, control = SolverMuJoCo(model), model.state(), model.control()
    newton.eval_fk(model, model.joint_q, model.joint_qd, state)
    trial = StageTrial("steps", "", len(report.bodies), report.dofs, len(report.shapes), _free_mistake(template, state))
    for step in range(steps):
        solver.step(state, state, control, None, dt)  # in place: MuJoCo's solver needs no second state
        for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
            if not np.isfinite(getattr(state, name).numpy()).all():
                trial.outcome, trial.reason = "diverges", f"{name} is not finite after step {step + 1}"
                return trial
    return trial


def _free_mistake(template: newton.ModelBuilder, state: newton.State) -> float:
    """See :attr:`StageTrial.mistake`: forward kinematics must leave free bodies where the stage puts them."""
    poses, worst = state.body_q.numpy(), 0.0
    for joint, kind in enumerate(template.joint_type):
        if kind == newton.JointType.FREE:
            at, child = template.joint_q_start[joint], template.joint_child[joint]
            worst = max(worst, float(np.abs(poses[child] - np.array(template.joint_q[at : at + 7])).max()))
    return worst
