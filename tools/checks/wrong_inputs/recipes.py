# SPDX-License-Identifier: Apache-2.0
"""Recipes: steps that prepare the files of a trial in its own folder, by name."""

from __future__ import annotations

import json
import os
import random
import shutil
import struct
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

__all__ = ["RECIPES", "make_big_zip", "prepare"]


def prepare(steps: list[list[Any]], templates: dict[str, str]) -> None:
    """Carry out steps, ``[name, *arguments]``, in the working directory."""
    for name, *arguments in steps:
        if name == "copy_run":
            task, target = arguments
            shutil.copytree(templates[task], target)
        elif name == "big_zip":
            shutil.copy(templates[name], _newest(*arguments))
        else:
            RECIPES[name](*arguments)


def _yaml_set(file: str, path: str, value: str) -> None:
    """Set a value in a YAML file: the path is dotted, the value an expression."""
    text = Path(file).read_text()
    data = yaml.safe_load(text)
    *groups, last = path.split(".")
    place = data
    for group in groups:
        place = place.setdefault(group, {}) if isinstance(place.get(group, {}), dict) else place
    place[last] = eval(value)
    Path(file).write_text(yaml.safe_dump(data))


def _rename(path: str, other: str) -> None:
    Path(other).parent.mkdir(parents=True, exist_ok=True)
    Path(path).rename(other)


def _newest(run: str) -> Path:
    return sorted(Path(run, "checkpoints").glob("*.pt"), key=lambda p: int(p.stem.rpartition("_")[2]))[-1]


def _checkpoint_set(run: str, path: list[Any], value: str) -> None:
    """Set a value in the newest checkpoint; the value is an expression, which may use ``old``."""
    file = _newest(run)
    data = torch.load(file, weights_only=False)
    place = data
    for key in path[:-1]:
        place = place[key]
    if value == "DELETE":
        if path[-1] != "ranks":  # which a training of one process does not have
            del place[path[-1]]
    else:
        old = place.get(path[-1]) if isinstance(place, dict) else None
        place[path[-1]] = eval(value, {"torch": torch, "np": np, "old": old, "object": object})
    torch.save(data, file)


def _checkpoint_pack(run: str, part: str, value: str) -> None:
    """A compressed tensor in the newest checkpoint, with a wrong part; the value is an expression or ``DELETE``."""
    content = torch.frombuffer(bytearray(zlib.compress(bytes(4000))), dtype=torch.uint8)
    packed = {"zlib": content, "dtype": torch.float32, "shape": [10, 100], "on_device": False}
    old = packed.pop(part)
    if value != "DELETE":
        packed[part] = eval(value, {"torch": torch, "np": np, "old": old, "object": object})
    file = _newest(run)
    data = torch.load(file, weights_only=False)
    data["stripe_newton"]["env"]["env"]["arrays"]["joint_q"] = packed
    torch.save(data, file)


def _checkpoint_replace(run: str, expression: str) -> None:
    """Another object in place of the newest checkpoint."""
    torch.save(eval(expression, {"torch": torch, "np": np, "Path": Path}), _newest(run))


def _nan_weights(run: str, key: str, value: float) -> None:
    file = _newest(run)
    data = torch.load(file, weights_only=False)
    for tensor in data[key].values():
        if tensor.is_floating_point():
            tensor.view(-1)[0] = value
    torch.save(data, file)


def _damage(file: str, kind: str, seed: int) -> None:
    """Random damage of the bytes of a file; of a run folder, its newest checkpoint."""
    path = _newest(file) if Path(file).is_dir() else Path(file)
    rng, content = random.Random(seed), bytearray(path.read_bytes())
    if kind == "cut":
        content = content[: rng.randrange(len(content))]
    elif kind == "flip":
        for _ in range(rng.randrange(1, 20)):
            content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    elif kind == "zero":
        start = rng.randrange(len(content))
        content[start : start + rng.randrange(1, 4000)] = bytes(min(4000, len(content) - start))
    elif kind == "insert":
        start = rng.randrange(len(content))
        content[start:start] = rng.randbytes(rng.randrange(1, 300))
    elif kind == "random":
        content = bytearray(rng.randbytes(rng.randrange(2000)))
    elif kind == "double":
        content = content + content
    path.write_bytes(content)


def _zip(file: str, kind: str) -> None:
    """An odd zip file; of a run folder, in place of its newest checkpoint."""
    path = _newest(file) if Path(file).is_dir() else Path(file)
    content = path.read_bytes()
    if kind == "encrypted":  # the flag of encryption in each header
        content = bytearray(content)
        for mark, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
            at = content.find(mark)
            while at >= 0:
                content[at + offset] |= 1
                at = content.find(mark, at + 4)
        path.write_bytes(content)
        return
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    packing = {"deflated": zipfile.ZIP_DEFLATED, "bzip2": zipfile.ZIP_BZIP2, "lzma": zipfile.ZIP_LZMA}
    with zipfile.ZipFile(path, "w", packing.get(kind, zipfile.ZIP_STORED), compresslevel=9) as archive:
        for name, data in members.items():
            archive.writestr("../" + name if kind == "dots" else name, data)
            if kind == "twice":
                archive.writestr(name, data)
        if kind == "empty":
            archive.comment = b"x"
    if kind == "method":
        content = bytearray(path.read_bytes())
        for mark, offset in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
            at = content.find(mark)
            while at >= 0:
                struct.pack_into("<H", content, at + offset, 97)
                at = content.find(mark, at + 4)
        path.write_bytes(content)


