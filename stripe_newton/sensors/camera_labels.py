# SPDX-License-Identifier: Apache-2.0
"""Segmentation labels: numbers for assets, bodies and shapes, the same in every environment."""

from __future__ import annotations

from typing import TYPE_CHECKING

import newton
import numpy as np

from stripe_newton.sim.scene_context import ENV_0

if TYPE_CHECKING:
    from stripe_newton.assets.scene_assets import SceneAssets

__all__ = ["shape_labels"]


def shape_labels(scene: SceneAssets, model: newton.Model, kind: str) -> tuple[np.ndarray, dict[int, str]]:
    """A number for each shape of a model, and the names behind the numbers.

    Args:
        scene: The scene, for the names of its assets.
        model: The model.
        kind: ``"semantic_segmentation"`` (assets by their names in the scene, parts of a scenery by their labels in
            the stage, else top prims),
            ``"instance_segmentation"`` (bodies, and prims that do not move) or ``"instance_id_segmentation"`` (shapes).

    Returns:
        int32, shape ``(shape_count,)``, from 1 on; and the names by number, 0 being the background.
    """
    owners = [str(model.body_label[body]) if body >= 0 else "" for body in model.shape_body.numpy()]
    labels, assets = list(zip(map(str, model.shape_label), owners, strict=True)), _assets(scene)
    # Shapes of all environments have the labels of the first one: each label is named once.
    named = {(label, owner): _name(label, owner, assets, kind) for label, owner in dict.fromkeys(labels)}
    names = [named[label] for label in labels]
    numbers = {name: i + 1 for i, name in enumerate(dict.fromkeys(names))}
    meaning = {0: "BACKGROUND", **{i: name for name, i in numbers.items()}}
    return np.array([numbers[name] for name in names], dtype=np.int32), meaning


def _assets(scene: SceneAssets) -> dict[str, str]:
    """Names of the assets by path."""
    families = {**scene.articulations, **scene.rigid_objects, **scene.extras}
    found = {asset.path: name for name, asset in families.items()}
    return found if scene.terrain is None else {**found, scene.terrain.path: "terrain", **scene.terrain.labels}


def _name(label: str, owner: str, assets: dict[str, str], kind: str) -> str:
    """The name of a shape in a segmentation, from its label and that of its body."""
    path = label if label.startswith(owner) else f"{owner}/{label}"
    if kind == "instance_id_segmentation":
        return path
    if kind == "instance_segmentation" and owner:
        return owner
    at = max((p for p in assets if path == p or path.startswith(p + "/")), key=len, default="")
    if kind == "semantic_segmentation" and at:
        return assets[at]
    parts = path.split("/")
    return at or "/".join(parts[: 5 if path.startswith(ENV_0) else 3])
