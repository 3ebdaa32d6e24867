# SPDX-License-Identifier: Apache-2.0
"""Forward-only kernels: whose gradients are left out, and whose are not."""

from __future__ import annotations

import newton
import numpy as np
import pytest
import warp as wp
from newton._src.geometry import raycast
from newton._src.sim.ik import ik_common

from stripe_newton.forward_only import GRADIENTS, leave_out_gradients


@pytest.fixture
def module(monkeypatch):
    """A Warp module of Newton that nothing has launched, as it is after the import."""
    module = wp.get_module(raycast.__name__)
    monkeypatch.setitem(module.options, "enable_backward", True)
    monkeypatch.setattr(module, "execs", {})
    yield module
    module.mark_modified()


def test_libraries_lose_their_gradients(module):
    leave_out_gradients()
    assert not module.options["enable_backward"]


def test_the_variable_keeps_them(module, monkeypatch):
    monkeypatch.setenv(GRADIENTS, "1")
    leave_out_gradients()
    assert module.options["enable_backward"]
    monkeypatch.setenv(GRADIENTS, "0")
    leave_out_gradients()
    assert not module.options["enable_backward"]


def test_kernels_in_use_stay_as_they_are(module):
    module.execs = {(None, 1): object()}
    leave_out_gradients()
    assert module.options["enable_backward"]


@wp.kernel
def _double(x: wp.array[float], y: wp.array[float]):
    y[wp.tid()] = 2.0 * x[wp.tid()]


def test_kernels_of_others_and_inverse_kinematics_keep_theirs():
    leave_out_gradients()
    assert wp.get_module(ik_common.__name__).options["enable_backward"]
    x = wp.array(np.ones(3, dtype=np.float32), device="cpu", requires_grad=True)
    y = wp.zeros(3, dtype=float, device="cpu", requires_grad=True)
    with wp.Tape() as tape:
        wp.launch(_double, dim=3, inputs=[x, y], device="cpu")
    tape.backward(grads={y: wp.ones(3, dtype=float, device="cpu")})
    assert x.grad.numpy().tolist() == [2.0, 2.0, 2.0]


def test_solvers_that_are_imported_later_lose_theirs():
    """Newton imports the modules of a solver when it is first asked for."""
    newton.solvers.SolverXPBD.__name__  # noqa: B018  # imports it
    leave_out_gradients()
    kernels = wp.get_module("newton._src.solvers.xpbd.kernels")
    assert not kernels.options["enable_backward"] or kernels.execs
