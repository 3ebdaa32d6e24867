# SPDX-License-Identifier: Apache-2.0
"""Commands without videos."""

from __future__ import annotations

import pytest


@pytest.fixture
def no_video(monkeypatch):
    """Leave the videos out, where a test is about something else."""
    from stripe_newton.cli import train

    monkeypatch.setattr(train, "record_video", lambda *args, **kwargs: None)
    monkeypatch.setattr(train, "export_policy", lambda *args: None)
