# SPDX-License-Identifier: Apache-2.0
"""Newton's state and controls in the fused step, against the conversions of Newton's SolverMuJoCo."""

from __future__ import annotations

from collections.abc import Callable

import newton
import numpy as np
import pytest
import warp as wp

from stripe_newton.solvers import SolverFused

ROOM = {"njmax": 20, "nconmax": 4, "disable_contacts": True, "kinematic_switchable_roots": False}
Joints = newton.ModelBuilder.JointDofConfig


def turned(*rpy: float) -> wp.quat:
    return wp.quat_rpy(*rpy)


def frame(seed: int) -> wp.transform:
    """A frame that is neither at its body's origin nor aligned with it."""
    rng = np.random.default_rng(seed)
    return wp.transform(wp.vec3(*rng.uniform(-0.2, 0.2, 3)), turned(*rng.uniform(-1.0, 1.0, 3)))


def add_link(builder: newton.ModelBuilder, **kwargs: object) -> int:
    body = builder.add_link(
        mass=1.0, inertia=wp.diag(wp.vec3(0.02, 0.03, 0.04)), com=wp.vec3(0.03, -0.02, 0.05), **kwargs
    )
    return body


def world() -> newton.ModelBuilder:
    """All kinds of joints, with anchors of their own, on a floating and on a fixed base, and a body alone."""
    builder = newton.ModelBuilder()
    SolverFused.register_custom_attributes(builder)
    drive = {"target_ke": 8.0, "target_kd": 0.5, "armature": 0.05}
    base = add_link(builder)
    floating = [builder.add_joint_free(base, parent_xform=frame(0), child_xform=frame(1))]
    one, two, three = (add_link(builder) for _ in range(3))
    at = {"parent_xform": frame(2), "child_xform": frame(3)}
    floating.append(builder.add_joint_revolute(base, one, axis=(0.0, 1.0, 0.0), **drive, **at))
    floating.append(builder.add_joint_ball(one, two, **at))
    floating.append(
        builder.add_joint_d6(
            base, three, linear_axes=[Joints(axis=(1.0, 0.0, 0.0), **drive)],
            angular_axes=[Joints(axis=(0.0, 1.0, 0.0), **drive), Joints(axis=(0.0, 0.0, 1.0), **drive)], **at,
        )
    )  # fmt: skip
    builder.add_articulation(floating)
    root, slider = add_link(builder), add_link(builder)
    fixed = [builder.add_joint_fixed(-1, root, parent_xform=frame(4), child_xform=frame(5))]
    fixed.append(builder.add_joint_prismatic(root, slider, axis=(0.0, 0.0, 1.0), **drive, **at))
    builder.add_articulation(fixed)
    alone = add_link(builder)
    builder.add_articulation([builder.add_joint_free(alone)])
    return builder


def model_of(num_worlds: int) -> newton.Model:
    builder = newton.ModelBuilder()
    SolverFused.register_custom_attributes(builder)
    builder.replicate(world(), num_worlds)
    return builder.finalize(device="cpu")


def scramble(model: newton.Model, state: newton.State, control: newton.Control) -> None:
    """Random joints, targets and forces, different in each world."""
    rng = np.random.default_rng(7)
    q = rng.uniform(-0.5, 0.5, model.joint_coord_count)
    types, starts = model.joint_type.numpy(), model.joint_q_start.numpy()
    for kind, offset in ((newton.JointType.FREE, 3), (newton.JointType.BALL, 0)):
        for start in starts[:-1][types == kind] + offset:
            turn = rng.normal(size=4)
            q[start : start + 4] = turn / np.linalg.norm(turn)
    state.joint_q.assign(q.astype(np.float32))
    arrays = state.joint_qd, control.joint_f, control.joint_target_qd, control.joint_target_q, state.body_f
    for array in arrays:
        array.assign(rng.uniform(-1.0, 1.0, array.numpy().shape).astype(np.float32))


