# SPDX-License-Identifier: Apache-2.0
"""Quick imports: what is left out is not missed, and comes when it is asked for."""

from __future__ import annotations

import subprocess
import sys

DYNAMO = """
import sys
from stripe_newton.cli.quick_imports import import_quickly
import_quickly()
import torch, tensordict
weight = torch.nn.Parameter(torch.ones(3))
optimiser = torch.optim.Adam([weight], lr=0.1)
def step():
    optimiser.zero_grad()
    weight.square().sum().backward()
    optimiser.step()
step()
loaded = sum(name.startswith("torch._dynamo.") for name in sys.modules)
assert loaded == 0, f"{loaded} modules of torch._dynamo"
compiled = torch.compile(lambda x: 2.0 * x + 1.0, backend="eager")
torch.testing.assert_close(compiled(torch.ones(2)), torch.full((2,), 3.0))
assert torch._dynamo is sys.modules["torch._dynamo"] and torch._dynamo.__file__
from torch._dynamo.exc import Unsupported
step()
print(weight.tolist())
"""
"""A program that steps an optimiser before and after it compiles a function."""

HASH = """
import sys
if "quick" in sys.argv:
    from stripe_newton.cli.quick_imports import skip_module_references
    skip_module_references()
import warp, stripe_kernels.picture_scenery  # which calls functions of two other modules
module = warp.get_module("stripe_kernels.picture_scenery")
print(len(module.references), module.hash_module().hex())
"""


def run(program, *words):
    ran = subprocess.run([sys.executable, "-c", program, *words], capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr
    return ran.stdout.splitlines()


def test_the_compiler_of_torch_is_loaded_when_something_is_compiled():
    stepped = eval(run(DYNAMO)[-1])
    assert all(0.75 < value < 0.85 for value in stepped)  # Adam moves by the learning rate


def test_kernels_have_the_names_that_they_have_otherwise():
    """Or a program would compile what a command has compiled, and the other way round."""
    (references, digest), (none, quick) = (run(HASH, *words)[-1].split() for words in ((), ("quick",)))
    assert int(references) > 0
    assert (int(none), quick) == (0, digest)
