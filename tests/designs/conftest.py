# SPDX-License-Identifier: Apache-2.0
"""The lab scene and the environment that the tests of a file share."""

from __future__ import annotations

import pytest

from stripe_newton.envs import LabScene, ManagerBasedRLEnv

from .walk_task import WalkCfg


@pytest.fixture(scope="module")
def lab():
    made = LabScene(WalkCfg())
    made.reset()
    yield made
    made.close()


@pytest.fixture(scope="module")
def env():
    made = ManagerBasedRLEnv(WalkCfg())
    yield made
    made.close()
