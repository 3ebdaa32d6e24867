# SPDX-License-Identifier: Apache-2.0
"""Shared set-up of the tests of fusion."""

from __future__ import annotations

import pytest

from stripe_newton.managers import ManagerContext
from tests.helpers.manager_world import manager_context


@pytest.fixture
def cart() -> ManagerContext:
    """A context for managers over four cart-poles."""
    return manager_context(robot="cartpole")
