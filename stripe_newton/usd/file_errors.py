# SPDX-License-Identifier: Apache-2.0
"""File errors: why a file cannot be opened as USD, with line and column where it is text."""

from __future__ import annotations

import re
from pathlib import Path

from .git_lfs import POINTER_REASON, is_pointer

__all__ = ["last_line", "open_error", "path_reason"]

_GRAMMAR = re.compile(r"parse error matching .*?(?P<where> at '.*|$)")
"""A rule of USD's parser by its name in C++."""
_SYNTAX = re.compile(r"'(?P<file>[^'\n]*?):(?P<line>\d+):(?P<column>\d+): (?P<text>.*)")


def path_reason(path: Path) -> str:
    """Why a path is no file that could be USD; empty if it may be."""
    if not path.is_file():
        what = (
            "is a folder" if path.is_dir() else "there is no such file" if not path.exists() else "is no regular file"
        )
        return f"{what}; give a .usd, .usda, .usdc or .usdz file"
    return POINTER_REASON if is_pointer(path) else ""


def open_error(path: Path, error: Exception) -> str:
    """Reason why USD does not open a file: the first syntax error by line and column, or USD's own words."""
    try:
        text = str(error)
    except UnicodeDecodeError:  # the error quotes what is not UTF-8
        return _undecodable(path)
    found = _SYNTAX.search(text)
    if found is not None:
        where = f"line {found['line']}, column {found['column']}"
        other = "" if Path(found["file"]).name == path.name else f" of {found['file']}"
        what = _GRAMMAR.sub(r"syntax error\g<where>", found["text"].rstrip().rstrip(chr(39)))
        return f"{where}{other}: {what}".replace(" at '' in", " in")
    if "Cannot determine file format" in text:
        return (
            f"USD has no format with the suffix '{path.suffix}'; give a .usd, .usda, .usdc or .usdz file, or load a "
            "URDF or MJCF file with file_spawner"
        )
    return first_message(error)


def first_message(error: Exception) -> str:
    """The first message in an error of USD: those after it follow from it."""
    found = re.search(r" in file \S+ : '(.*)'", str(error))
    return found.group(1) if found else last_line(error)


def last_line(error: Exception) -> str:
    """The message in the last line of an error of USD; the rest is its own call stack."""
    try:
        lines = str(error).strip().splitlines()
    except UnicodeDecodeError:
        return "a text that is not UTF-8"
    last = lines[-1].strip() if lines else ""
    message = re.fullmatch(r"Error in '.*' at line \d+ in file .* : '(.*)'", last)
    return message.group(1) if message else last


def _undecodable(path: Path) -> str:
    for number, line in enumerate(path.read_bytes().splitlines(), 1):
        try:
            line.decode()
        except UnicodeDecodeError as error:
            return f"line {number}, column {error.start + 1}: byte {line[error.start]:#04x} is not UTF-8"
    return "a file that it refers to is not UTF-8"
