# SPDX-License-Identifier: Apache-2.0
"""Input files: what is no regular file is refused before it is opened, and texts and YAML are read within bounds.

A pipe that nobody writes to would be waited for, a device would be read without end, and a small YAML file may stand
for gigabytes.
"""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator

import yaml

__all__ = ["InputFileError", "SafeLoader", "read_text", "read_yaml", "why_no_file"]

MOST_BYTES = 1 << 24
"""Largest text that is read [bytes]; a config has some ten thousand."""
MOST_NODES = 200_000
"""Most values that a YAML file may stand for, its aliases written out; a config has some thousand."""
MOST_DEPTH = 100
"""Deepest nesting of a YAML file."""
LIBYAML_TOO_DEEP = "exceeded maximum nesting depth"
"""libyaml's own word, since 0.2.6, for a text nested more than 1000 deep; its scanner reads ahead of the events."""

_MERGE = "<<"
"""Key whose value is merged into a mapping; keys beside it override what it brings."""
_OCTAL = re.compile(r"[-+]?0[0-7]+")
_BASE_60 = re.compile(r"[-+]?[1-9][0-9]*(:[0-5]?[0-9])+(\.[0-9]*)?|[-+]?[0-9]+(:[0-5]?[0-9])+\.[0-9]*")
"""As PyYAML has them; ``0:59`` is text for it."""

_OTHERS = (
    (stat.S_ISDIR, "is a folder"),
    (stat.S_ISFIFO, "is a pipe"),
    (stat.S_ISSOCK, "is a socket"),
    (stat.S_ISCHR, "is a device"),
    (stat.S_ISBLK, "is a device"),
)

SafeLoader: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
"""PyYAML's loader of plain values, the fast one where it is built in."""


class InputFileError(ValueError):
    """A file that is missing, is no regular file, is too large, or contains something else than it must."""


def why_no_file(path: str | os.PathLike[str]) -> str:
    """Why a path is no regular file, such as ``"is a pipe"``; empty if it is one."""
    try:
        mode = os.stat(path).st_mode
    except FileNotFoundError:
        if os.path.islink(path):
            return f"is a link to {os.readlink(path)}, which does not exist"
        return "does not exist"
    except OSError as error:
        return f"cannot be opened: {error.strerror or error}"
    except ValueError:  # a null character
        return "is no path of a file"
    return next((text for is_kind, text in _OTHERS if is_kind(mode)), "")


def read_text(path: str | os.PathLike, most: int = MOST_BYTES) -> str:
    """The text of a file.

    Args:
        path: The file.
        most: Largest size [bytes].

    Raises:
        InputFileError: if it is no regular file, larger than ``most``, or no UTF-8.
    """
    if problem := why_no_file(path):
        raise InputFileError(f"{path}: {problem}")
    try:
        with open(path, "rb") as file:
            content = file.read(most + 1)
    except OSError as error:
        raise InputFileError(f"{path}: cannot be read: {error.strerror or error}") from None
    if len(content) > most:
        raise InputFileError(f"{path}: is larger than {most / 1e6:.0f} MB, which is no text that belongs here")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputFileError(f"{path}: is not text (byte {error.start} is not UTF-8)") from None


def read_yaml(path: str | os.PathLike, loader: type[yaml.SafeLoader] = SafeLoader) -> object:
    """The content of a YAML file: plain values, without running code.

    Args:
        path: The file.
        loader: Loader, :data:`SafeLoader` or a subclass.

    Raises:
        InputFileError: as :func:`read_text`, if it is no YAML, or if it stands for too many values.
    """
    text = read_text(path)
    try:
        if problem := _excess(text):
            raise InputFileError(f"{path}: {problem}")
        content: object = yaml.load(text, loader)
    except (InputFileError, MemoryError):
        raise
    except Exception as error:  # PyYAML raises more than its own: `!!int ''` is an IndexError
        if getattr(error, "problem", None) == LIBYAML_TOO_DEEP:
            raise InputFileError(f"{path}: is nested more than {MOST_DEPTH} deep") from None
        raise InputFileError(f"{path}: is not valid YAML: {' '.join(str(error).split())[:200]}") from None
    return content


