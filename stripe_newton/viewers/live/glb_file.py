# SPDX-License-Identifier: Apache-2.0
"""GLB file: one triangle mesh with colours or a picture as glTF in binary form, as browsers read it.

trimesh, which viser writes meshes with, keeps colours or a picture but not both, rounds colours to bytes, and has no
surface without light; the ground needs the first, the sky the others.
"""

from __future__ import annotations

import io
import json
import struct

import numpy as np

__all__ = ["glb_of"]

_ARRAY, _ELEMENTS = 34962, 34963
"""glTF's targets of buffers: attributes of vertices, indices."""
_FLOAT, _UINT = 5126, 5125
"""glTF's component types."""


def glb_of(
    vertices: np.ndarray,
    faces: np.ndarray,
    *,
    normals: np.ndarray | None = None,
    colors: np.ndarray | None = None,
    uvs: np.ndarray | None = None,
    picture: np.ndarray | None = None,
    color: np.ndarray | None = None,
    relief: tuple[np.ndarray, float] | None = None,
    unlit: bool = False,
    transparent: bool = False,
    has_holes: bool = False,
    is_jpeg: bool = False,
) -> bytes:
    """A mesh as a GLB file.

    Args:
        vertices: Positions [m], shape ``(n, 3)``; the file keeps their frame, whatever axis is up.
        faces: Indices of three vertices, counterclockwise seen from outside, shape ``(faces, 3)``.
        normals: Unit normals of the vertices, shape ``(n, 3)``. None: the means of the faces around them.
        colors: Linear RGBA of the vertices from 0 to 1, shape ``(n, 4)``. None: white.
        uvs: Places of the vertices in the picture, ``(0, 0)`` its upper left corner, shape ``(n, 2)``.
        picture: sRGB picture on the mesh, uint8, shape ``(height, width, 3)``, or 4 with alpha; beyond 0 to 1 it
            repeats.
        color: Linear RGB from 0 to 1 that multiplies all others, shape ``(3,)``.
        relief: Normal map, uint8, shape ``(height, width, 3)``, and how often it repeats in one picture.
        unlit: Show the colours as they are, without light.
        transparent: Blend by the colours' alpha.
        has_holes: Leave out where the picture's alpha is below a half, and show both sides of the faces.
        is_jpeg: Compress the picture with losses, for large ones without alpha.
    """
    file = _Writer()
    triangles = np.asarray(faces, dtype=np.uint32).reshape(-1)
    if normals is None:
        normals = _normals(np.asarray(vertices, dtype=float), triangles.reshape(-1, 3))
    attributes = {
        "POSITION": file.attribute(vertices, "VEC3", bounds=True),
        "NORMAL": file.attribute(normals, "VEC3"),
    }
    if colors is not None:
        attributes["COLOR_0"] = file.attribute(colors, "VEC4")
    if uvs is not None:
        attributes["TEXCOORD_0"] = file.attribute(uvs, "VEC2")
    indices = file.accessor(triangles.tobytes(), _UINT, len(triangles), "SCALAR", _ELEMENTS)
    surface: dict[str, object] = {"metallicFactor": 0.0, "roughnessFactor": 0.95}
    extensions: list[str] = []
    if picture is not None:
        surface["baseColorTexture"] = {"index": file.picture(picture, is_jpeg)}
    if color is not None:
        surface["baseColorFactor"] = [*map(float, color), 1.0]
    material: dict[str, object] = {"pbrMetallicRoughness": surface, "doubleSided": unlit or has_holes}
    if transparent or has_holes:
        material["alphaMode"] = "MASK" if has_holes else "BLEND"
    if relief is not None:
        often = {"KHR_texture_transform": {"scale": [relief[1], relief[1]]}}
        material["normalTexture"] = {"index": file.picture(relief[0], True), "extensions": often}
        extensions.append("KHR_texture_transform")
    if unlit:
        material["extensions"] = {"KHR_materials_unlit": {}}
        extensions.append("KHR_materials_unlit")
    content: dict[str, object] = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [material],
    }
    if extensions:
        content["extensionsUsed"] = extensions
    return file.glb(content | file.textures())


class _Writer:
    """Collects the binary part of a file."""

    def __init__(self) -> None:
        self._data = bytearray()
        self._views: list[dict[str, object]] = []
        self._accessors: list[dict[str, object]] = []
        self._images: list[dict[str, object]] = []

    def attribute(self, values: np.ndarray, kind: str, bounds: bool = False) -> int:
        """Add floats of the vertices; returns the index of their accessor."""
        rows = np.asarray(values, dtype=np.float32)
        index = self.accessor(rows.tobytes(), _FLOAT, len(rows), kind, _ARRAY)
        if bounds:
            self._accessors[index] |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        return index

    def accessor(self, data: bytes, component: int, count: int, kind: str, target: int) -> int:
        """Add numbers; returns the index of their accessor."""
        view = self._view(data, {"target": target})
        self._accessors.append({"bufferView": view, "componentType": component, "count": count, "type": kind})
        return len(self._accessors) - 1

    def picture(self, picture: np.ndarray, is_jpeg: bool) -> int:
        """Add a picture; returns the index of its texture."""
        from PIL import Image  # comes with viser, which alone shows these files

        data, kind = io.BytesIO(), "jpeg" if is_jpeg else "png"
        Image.fromarray(np.ascontiguousarray(picture[..., :4])).save(data, kind.upper(), quality=80)
        self._images.append({"bufferView": self._view(data.getvalue(), {}), "mimeType": f"image/{kind}"})
        return len(self._images) - 1

    def textures(self) -> dict[str, object]:
        """Entries of the file's content for all pictures."""
        if not self._images:
            return {}
        linear, mipmap, repeat = 9729, 9987, 10497
        return {
            "images": self._images,
            "samplers": [{"magFilter": linear, "minFilter": mipmap, "wrapS": repeat, "wrapT": repeat}],
            "textures": [{"source": i, "sampler": 0} for i in range(len(self._images))],
        }

    def _view(self, data: bytes, more: dict[str, object]) -> int:
        self._data += bytes(-len(self._data) % 4)  # every accessor begins at a multiple of its component's size
        self._views.append({"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data), **more})
        self._data += data
        return len(self._views) - 1

    def glb(self, content: dict[str, object]) -> bytes:
        """The file: a header, the content as JSON, the data."""
        data = bytes(self._data) + bytes(-len(self._data) % 4)
        buffers = [{"byteLength": len(data)}]
        content = content | {"buffers": buffers, "bufferViews": self._views, "accessors": self._accessors}
        text = json.dumps(content).encode()
        text += b" " * (-len(text) % 4)
        length = 12 + 8 + len(text) + 8 + len(data)
        head = struct.pack("<4sII", b"glTF", 2, length)
        return head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data


def _normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Normals of the vertices, the mean over their faces by area, shape ``(n, 3)``."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    of_faces = np.cross(b - a, c - a)
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, faces[:, corner], of_faces)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    # A vertex of no face, or of faces that cancel out, still needs a unit vector.
    return np.where(length > 1e-12, normals / np.maximum(length, 1e-12), np.array([0.0, 0.0, 1.0]))
