# SPDX-License-Identifier: Apache-2.0
"""Textures that cannot be read: found before a renderer would end with an error.

At import they become rows. A scene may have thousands, each of which takes a thousandth of a second for each million
pixels: a file whose header and end are right is looked at as a whole only when a picture is drawn.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import newton
from newton.utils import load_texture
from PIL import Image, UnidentifiedImageError

from .ignored_rows import Ignored
from .newton_warnings import collected_warnings

__all__ = ["drop_unreadable_textures"]

_ENDS = {"JPEG": b"\xff\xd9", "PNG": b"IEND"}
"""The last bytes of a picture by its format."""
_MAX_THREADS = 8


def drop_unreadable_textures(builder: newton.ModelBuilder, first: int, whole: bool = False) -> Ignored:
    """Remove textures whose files cannot be read from meshes, which are then drawn in their colour.

    Args:
        builder: The builder.
        first: First shape.
        whole: Read each file as a whole. Without it the header and the end of JPEG and PNG files are enough.

    Returns:
        A row for each texture, at the first shape that has it.
    """
    rows, shapes = Ignored(), dict[str, list[int]]()
    for shape in range(first, builder.shape_count):
        texture = getattr(builder.shape_source[shape], "texture", None)
        if isinstance(texture, str):
            shapes.setdefault(texture, []).append(shape)
    for texture, reason in zip(shapes, _reasons(list(shapes), whole), strict=True):
        if reason:
            what = f"left out, the mesh is drawn in its colour: {texture} {reason}"
            rows.append((builder.shape_label[shapes[texture][0]], "texture", what))
            for shape in shapes[texture]:
                builder.shape_source[shape].texture = None
    return rows


def _reasons(textures: list[str], whole: bool) -> list[str]:
    """:func:`_unreadable` of each texture; decoders of pictures let other threads run."""
    if not whole or len(textures) < 2:
        return [_unreadable(texture, whole) for texture in textures]
    with ThreadPoolExecutor(min(_MAX_THREADS, os.cpu_count() or 1)) as pool:
        return list(pool.map(lambda texture: _unreadable(texture, whole), textures))


def _unreadable(texture: str, whole: bool) -> str:
    """Why a texture cannot be read; empty if it can."""
    if "://" in texture:  # Newton would wait for it, and end with an error where there is no network
        return "is on the web, which is not read; download it, and name the copy"
    if "<UDIM>" in texture:
        return "has several tiles, of which none is read"
    if "[" in texture:  # in a package
        with collected_warnings():
            return "cannot be read" if load_texture(texture) is None else ""
    if not Path(texture).is_file():
        return "does not exist" if not Path(texture).exists() else "is no file"
    try:
        _check_picture(texture, whole)
    except Exception as error:  # readers of pictures raise errors of many types
        told = " ".join(str(error).split())
        return "is no picture" if isinstance(error, UnidentifiedImageError) else f"cannot be read: {told}"
    return ""


def _check_picture(file: str, whole: bool) -> None:
    """Raise an error if a picture is damaged, without decoding all of it if its format allows that."""
    with Image.open(file) as picture:
        complete = picture.format in _ENDS and _ENDS[picture.format] in _tail(file)
        if complete and not whole:
            return
        if picture.format == "PNG":
            picture.verify()  # compares the checksums of its chunks, but for the last that there is
            if not complete:
                raise OSError("image file is truncated")
        else:
            picture.draft("RGB", (1, 1))  # a JPEG in an eighth of its size
            picture.load()


def _tail(file: str) -> bytes:
    """The last bytes of a file, after which some cameras write a few of their own."""
    with Path(file).open("rb") as stream:
        stream.seek(max(0, os.path.getsize(file) - 64))
        return stream.read()
