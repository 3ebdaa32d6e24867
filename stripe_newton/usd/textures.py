# SPDX-License-Identifier: Apache-2.0
"""Textures that cannot be read: found at import, where they become rows, since a renderer would end with an error."""

from __future__ import annotations

from pathlib import Path

import newton
from newton.utils import load_texture
from PIL import Image, UnidentifiedImageError

from .ignored_rows import Ignored
from .newton_warnings import collected_warnings

__all__ = ["drop_unreadable_textures"]


def drop_unreadable_textures(builder: newton.ModelBuilder, first: int) -> Ignored:
    """Remove textures whose files cannot be read from meshes, which are then drawn in their colour.

    Args:
        builder: The builder.
        first: First shape.

    Returns:
        A row for each texture, at the first shape that has it.
    """
    rows, reasons = Ignored(), dict[str, str]()
    for shape in range(first, builder.shape_count):
        texture = getattr(mesh := builder.shape_source[shape], "texture", None)
        if not isinstance(texture, str):
            continue
        if texture not in reasons:
            reasons[texture] = _unreadable(texture)
            if reasons[texture]:
                what = f"left out, the mesh is drawn in its colour: {texture} {reasons[texture]}"
                rows.append((builder.shape_label[shape], "texture", what))
        if reasons[texture]:
            mesh.texture = None
    return rows


def _unreadable(texture: str) -> str:
    """Why a texture cannot be read; empty if it can, or is on the web."""
    if "://" in texture:
        return ""
    if "<UDIM>" in texture:
        return "has several tiles, of which none is read"
    if "[" in texture:  # in a package
        with collected_warnings():
            return "cannot be read" if load_texture(texture) is None else ""
    if not Path(texture).is_file():
        return "does not exist" if not Path(texture).exists() else "is no file"
    try:
        _check_picture(texture)
    except Exception as error:  # readers of pictures raise errors of many types
        told = " ".join(str(error).split())
        return "is no picture" if isinstance(error, UnidentifiedImageError) else f"cannot be read: {told}"
    return ""


def _check_picture(file: str) -> None:
    """Raise an error if a picture is damaged, without decoding all of it if its format allows that."""
    with Image.open(file) as picture:
        if picture.format == "PNG":
            picture.verify()  # compares the checksums of its chunks, but for the last that there is
            if b"IEND" not in Path(file).read_bytes()[-64:]:
                raise OSError("image file is truncated")
        else:
            picture.draft("RGB", (1, 1))  # a JPEG in an eighth of its size
            picture.load()
