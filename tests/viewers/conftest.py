# SPDX-License-Identifier: Apache-2.0
"""Viewed boxes: an environment of boxes, and a live view of it."""

from __future__ import annotations

import pytest

from stripe_newton.viewers import LiveViewer
from tests.helpers.viewed_boxes import BoxEnv


@pytest.fixture
def env():
    return BoxEnv()


@pytest.fixture
def viewer(env):
    with LiveViewer(env, port=18500) as viewer:
        viewer.time.speed.value = "as fast as possible"
        yield viewer
