# SPDX-License-Identifier: Apache-2.0
"""Composition errors: sublayers, references and payloads of a stage that do not resolve, causes first."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path

from pxr import Usd

from .git_lfs import POINTER_REASON, is_pointer

__all__ = ["composition_problem", "material_file_rows", "without_errors"]

_SUBLAYER = re.compile(r"Could not load sublayer @(?P<file>.*?)@ of layer @(?P<layer>.*?)@")
_ASSET = re.compile(r"Could not open asset @(?P<file>.*?)@ for (?P<arc>\w+) introduced by @.*?@<(?P<prim>.*?)>")
_PRIM = re.compile(
    r"Unresolved (?P<arc>\w+) prim path @(?P<file>.*?)@<(?P<target>.*?)> introduced by @.*?@<(?P<prim>.*?)>"
)
_CYCLE = re.compile(r"@<(?P<prim>[^>]*)> (?:which )?CANNOT (?P<arc>[\w ]+): @.*@<(?P<target>[^>]*)>$")
_SESSION = re.compile(r",@anon:[^@]*@")
"""The layer in memory that USD adds to each stage."""
_MATERIALX = ".mtlx"
_WEB = re.compile(r"\w\w+:/")
_SHOWN = 3


def composition_problem(stage: Usd.Stage) -> tuple[str, str]:
    """Prim and reason of what does not resolve in a stage; both empty if all does, but for files of MaterialX.

    USD reports each prim that misses something from a file that is not there; the missing file is named first.
    """
    texts = [text for text in _texts(stage) if not _is_material_file(text)]
    if not texts:
        return "", ""
    texts.sort(key=lambda text: [bool(kind.search(text)) for kind in (_SUBLAYER, _ASSET)], reverse=True)
    folder = Path(stage.GetRootLayer().realPath or ".").parent
    shown = [_problem(text, folder) for text in texts[:_SHOWN]]
    more = f"; and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else ""
    found = _ASSET.search(texts[0]) or _PRIM.search(texts[0]) or _CYCLE.search(texts[0])
    return found["prim"] if found else "", "; ".join(shown) + more


def material_file_rows(stage: Usd.Stage) -> Iterator[tuple[str, str, str]]:
    """Rows ``(prim, what, why)`` of the references to files of MaterialX, which hold the looks of surfaces alone."""
    for text in filter(_is_material_file, _texts(stage)):
        found = _ASSET.search(text)
        assert found is not None
        name = Path(found["file"]).name
        yield found["prim"], f"reference to {name}", "MaterialX is not read: what it colours is drawn without it"


def without_errors(stage: Usd.Stage) -> Usd.Stage:
    """The stage, of which Newton's importer sees no errors: it would refuse it for a material file."""
    if stage.GetCompositionErrors():
        setattr(stage, "GetCompositionErrors", list)  # noqa: B010  # which type checkers would not allow
    return stage


def _texts(stage: Usd.Stage) -> list[str]:
    """The texts of the errors, each in one line and once."""
    return list(dict.fromkeys(re.sub(r"\s+", " ", str(e)).strip() for e in stage.GetCompositionErrors()))


def _is_material_file(text: str) -> bool:
    found = _ASSET.search(text)
    return found is not None and found["file"].lower().endswith(_MATERIALX)


def _problem(text: str, folder: Path) -> str:
    """A short form of an error, with what would be right."""
    if found := _SUBLAYER.search(text):
        where = f"sublayer '{_short(found['file'], folder)}' of '{_short(found['layer'], folder)}'"
    elif found := _ASSET.search(text):
        where = f"{found['arc']} '{_short(found['file'], folder)}' of prim {found['prim']}"
    elif found := _PRIM.search(text):
        file = _short(found["file"], folder)
        if found["target"] == "defaultPrim":
            return f"{found['arc']} of prim {found['prim']} names no prim of '{file}', which has no defaultPrim; set it"
        return f"{found['arc']} of prim {found['prim']} names prim {found['target']}, which is not in '{file}'"
    elif found := _CYCLE.search(text):
        arc, target = found["arc"], found["target"]
        return f"prim {found['prim']} cannot {arc} {target}, which leads back to it; take that out"
    else:
        return _SESSION.sub("", text)
    return f"{where} {_file_problem(Path(found['file']), text)}"


def _file_problem(file: Path, text: str) -> str:
    if _WEB.match(str(file)):
        return "is on the web, which is not read; download it, and name the copy"
    if not file.is_file():
        return "is not there; add the file, or take the entry out"
    return POINTER_REASON if is_pointer(file) else f"cannot be read: {text.rpartition(' -- ')[2]}"


def _short(file: str, folder: Path) -> str:
    """A path as it is seen from the folder of the stage, if that is shorter."""
    if _WEB.match(file) or not os.path.isabs(file):
        return file
    return min(file, os.path.relpath(file, folder), key=len)
