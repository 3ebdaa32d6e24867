# SPDX-License-Identifier: Apache-2.0
"""Input files: what is no regular file, or stands for too much, is refused at once."""

from __future__ import annotations

import os
import time

import pytest

from stripe_newton.input_files import InputFileError, read_text, read_yaml, why_no_file

ALIASES = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n" + "\n".join(
    f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (ALIASES, "stands for more than 200000 values"),
        ("a: &a [*a]", "contains itself: the alias 'a' is inside what it stands for"),
        ("a: " + "[" * 5000, "is nested more than 100 deep"),
        ("- " * 300, "is nested more than 100 deep"),
        ("- " * 5000, "is nested more than 100 deep"),
        ("a: [", "is not valid YAML"),
        ("a: *b", "line 1: the alias 'b' stands for nothing before it"),
        ("a: {b: 1, c: 2}\nd: 3\na: 4", "line 3: the key 'a' is there twice"),
        ("- a: 1\n- {x: {a: 1, b: [2], 'a': 3}}", "line 2: the key 'a' is there twice"),
        ("a: [010]", "line 1: '010' is the number 8 in YAML"),
        ("a: 1:30:00.5", "line 1: '1:30:00.5' is a number of base 60 in YAML"),
        ("a: !!int ''", "is not valid YAML: string index out of range"),
        ("a: !!timestamp x", "is not valid YAML: "),
        ("a: !!python/object/apply:os.system ['true']", "is not valid YAML: could not determine a constructor"),
        ("a: " + "9" * 5000, "is not valid YAML: Exceeds the limit"),
        ("x" * (1 << 24) + "yz", "is larger than 17 MB"),
        (b"a: \xff", "is not text (byte 3 is not UTF-8)"),
    ],
)
def test_yaml_that_is_refused(tmp_path, text, message):
    file = tmp_path / "a.yaml"
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    began = time.monotonic()
    with pytest.raises(InputFileError) as caught:
        read_yaml(file)
    assert str(caught.value).startswith(f"{file}: {message}")
    assert time.monotonic() - began < 20.0  # without the bound the aliases take minutes and gigabytes


def test_aliases_that_stand_for_little_are_read(tmp_path):
    (tmp_path / "a.yaml").write_text("a: &a {x: 1}\nb: [*a, *a]\n")
    assert read_yaml(tmp_path / "a.yaml") == {"a": {"x": 1}, "b": [{"x": 1}, {"x": 1}]}


def test_keys_of_different_mappings_and_merged_ones_may_be_equal(tmp_path):
    text = "x: &x {a: 1, b: 2}\ny: {<<: *x, a: 3}\nz: [{a: 1}, {a: 2}, a, a]\nw: '010'\nv: 0.10\nu: 00:a\n"
    (tmp_path / "a.yaml").write_text(text)
    assert read_yaml(tmp_path / "a.yaml") == {
        "x": {"a": 1, "b": 2},
        "y": {"a": 3, "b": 2},
        "z": [{"a": 1}, {"a": 2}, "a", "a"],
        "w": "010",
        "v": 0.1,
        "u": "00:a",
    }


def test_what_is_no_regular_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "dangling").symlink_to("nowhere")
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "zero").symlink_to("/dev/zero")
    said = {name: why_no_file(tmp_path / name) for name in ("pipe", "dangling", "zero", ".", "gone", "a\0b")}
    assert said == {
        "pipe": "is a pipe",
        "dangling": "is a link to nowhere, which does not exist",
        "zero": "is a device",
        ".": "is a folder",
        "gone": "does not exist",
        "a\0b": "is no path of a file",
    }
    assert why_no_file(tmp_path / "loop").startswith("cannot be opened: ")
    with pytest.raises(InputFileError, match="pipe: is a pipe"):
        read_text(tmp_path / "pipe")
