# SPDX-License-Identifier: Apache-2.0
"""Files by name, slices as text, and the application of the Isaac Lab dialect."""

import argparse

import pytest

from stripe_newton.isaaclab.app import AppLauncher
from stripe_newton.isaaclab.dictionaries import replace_slices_with_strings, replace_strings_with_slices
from stripe_newton.isaaclab.files import ISAAC_NUCLEUS_DIR, check_file_path, read_file, retrieve_file_path


def test_files_of_this_machine_are_found_and_read(tmp_path):
    (tmp_path / "a.txt").write_text("one")
    path = str(tmp_path / "a.txt")
    assert check_file_path(path) == 1
    assert retrieve_file_path(path) == path
    assert read_file(path).read() == b"one"


def test_files_of_the_server_are_named_in_the_error():
    path = f"{ISAAC_NUCLEUS_DIR}/Robots/Unknown/unknown.usd"
    assert check_file_path(path) == 0
    with pytest.raises(FileNotFoundError, match=r"Isaac/Robots/Unknown/unknown\.usd' is on NVIDIA's asset server"):
        retrieve_file_path(path)


def test_slices_become_text_and_come_back():
    data = {"a": [slice(0, 3), 1], "b": {"c": slice(None, None, 2), "d": "text"}}
    assert replace_strings_with_slices(replace_slices_with_strings(data)) == data
    with pytest.raises(ValueError, match="'slice\\(0,x,1\\)' is no slice"):
        replace_strings_with_slices({"a": "slice(0,x,1)"})


def test_the_application_runs_until_it_is_closed():
    parser = argparse.ArgumentParser()
    AppLauncher.add_app_launcher_args(parser)
    args = parser.parse_args(["--headless", "--device", "cpu"])
    app = AppLauncher(args).app
    assert args.device == "cpu"
    assert app.is_running()
    app.close()
    assert not app.is_running()