def run(kind: Callable[..., newton.solvers.SolverMuJoCo], separate: bool) -> tuple[np.ndarray, ...]:
    """State and efforts of actuators after three steps."""
    model = model_of(3)
    solver, state, control = kind(model, **ROOM), model.state(), model.control()
    if isinstance(solver, SolverFused):
        assert solver.converts
    scramble(model, state, control)
    flags = model.body_flags.numpy()
    flags[model.body_count // 3 - 1] = newton.BodyFlags.KINEMATIC  # the body alone of the first world
    model.body_flags.assign(flags)
    observables = solver.observables({solver.ObservableKind.QFRC_ACTUATOR})
    for _ in range(3):
        following = model.state() if separate else state
        following.body_f.assign(state.body_f)
        solver.step(state, following, control, None, 0.002, observables=observables)
        state = following
    poses = state.body_q.numpy().copy()
    poses[:, 3:] *= np.sign(poses[:, 6:])
    return (
        state.joint_q.numpy(),
        state.joint_qd.numpy(),
        poses,
        state.body_qd.numpy(),
        observables.qfrc_actuator.numpy(),
    )


@pytest.mark.parametrize("separate", [False, True])
def test_state_and_controls_are_converted_as_newton_does(separate):
    """In a state of its own or another one. Joints of kinematic bodies are left as they are."""
    expected, found = (run(kind, separate) for kind in (newton.solvers.SolverMuJoCo, SolverFused))
    assert np.abs(expected[4]).max() > 1.0
    for want, have in zip(expected, found, strict=True):
        np.testing.assert_allclose(have, want, atol=2e-5)


def two_free_bodies() -> newton.Model:
    builder = newton.ModelBuilder()
    SolverFused.register_custom_attributes(builder)
    for _ in range(2):
        builder.begin_world()
        builder.add_articulation([builder.add_joint_free(add_link(builder))])
        builder.end_world()
    return builder.finalize(device="cpu")


def shift_a_reference(model: newton.Model) -> newton.ModelFlags:
    references = model.mujoco.dof_ref.numpy()
    references[model.joint_dof_count // 2 + 6] = 0.3  # the hinge of the second world
    model.mujoco.dof_ref.assign(references)
    return newton.ModelFlags.JOINT_DOF_PROPERTIES


def shift_anchors(model: newton.Model) -> newton.ModelFlags:
    model.joint_X_p.assign(np.tile(np.array(frame(6), dtype=np.float32), (model.joint_count, 1)))
    return newton.ModelFlags.JOINT_PROPERTIES


@pytest.mark.parametrize(
    ("make", "change", "scrambled", "assumed"),
    [
        (lambda: model_of(2), shift_a_reference, False, lambda a: a.references is None),
        (two_free_bodies, shift_anchors, True, lambda a: a.anchors == (None, None)),
    ],
    ids=["reference coordinates", "anchors"],
)
def test_what_comes_later(make, change, scrambled, assumed):
    """Where all are 0, or none is there, the kernel does not look at them until the solver is notified."""
    found = []
    for kind in (newton.solvers.SolverMuJoCo, SolverFused):
        model = make()
        solver, state, control = kind(model, **ROOM), model.state(), model.control()
        if scrambled:
            scramble(model, state, control)
        solver.step(state, state, control, None, 0.002)
        if isinstance(solver, SolverFused):
            assert assumed(solver.launcher.assumptions)
        solver.notify_model_changed(change(model))
        if isinstance(solver, SolverFused):
            assert solver.has_stale_graphs
            assert not assumed(solver.launcher.assumptions)
        for _ in range(3):
            solver.step(state, state, control, None, 0.002)
        found.append([array.numpy() for array in (state.joint_q, state.joint_qd, state.body_q)])
    assert np.abs(found[0][1]).max() > 0.01
    for want, have in zip(*found, strict=True):
        np.testing.assert_allclose(have, want, atol=2e-5)