def make_big_zip(path: Path, gigabytes: int = 6) -> None:
    """Write a small file that unpacks to many gigabytes."""
    with (
        zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as archive,
        archive.open("archive/data.pkl", "w", force_zip64=True) as member,
    ):
        for _ in range(gigabytes * 64):
            member.write(bytes(1 << 24))


def _onnx_metadata(file: str, key: str, value: str) -> None:
    """Set or delete a key of the metadata of an ONNX file; the value is an expression that is written as JSON."""
    import onnx

    model = onnx.load(file)
    keep = [item for item in model.metadata_props if item.key != key]
    found = {item.key: json.loads(item.value) for item in model.metadata_props}
    model.ClearField("metadata_props")
    for item in keep:
        model.metadata_props.add(key=item.key, value=item.value)
    if value != "DELETE":
        new = eval(value, {"old": found.get(key)})
        text = new.removeprefix("RAW:") if isinstance(new, str) and new.startswith("RAW:") else json.dumps(new)
        model.metadata_props.add(key=key, value=text)
    onnx.save(model, file)


def _onnx_weights(file: str, value: float) -> None:
    """Set a number of each weight of an ONNX file."""
    import onnx
    from onnx import numpy_helper

    model = onnx.load(file)
    for weight in model.graph.initializer:
        array = numpy_helper.to_array(weight).copy()
        if array.dtype == np.float32:
            array.reshape(-1)[:] = value
            weight.CopyFrom(numpy_helper.from_array(array, weight.name))
    onnx.save(model, file)


def _bomb(file: str, kind: str) -> None:
    """YAML that is small, and large when it is read."""
    if kind == "aliases":
        lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
        lines += [f"a{n}: &a{n} [{', '.join([f'*a{n - 1}'] * 9)}]" for n in range(1, 12)]
        text = "\n".join(lines)
    elif kind == "cycle":
        text = "sim: &s\n  dt: 0.1\n  more: *s\n"
    elif kind == "merge":
        text = "a0: &a0 {x: 1}\n" + "\n".join(
            f"a{n}: &a{n} {{<<: [*a{n - 1}, *a{n - 1}], y{n}: 1}}" for n in range(1, 22)
        )
    elif kind == "deep":
        text = "a: " + "[" * 100_000
    elif kind == "deep map":
        text = "a:\n" + "\n".join(" " * n + "a:" for n in range(1, 3000))
    elif kind == "long":
        text = "a: '" + "x" * 40_000_000 + "'"
    elif kind == "many":
        text = "\n".join(f"k{n}: {n}" for n in range(300_000))
    elif kind == "python":
        text = "a: !!python/object/apply:os.system ['touch pwned']\n"
    elif kind == "binary":
        text = "a: !!binary aGVsbG8=\nb: 2020-01-01\nc: !!set {a, b}\n"
    else:
        text = {
            "list": "- 1\n- 2\n",
            "text": "hello\n",
            "empty": "",
            "number": "3\n",
            "null keys": "null: 1\n? [a]\n: 2\n",
        }[kind]
    Path(file).write_text(text)


def _special(file: str, kind: str) -> None:
    """Something that is no regular file, in the place of a file."""
    path = _newest(file) if Path(file).is_dir() and kind != "folder" else Path(file)
    if path.is_dir():
        shutil.rmtree(path)
    path.unlink(missing_ok=True)
    if kind == "fifo":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "socket":
        import socket

        socket.socket(socket.AF_UNIX).bind(os.path.relpath(path))
    elif kind == "loop":
        path.symlink_to(path.name)
    elif kind == "gone":
        pass
    else:
        path.symlink_to({"zero": "/dev/zero", "null": "/dev/null", "tty": "/dev/tty", "full": "/dev/full"}[kind])


def _go(path: str) -> None:
    """Make a folder and go there."""
    Path(path).mkdir(parents=True)
    os.chdir(path)


def _go_nowhere() -> None:
    """Go to a folder and remove it."""
    _go("gone")
    Path("../gone").resolve().rmdir()


def _text(file: str, old: str, new: str) -> None:
    path = Path(file)
    path.write_text(path.read_text().replace(old, new))


RECIPES: dict[str, Callable[..., object]] = {
    "write": lambda file, text: Path(file).write_text(text),
    "write_bytes": lambda file, text: Path(file).write_bytes(bytes.fromhex(text)),
    "mkdir": lambda path: Path(path).mkdir(),
    "mkfifo": os.mkfifo,
    "rename": _rename,
    "remove": lambda path: shutil.rmtree(path) if Path(path).is_dir() else Path(path).unlink(missing_ok=True),
    "symlink": lambda target, path: Path(path).symlink_to(target),
    "copy": shutil.copy,
    "yaml_set": _yaml_set,
    "checkpoint_set": _checkpoint_set,
    "checkpoint_pack": _checkpoint_pack,
    "checkpoint_replace": _checkpoint_replace,
    "nan_weights": _nan_weights,
    "damage": _damage,
    "zip": _zip,
    "onnx_metadata": _onnx_metadata,
    "onnx_weights": _onnx_weights,
    "bomb": _bomb,
    "special": _special,
    "text": _text,
    "go": _go,
    "go_nowhere": _go_nowhere,
}
"""Steps by name."""