def _excess(text: str) -> str:
    """Why a YAML text is not loaded, found in its events, which are not nested; empty if it may be."""
    sizes, keys = _Sizes(), _Keys()
    for event in _events(text):
        if problem := keys.take(event) or _ambiguity(event):
            return f"line {event.start_mark.line + 1}: {problem}"
        if isinstance(event, (yaml.MappingStartEvent, yaml.SequenceStartEvent)):
            sizes.begin(event.anchor)
        elif isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
            sizes.end()
        elif isinstance(event, yaml.ScalarEvent):
            sizes.add(1, event.anchor)
        elif isinstance(event, yaml.AliasEvent):
            if event.anchor not in sizes.by_anchor:
                if event.anchor in [anchor for anchor, _ in sizes.open]:
                    return f"contains itself: the alias '{event.anchor}' is inside what it stands for"
                return f"line {event.start_mark.line + 1}: the alias '{event.anchor}' stands for nothing before it"
            sizes.add(sizes.by_anchor[event.anchor], None)
        if sizes.total > MOST_NODES:
            return f"stands for more than {MOST_NODES} values; is it a file of configs?"
        if len(sizes.open) > MOST_DEPTH:
            return f"is nested more than {MOST_DEPTH} deep"
    return ""


def _events(text: str) -> Iterator[yaml.Event]:
    return yaml.parse(text, SafeLoader)


def _ambiguity(event: yaml.Event) -> str:
    """Why a number is refused that YAML 1.1, which PyYAML reads, takes for another one than a reader."""
    if not isinstance(event, yaml.ScalarEvent) or not event.implicit[0] or event.style:
        return ""
    text = event.value.replace("_", "")
    if _OCTAL.fullmatch(text):
        return f"'{text}' is the number {int(text, 8)} in YAML; write that, or '{text}' in quotes for text"
    if _BASE_60.fullmatch(text):
        return f"'{text}' is a number of base 60 in YAML; write '{text}' in quotes for text"
    return ""


class _Keys:
    """Keys of the mappings of a YAML text: of two equal ones PyYAML takes the second without a word."""

    def __init__(self) -> None:
        self._open: list[tuple[set[str] | None, bool]] = []
        """Keys of the mappings that have not ended, None for sequences; and whether a key comes next."""

    def take(self, event: yaml.Event) -> str:
        """Take the next event; returns what is wrong with it."""
        if isinstance(event, (yaml.MappingEndEvent, yaml.SequenceEndEvent)):
            self._open.pop()
            return ""
        if not isinstance(event, yaml.NodeEvent):
            return ""
        problem = ""
        if self._open:
            keys, is_key = self._open[-1]
            if keys is not None and is_key and isinstance(event, yaml.ScalarEvent) and event.value != _MERGE:
                if event.value in keys:
                    problem = f"the key '{event.value[:80]}' is there twice"
                keys.add(event.value)
            self._open[-1] = keys, not is_key
        if isinstance(event, yaml.MappingStartEvent):
            self._open.append((set(), True))
        elif isinstance(event, yaml.SequenceStartEvent):
            self._open.append((None, False))
        return problem


class _Sizes:
    """Numbers of values in the parts of a YAML text, with aliases written out."""

    def __init__(self) -> None:
        self.total = 0
        self.by_anchor: dict[str, int] = {}
        self.open: list[tuple[str | None, int]] = []
        """Anchors of the parts that have not ended, and the totals at their beginnings."""

    def begin(self, anchor: str | None) -> None:
        """Begin a mapping or a sequence."""
        self.open.append((anchor, self.total))
        self.total += 1

    def end(self) -> None:
        """End it."""
        anchor, before = self.open.pop()
        if anchor is not None:
            self.by_anchor[anchor] = self.total - before

    def add(self, count: int, anchor: str | None) -> None:
        """Add values."""
        self.total += count
        if anchor is not None:
            self.by_anchor[anchor] = count
