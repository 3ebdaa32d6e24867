# SPDX-License-Identifier: Apache-2.0
"""Packed tensors: large tensors of nested dicts and lists as compressed bytes, for checkpoints."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator
from typing import TypedDict

import torch

__all__ = ["MAX_RATIO", "PackedTensor", "pack_tensors", "unpack_tensors"]

MAX_RATIO = 64
"""Most bytes that a byte of a packed value unpacks to, so that a small file cannot fill the memory."""
_MIN_BYTES = 4096
"""Tensors below this size are left as they are: the entry of a tensor in the file takes some hundred bytes itself."""
_SAMPLE_BYTES = 8192
_WORTHWHILE = 0.75
"""Largest share of its size that a tensor may keep. Noisy observations and random numbers keep more, and would take
most of the time."""
_KEYS = {"zlib", "dtype", "shape", "on_device"}


class PackedTensor(TypedDict):
    """A tensor as compressed bytes. A checkpoint has it in place of the tensor."""

    zlib: torch.Tensor
    """Bytes of the elements in order, compressed by zlib, uint8 ``(bytes,)``."""
    dtype: torch.dtype
    """Type of an element."""
    shape: list[int]
    """Shape of the tensor."""
    on_device: bool
    """Whether the tensor was on a GPU."""


def pack_tensors(value: object) -> object:
    """Nested dicts and lists in which large tensors that shrink are :class:`PackedTensor`; others are as they were.

    A tensor that occurs several times is packed once. If all would shrink by more than :data:`MAX_RATIO`, nothing is
    packed.
    """
    done: dict[int, object] = {}
    packed = _packed(value, done)
    before, after = _bytes_of(packed)
    return packed if before <= MAX_RATIO * after else value


def unpack_tensors(value: object, device: str | torch.device = "cpu", available: int | None = None) -> object:
    """Undo :func:`pack_tensors`. Tensors that were on a GPU go to ``device``.

    Args:
        value: What :func:`pack_tensors` returned, from a file that may be wrong.
        device: Device of the tensors.
        available: Size of the file [bytes], for the check that it does not unpack to more than it could contain. By
            default that of ``value``.

    Raises:
        ValueError: if a packed tensor is damaged, or if all of them would take too much memory.
    """
    before, after = _bytes_of(value)
    if before > MAX_RATIO * max(after, available or 0):
        raise ValueError(f"its tensors unpack to {before / 1e6:.0f} MB, more than it could contain")
    return _unpacked(value, torch.device(device), {})


def _packed(value: object, done: dict[int, object]) -> object:
    if isinstance(value, dict):
        return {name: _packed(item, done) for name, item in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)([_packed(item, done) for item in value])
    if not isinstance(value, torch.Tensor) or value.numel() * value.element_size() < _MIN_BYTES:
        return value
    if id(value) not in done:
        done[id(value)] = _pack_tensor(value)
    return done[id(value)]


def _pack_tensor(tensor: torch.Tensor) -> PackedTensor | torch.Tensor:
    content = tensor.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy()
    # From the middle: the first rows may be those of the ground, or of environments that just began.
    start = max(0, (len(content) - _SAMPLE_BYTES) // 2)
    sample = content[start : start + _SAMPLE_BYTES]
    if len(zlib.compress(sample, 1)) > _WORTHWHILE * len(sample):
        return tensor
    packed = zlib.compress(content, 1)
    if len(packed) > _WORTHWHILE * len(content):
        return tensor
    return {
        "zlib": torch.frombuffer(bytearray(packed), dtype=torch.uint8),
        "dtype": tensor.dtype,
        "shape": list(tensor.shape),
        "on_device": tensor.device.type != "cpu",
    }


def _unpacked(value: object, device: torch.device, done: dict[int, torch.Tensor]) -> object:
    if isinstance(value, dict):
        if not _is_packed(value):
            return {name: _unpacked(item, device, done) for name, item in value.items()}
        # By the bytes: torch makes another dict of each place, with the same bytes in it.
        key = value["zlib"].data_ptr() if isinstance(value["zlib"], torch.Tensor) else 0
        if key not in done:
            done[key] = _unpack_tensor(value, device)
        return done[key]
    if isinstance(value, (list, tuple)):
        return type(value)([_unpacked(item, device, done) for item in value])
    return value


def _unpack_tensor(packed: dict, device: torch.device) -> torch.Tensor:
    size = _size_of(packed)
    unpacker = zlib.decompressobj()
    try:
        content = unpacker.decompress(packed["zlib"].numpy().tobytes(), size + 1)
    except zlib.error as error:
        raise ValueError(f"a packed tensor is damaged ({error})") from None
    if len(content) != size or not unpacker.eof:
        raise ValueError(f"a packed tensor is damaged: its shape is {packed['shape']}, and it is of another size")
    tensor = torch.frombuffer(bytearray(content), dtype=packed["dtype"]).reshape(packed["shape"])
    return tensor.to(device) if packed["on_device"] else tensor


def _is_packed(value: dict) -> bool:
    return set(value) == _KEYS


def _size_of(packed: dict) -> int:
    """Bytes of the tensor; checks the types of the parts."""
    content, dtype, shape = packed["zlib"], packed["dtype"], packed["shape"]
    if not (
        isinstance(content, torch.Tensor)
        and content.dtype == torch.uint8
        and content.dim() == 1
        and content.device.type == "cpu"
        and isinstance(dtype, torch.dtype)
        and isinstance(shape, list)
        and all(type(length) is int and length > 0 for length in shape)
        and isinstance(packed["on_device"], bool)
    ):
        raise ValueError("a packed tensor is damaged: its parts have wrong types")
    return math.prod(shape) * dtype.itemsize


def _bytes_of(value: object) -> tuple[int, int]:
    """Bytes of all tensors in nested dicts and lists, unpacked and packed."""
    sizes = [(0, 0), *_sizes(value)]
    return sum(before for before, _ in sizes), sum(after for _, after in sizes)


def _sizes(value: object) -> Iterator[tuple[int, int]]:
    if isinstance(value, torch.Tensor):
        size = value.numel() * value.element_size()
        yield size, size
    elif isinstance(value, dict) and _is_packed(value):
        yield _size_of(value), value["zlib"].numel()
    elif isinstance(value, (dict, list, tuple)):
        for item in value.values() if isinstance(value, dict) else value:
            yield from _sizes(item)
