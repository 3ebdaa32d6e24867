# SPDX-License-Identifier: Apache-2.0
"""Functions of ``isaaclab.utils`` on nested dicts, and the version of Isaac Sim that the dialect answers with."""

from __future__ import annotations

from packaging.version import Version

__all__ = ["get_isaac_sim_version", "replace_slices_with_strings", "replace_strings_with_slices"]

_SLICE = "slice("


def replace_slices_with_strings(data: object) -> object:
    """A copy of nested dicts, lists and tuples with each slice as text, such as ``"slice(0,3,None)"``."""
    if isinstance(data, dict):
        return {key: replace_slices_with_strings(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [replace_slices_with_strings(value) for value in data]
    return f"{_SLICE}{data.start},{data.stop},{data.step})" if isinstance(data, slice) else data


def replace_strings_with_slices(data: object) -> object:
    """The inverse of :func:`replace_slices_with_strings`.

    Raises:
        ValueError: a text begins like a slice and is not one.
    """
    if isinstance(data, dict):
        return {key: replace_strings_with_slices(value) for key, value in data.items()}
    if isinstance(data, (list, tuple)):
        return [replace_strings_with_slices(value) for value in data]
    return _slice_of(data) if isinstance(data, str) and data.startswith(_SLICE) else data


def _slice_of(text: str) -> slice:
    parts = [part.strip() for part in text.removeprefix(_SLICE).removesuffix(")").split(",")]
    try:
        numbers = [None if part == "None" else int(part) for part in parts]
    except ValueError:
        numbers = []
    if len(numbers) != 3:
        raise ValueError(f"'{text}' is no slice; expected 'slice(start,stop,step)' of whole numbers or None")
    return slice(*numbers)


def get_isaac_sim_version() -> Version:
    """The version that Isaac Lab 2.3 is written for. Isaac Sim itself is not there."""
    return Version("5.1.0")
