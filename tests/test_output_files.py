# SPDX-License-Identifier: Apache-2.0
"""Output files: places are tried without a trace, and results are written whole or not at all."""

from __future__ import annotations

import errno
import os

import pytest

from stripe_newton.cli.user_error import UserError
from stripe_newton.cli.written_places import try_place, write_result
from stripe_newton.output_files import try_file, try_folder, write_whole


def everything(folder) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


def make_places(folder) -> None:
    (folder / "file").write_text("old")
    (folder / "empty").mkdir()
    (folder / "loop").symlink_to("loop")
    (folder / "dangling").symlink_to("new/there")
    os.mkfifo(folder / "pipe")


def test_what_can_be_written_leaves_no_trace(tmp_path):
    make_places(tmp_path)
    before = everything(tmp_path)
    for name in ("file", "new.json", "a/b/c.json", "dangling"):
        try_file(tmp_path / name)
    for name in ("empty", "a/b", "."):
        try_folder(tmp_path / name)
    try_file("/dev/null")
    assert everything(tmp_path) == before
    assert (tmp_path / "file").read_text() == "old"


@pytest.mark.parametrize(
    ("name", "number"),
    [
        ("empty", errno.EISDIR),
        ("file/below", errno.ENOTDIR),
        ("loop", errno.ELOOP),
        ("pipe", errno.ENXIO),
        ("n" * 300, errno.ENAMETOOLONG),
        ("a\0b", errno.EINVAL),
        ("/proc/x", errno.ENOENT),
        ("", errno.EISDIR),
    ],
)
def test_what_cannot_be_written_says_why(tmp_path, name, number):
    make_places(tmp_path)
    before = everything(tmp_path)
    with pytest.raises(OSError) as caught:
        try_file(tmp_path / name if name else "")
    assert caught.value.errno == number
    if name not in ("empty", "", "a\0b"):
        with pytest.raises(OSError):
            try_folder(tmp_path / name)
    assert everything(tmp_path) == before


@pytest.mark.parametrize("path", ["file", "pipe", "/dev/full"])
def test_a_file_is_no_folder(tmp_path, path):
    make_places(tmp_path)
    with pytest.raises(NotADirectoryError):
        try_folder(tmp_path / path)


def test_a_result_is_written_whole_or_printed(tmp_path, capsys, monkeypatch):
    file = tmp_path / "a" / "result.json"
    write_result("--json", file, "1\n")
    write_whole(tmp_path / "link", "first")
    (tmp_path / "link").unlink()
    (tmp_path / "link").symlink_to("a/result.json")
    write_whole(tmp_path / "link", "2\n")
    assert file.read_text() == "2\n"
    assert (tmp_path / "link").is_symlink()
    with pytest.raises(UserError, match="--json /dev/full: could not be written: No space left on device; its content"):
        write_result("--json", type(file)("/dev/full"), "the result\n")
    assert capsys.readouterr().out == "the result\n"
    with pytest.raises(UserError, match=r"--json '.*a\\x00b': cannot be written: Invalid argument"):
        try_place("--json", tmp_path / "a\0b")

    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left"):
        write_whole(file, "3\n")
    assert file.read_text() == "2\n"
    assert everything(tmp_path) == {"a", "a/result.json", "link"}
