# SPDX-License-Identifier: Apache-2.0
"""The import hook of the Isaac Lab dialect: which modules it answers for, and how."""

import importlib
import sys
from collections.abc import Iterator

import pytest
import torch

import stripe_newton.isaaclab as dialect
from stripe_newton.assets import ArticulationCfg


@pytest.fixture
def installed() -> Iterator[None]:
    dialect.install()
    yield
    dialect.uninstall()


def test_nothing_answers_before_it_is_installed():
    assert not dialect.is_installed()
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("isaaclab.devices.openxr")


def test_submodules_offer_what_their_package_offers(installed):
    package = importlib.import_module("isaaclab.assets")
    module = importlib.import_module("isaaclab.assets.articulation.articulation_cfg")
    assert module.ArticulationCfg is package.ArticulationCfg
    assert issubclass(module.ArticulationCfg, ArticulationCfg)


def test_a_name_that_is_not_there_is_an_import_error_that_says_so(installed):
    with pytest.raises(ImportError):
        exec("from isaaclab.assets import ArticulatonCfg")
    with pytest.raises(AttributeError, match="did you mean 'ArticulationCfg'"):
        importlib.import_module("isaaclab.assets").ArticulatonCfg  # noqa: B018
    with pytest.raises(ModuleNotFoundError):
        importlib.import_module("isaaclab.no_such_module")


def test_star_imports_take_what_the_table_names(installed):
    names: dict[str, object] = {}
    exec("from isaaclab.envs.mdp import *", names)
    assert {"base_lin_vel", "UniformVelocityCommandCfg"} <= set(names)


def test_uninstalling_forgets_the_modules():
    dialect.install()
    importlib.import_module("isaaclab.sim")
    dialect.uninstall()
    assert not any(m.partition(".")[0] == "isaaclab" for m in sys.modules)


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU to move tensors to")
def test_cuda_calls_leave_tensors_where_they_are_without_a_gpu():
    tensor, layer = torch.ones(2), torch.nn.Linear(2, 1)
    dialect.install()
    assert tensor.cuda() is tensor
    assert layer.cuda() is layer
    dialect.uninstall()
    with pytest.raises((AssertionError, RuntimeError)):
        tensor.cuda()
