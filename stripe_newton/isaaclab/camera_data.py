# SPDX-License-Identifier: Apache-2.0
"""Camera data of the Isaac Lab dialect: quaternions (w, x, y, z), segmentations as colours where that is asked for."""

from __future__ import annotations

import colorsys
from collections.abc import Iterator, Mapping, MutableMapping
from typing import Any

import torch

from .wxyz_data import WxyzData

__all__ = ["ColorizedCameraData", "segmentation_colors"]

_GOLDEN = 0.618034


def segmentation_colors(count: int) -> torch.Tensor:
    """RGBA colours of labels by number, uint8 of shape ``(count, 4)``: 0, the background, is transparent black."""
    colors = [(0, 0, 0, 0)]
    for number in range(1, count):  # hues that are far apart for neighbouring numbers
        r, g, b = colorsys.hsv_to_rgb(number * _GOLDEN % 1.0, 0.55 + 0.45 * (number % 2), 0.95)
        colors.append((round(255 * r), round(255 * g), round(255 * b), 255))
    return torch.tensor(colors, dtype=torch.uint8)


class ColorizedCameraData(WxyzData):
    """Data of a camera, with the segmentations that are asked for as colours in ``output`` and ``info``."""

    def __init__(self, native: object, colorized: Mapping[str, bool]):
        super().__init__(native)
        object.__setattr__(self, "_colorized", dict(colorized))
        object.__setattr__(self, "_output", None)

    @property
    def output(self) -> MutableMapping[str, torch.Tensor]:
        """Images by data type."""
        if self._output is None:
            object.__setattr__(self, "_output", _Output(self._native, self._colorized))
        return self._output

    @property
    def info(self) -> dict[str, Any]:
        """By data type; labels of colours are by the colour as text, ``"(r, g, b, a)"``."""
        return {kind: self._labelled(kind, text) for kind, text in self._native.info.items()}

    def _labelled(self, kind: str, text: dict[str, Any] | None) -> dict[str, Any] | None:
        if not text or not _is_colorized(kind, self._colorized):
            return text
        labels = text["idToLabels"]
        colors = segmentation_colors(max(labels) + 1).tolist()
        return {**text, "idToLabels": {str(tuple(colors[number])): name for number, name in labels.items()}}


def _is_colorized(kind: str, colorized: Mapping[str, bool]) -> bool:
    return colorized.get(kind.removesuffix("_fast"), False)


class _Output(MutableMapping[str, torch.Tensor]):
    """The images of a camera, segmentations as colours."""

    def __init__(self, native: Any, colorized: Mapping[str, bool]):
        self._native, self._colorized = native, colorized
        self._palettes: dict[str, torch.Tensor] = {}

    def __getitem__(self, kind: str) -> torch.Tensor:
        image = self._native.output[kind]
        if not _is_colorized(kind, self._colorized):
            return image
        if kind not in self._palettes:
            labels = self._native.info[kind]["idToLabels"]
            self._palettes[kind] = segmentation_colors(max(labels) + 1).to(image.device)
        return self._palettes[kind][image.squeeze(-1).long()]

    def __setitem__(self, kind: str, image: torch.Tensor) -> None:
        self._native.output[kind] = image

    def __delitem__(self, kind: str) -> None:
        del self._native.output[kind]

    def __iter__(self) -> Iterator[str]:
        return iter(self._native.output)

    def __len__(self) -> int:
        return len(self._native.output)
