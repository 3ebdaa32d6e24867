# SPDX-License-Identifier: Apache-2.0
"""Math of the Isaac Lab dialect, function by function, beside Isaac Lab's own file."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Iterator
from types import ModuleType

import numpy as np
import pytest
import torch

from stripe_newton.isaaclab import math as ours
from tests.helpers.isaaclab_math_cases import CASES, MATRICES, SAMPLES, Q, copies
from tests.helpers.isaaclab_source import isaaclab_modules


@pytest.fixture(scope="module")
def theirs() -> Iterator[ModuleType]:
    with isaaclab_modules("isaaclab.utils.math") as (module,):
        yield module


def same(actual: object, expected: object, atol: float) -> None:
    if isinstance(expected, tuple):
        assert isinstance(actual, tuple)
        assert len(actual) == len(expected)
        for a, e in zip(actual, expected):
            same(a, e, atol)
    elif isinstance(expected, torch.Tensor):
        torch.testing.assert_close(actual, expected, atol=atol, rtol=atol)
    elif isinstance(expected, np.ndarray):
        np.testing.assert_array_equal(actual, expected)
    else:
        assert actual == expected


def test_every_function_is_there_with_its_arguments(theirs):
    public = {
        name: thing
        for name, thing in vars(theirs).items()
        if callable(thing) and not name.startswith("_") and name != "Literal"
    }
    assert set(public) <= set(ours.__all__)
    assert set(CASES) | set(SAMPLES) == set(public), "a function without a case"
    for name, function in public.items():
        want = inspect.signature(inspect.unwrap(function)).parameters if inspect.isfunction(function) else None
        if want is None:  # TorchScript keeps names and defaults in its schema
            want = {a.name: a.default_value for a in function.schema.arguments}
            got = {k: p.default for k, p in inspect.signature(getattr(ours, name)).parameters.items()}
            got = {k: None if v is inspect.Parameter.empty else v for k, v in got.items()}
        else:
            got = {k: p.default for k, p in inspect.signature(getattr(ours, name)).parameters.items()}
            want = {k: p.default for k, p in want.items()}
        assert {k: got.get(k, "missing") for k in want} == dict(want), name
        assert list(got)[: len(want)] == list(want), name


@pytest.mark.parametrize("name", CASES)
def test_values(theirs, name):
    for arguments in CASES[name]:
        actual, expected = getattr(ours, name)(*copies(arguments)), getattr(theirs, name)(*copies(arguments))
        if name == "convert_camera_frame_orientation_convention":  # equal components: rounding gives the sign
            expected = torch.where((actual * expected).sum(-1, keepdim=True) < 0.0, -expected, expected)
        same(actual, expected, tolerance(arguments))


def tolerance(arguments: tuple) -> float:
    single = any(isinstance(a, torch.Tensor) and a.dtype == torch.float32 for a in arguments)
    return 2e-6 if single else 1e-9


@pytest.mark.parametrize("name", SAMPLES)
def test_equal_seeds_give_equal_numbers(theirs, name):
    for arguments in SAMPLES[name]:
        torch.manual_seed(7)
        expected = getattr(theirs, name)(*copies(arguments))
        torch.manual_seed(7)
        same(getattr(ours, name)(*copies(arguments)), expected, 2e-6)


def test_what_isaac_lab_scripts_can_be_scripted_here(theirs):
    scripted = [name for name, thing in vars(theirs).items() if isinstance(thing, torch.jit.ScriptFunction)]
    assert len(scripted) > 20
    for name in scripted:
        if not name.startswith(("_", "random_", "default_")):
            torch.jit.script(getattr(ours, name))


def test_locked_angles_give_the_same_rotation():
    roll, pitch, yaw = ours.euler_xyz_from_quat(Q[7:8])
    assert abs(float(pitch)) == pytest.approx(math.pi / 2)
    torch.testing.assert_close(ours.matrix_from_quat(ours.quat_from_euler_xyz(roll, pitch, yaw)), MATRICES[7:8])


def test_nothing_is_changed_in_place():
    for name, cases in CASES.items():
        function: Callable = getattr(ours, name)
        for arguments in cases:
            before = copies(arguments)
            function(*arguments)
            for a, b in zip(arguments, before):
                assert not isinstance(a, torch.Tensor) or torch.equal(a, b), name


def test_one_vector_by_one_quaternion_has_the_vectors_shape(theirs):
    quat, vec = torch.tensor([[0.5, 0.5, 0.5, 0.5]]), torch.tensor([1.0, 2.0, 3.0])
    for name in ("quat_apply", "quat_apply_inverse"):
        expected = getattr(theirs, name)(quat, vec)
        assert expected.shape == (3,)
        torch.testing.assert_close(getattr(ours, name)(quat, vec), expected)
