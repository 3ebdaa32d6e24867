# SPDX-License-Identifier: Apache-2.0
"""Irregular files: pipes and devices that a stage refers to, found before USD or a picture reader waits for them."""

from __future__ import annotations

import contextlib
import glob
import os
import stat
from pathlib import Path

from pxr import Ar, Sdf, Tf, UsdUtils

__all__ = ["irregular_file"]


def irregular_file(path: Path) -> str:
    """Path of a file that the stage refers to and that is neither a file nor a folder; empty without one.

    USD would wait for ever for a pipe that nobody writes to, and so would the reader of a texture. Sublayers,
    references, payloads, clips, textures and other assets count, those of layers with an error among them.
    """
    root = str(path)
    seen, todo = {root}, [root]
    variables: dict[str, object] = {}
    while todo:
        name = todo.pop()
        copy = _copied_layer(name)
        if name == root:
            variables = dict(copy.expressionVariables)
        elif variables:  # a stage's override those of the layers below it
            copy.expressionVariables = {**copy.expressionVariables, **variables}
        for target in _assets(copy, name):
            if target in seen:
                continue
            seen.add(target)
            if os.path.isfile(target):
                if Sdf.FileFormat.FindByExtension(target):
                    todo.append(target)
            elif os.path.exists(target) and not stat.S_ISDIR(os.stat(target).st_mode):
                return target
    return ""


def _copied_layer(name: str) -> Sdf.Layer:
    """A copy of a layer to work on; of one with an error, as much as USD reads of it.

    USD composes what it could read of such a layer, and opens the files that this part refers to, before it raises.
    """
    copy = Sdf.Layer.CreateAnonymous(".usda")
    quiet = UsdUtils.CoalescingDiagnosticDelegate()  # opening the stage reports what USD would print
    try:
        if layer := Sdf.Layer.FindOrOpen(name):
            if any(UsdUtils.ExtractExternalReferences(name)):
                copy.TransferContent(layer)
            else:  # the copy of a large layer takes longer than this question, and has nothing to find
                copy.expressionVariables = layer.expressionVariables
    except (Tf.ErrorException, UnicodeDecodeError):
        with contextlib.suppress(Tf.ErrorException, UnicodeDecodeError):  # raised although the content is there
            copy.Import(name)
    finally:
        del quiet
    return copy


def _assets(layer: Sdf.Layer, name: str) -> list[str]:
    """Paths of all files that a layer refers to; tiles of a texture by their own names.

    Args:
        layer: A copy of the layer. Expressions in it are replaced by their values.
        name: File name of the layer, to which its paths are relative.
    """
    found = list[str]()

    def collect(asset: str) -> str:
        found.append(asset)
        return asset

    UsdUtils.ModifyAssetPaths(layer, collect)
    paths = list[str]()
    for asset in dict.fromkeys(found):
        if not asset or Sdf.Layer.IsAnonymousLayerIdentifier(asset):
            continue
        file = Ar.SplitPackageRelativePathOuter(Sdf.Layer.SplitIdentifier(asset)[0])[0]
        target = _resolved(file, name)
        tiles = glob.glob(glob.escape(target).replace("<UDIM>", "[0-9]" * 4)) if "<UDIM>" in target else [target]
        paths.extend(tiles)
    return paths


def _resolved(asset: str, name: str) -> str:
    """Path of an asset by USD's resolver: beside the layer, or where the resolver searches."""
    resolver = Ar.GetResolver()
    identifier = resolver.CreateIdentifier(asset, Ar.ResolvedPath(os.path.abspath(name)))
    # Tiles have no file of that name: beside the layer.
    return resolver.Resolve(identifier).GetPathString() or os.path.join(os.path.dirname(os.path.abspath(name)), asset)
