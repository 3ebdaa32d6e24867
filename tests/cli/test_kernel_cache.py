# SPDX-License-Identifier: Apache-2.0
"""Folder of compiled kernels: one that cannot be written is named, with the variable that names another."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from stripe_newton.cli.kernel_cache import cache_folder, cache_message, check_cache
from stripe_newton.cli.system_errors import system_message
from stripe_newton.cli.user_error import UserError
from tests.helpers.checkout import PYTHONPATH


@pytest.mark.parametrize("name", ["WARP_CACHE_PATH", "XDG_CACHE_HOME", "HOME"])
def test_a_folder_below_a_file_is_one_line_at_once(name):
    environment = {k: v for k, v in os.environ.items() if k not in ("WARP_CACHE_PATH", "XDG_CACHE_HOME")}
    environment |= {"PYTHONPATH": PYTHONPATH, name: "/dev/null"}
    words = ["bench", "Stripe-Cartpole-Direct-v0", "--device", "cpu"]
    command = [sys.executable, "-m", "stripe_newton.cli", *words]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1)
    assert f"({name}=/dev/null), cannot be written: Not a directory; set WARP_CACHE_PATH" in done.stderr


def test_what_is_there_or_can_be_made_is_no_error(monkeypatch, tmp_path):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path / "a" / "b"))
    check_cache()
    assert list(tmp_path.iterdir()) == []
    folder = cache_folder()
    assert folder is not None
    (folder / "wp_some_module").mkdir(parents=True)
    # The superuser may write everywhere, so that it is only said that nothing can be written.
    monkeypatch.setattr("stripe_newton.cli.kernel_cache.try_folder", _refuse)
    check_cache()
    (folder / "wp_some_module").rmdir()
    with pytest.raises(UserError, match="cannot be written: Permission denied"):
        check_cache()


def _refuse(path: Path) -> None:
    raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))


def test_errors_of_other_files_are_not_about_the_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("WARP_CACHE_PATH", str(tmp_path))
    folder = cache_folder()
    assert folder is not None
    assert cache_message(tmp_path, "x") is not None  # the folder above one that is missing
    assert cache_message(tmp_path / "log", "x") is None
    folder.mkdir()
    assert cache_message(tmp_path, "x") is None
    error = OSError(errno.ENOSPC, "No space left on device", str(folder / "wp_some_module" / "it.o"))
    assert "folder of compiled kernels" in str(system_message(error))
    assert "folder of compiled kernels" not in str(system_message(OSError(errno.ENOSPC, "x", "/log")))
