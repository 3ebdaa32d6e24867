# SPDX-License-Identifier: Apache-2.0
"""Semantic labels of a stage, by prim and type of label."""

from __future__ import annotations

from pathlib import Path

from pxr import Usd

from .stage_access import open_stage, walk

__all__ = ["read_semantics"]

_TYPE, _DATA = ":params:semanticType", ":params:semanticData"


def read_semantics(source: str | Path | Usd.Stage, root_path: str = "/") -> dict[str, dict[str, list[str]]]:
    """Read the semantic labels of a stage: ``{prim path: {type: [labels]}}`` of the prims that author any.

    Reads ``UsdSemantics.LabelsAPI`` (``semantics:labels:<type>``) and the older pairs of attributes
    ``semantic:<name>:params:semanticType`` and ``semanticData``, whose labels are separated by commas.
    """
    stage = open_stage(source)
    found = {str(prim.GetPath()): _labels_of(prim) for prim in walk(stage, root_path)}
    return {path: labels for path, labels in found.items() if labels}


def _labels_of(prim: Usd.Prim) -> dict[str, list[str]]:
    labels: dict[str, list[str]] = {}
    for attribute in prim.GetAuthoredAttributes():
        name = attribute.GetName()
        if name.startswith("semantics:labels:"):
            _add(labels, name.removeprefix("semantics:labels:"), list(attribute.Get() or []))
        elif name.startswith("semantic:") and name.endswith(_TYPE):
            data = prim.GetAttribute(name.removesuffix(_TYPE) + _DATA)
            text = data.Get() if data else None
            if attribute.Get() and text:
                _add(labels, attribute.Get(), [part.strip() for part in text.split(",")])
    return labels


def _add(labels: dict[str, list[str]], kind: str, values: list[str]) -> None:
    present = labels.setdefault(kind, [])
    present.extend(str(value) for value in values if str(value) not in present)
