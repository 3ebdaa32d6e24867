# SPDX-License-Identifier: Apache-2.0
"""Shared set-up: a quiet Warp, a working folder for each test, the device to run on, no GPU tests without a GPU."""

from __future__ import annotations

import os

import pytest

os.environ.setdefault("MPLBACKEND", "Agg")
# Before torch is loaded, and for the processes that tests start: small networks are slower on several threads, and
# tests run side by side.
os.environ.setdefault("OMP_NUM_THREADS", "1")


def has_cuda() -> bool:
    import torch

    return torch.cuda.is_available()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    gpu_items = [item for item in items if item.get_closest_marker("gpu")]
    if gpu_items and not has_cuda():
        for item in gpu_items:
            item.add_marker(pytest.mark.skip(reason="needs an NVIDIA GPU"))


@pytest.fixture(autouse=True, scope="session")
def quiet_warp() -> None:
    """No report of kernel compilation between the lines of the tests."""
    import warp as wp

    wp.config.log_level = wp.LOG_WARNING


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch) -> None:
    """Run each test in a temporary folder, so that relative paths do not write into the source tree."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(params=["cpu", pytest.param("cuda:0", marks=pytest.mark.gpu)])
def device(request) -> str:
    """The device to run on: the CPU, and with ``-m gpu`` the first GPU."""
    return request.param
