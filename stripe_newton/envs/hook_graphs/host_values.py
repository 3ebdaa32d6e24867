# SPDX-License-Identifier: Apache-2.0
"""Host values in hooks: reads of tensors' values, which no graph can hold, and tensors made from Python's numbers."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path as FilePath
from types import CodeType, FrameType, TracebackType

import numpy as np
import torch
from torch.overrides import TorchFunctionMode

__all__ = [
    "ExecutedCode",
    "HostCalls",
    "NotRecordable",
    "NumbersOnDevice",
    "error_location",
    "executed_code",
    "location_of_name",
    "short_location",
]

_LIBRARIES = ("torch", "warp", "newton", "stripe_newton", "numpy", "stripe_kernels")
_READS = {
    torch.Tensor.item, torch.Tensor.tolist, torch.Tensor.numpy, torch.Tensor.cpu, torch.Tensor.__bool__,
    torch.Tensor.__int__, torch.Tensor.__float__, torch.Tensor.__index__, torch.Tensor.__array__,
    torch.Tensor.__contains__, torch.Tensor.__repr__, torch.Tensor.__format__, torch.equal, torch.Tensor.equal,
    torch.allclose, torch.Tensor.allclose,
}  # fmt: skip
_SIZED = {
    torch.nonzero, torch.Tensor.nonzero, torch.argwhere, torch.Tensor.argwhere, torch.masked_select,
    torch.Tensor.masked_select, torch.unique, torch.Tensor.unique, torch.unique_consecutive,
    torch.Tensor.unique_consecutive, torch.bincount, torch.Tensor.bincount,
}  # fmt: skip
_MAKERS = {torch.tensor, torch.as_tensor, torch.asarray, torch.Tensor.new_tensor}
_MOVERS = {torch.Tensor.to, torch.Tensor.cuda, torch.Tensor.type}


class NotRecordable(RuntimeError):
    """A hook does what a graph cannot hold; the message says where and what."""


@dataclass(eq=False)
class HostCalls(TorchFunctionMode):
    """While active, reads of values are errors, and tensors made from numbers of the host are remembered.

    A graph cannot copy from the host. What ``torch.tensor(...)`` or an index ``[[0, 2]]`` copied in a first run is
    taken from device memory in the runs that are recorded.

    Attributes:
        device: Device of the environment.
        constants: Tensors of the first run, in the order of the calls, with the place of each call.
        first: Whether this is the first run.
    """

    device: torch.device
    constants: list[tuple[str, torch.Tensor]] = field(default_factory=list)
    first: bool = True

    def __post_init__(self) -> None:
        super().__init__()
        self._next = 0

    def __torch_function__(
        self,
        func: Callable[..., object],
        types: Sequence[type],
        args: Sequence[object] = (),
        kwargs: Mapping[str, object] | None = None,
    ) -> object:
        kwargs = kwargs or {}
        call: Callable[..., object] = func
        if func in _READS:
            raise NotRecordable(f"{caller()}: {_name(func)} reads the value of a tensor, which waits for the device")
        if func in _SIZED or (func is torch.where and len(args) + len(kwargs) == 1):
            raise NotRecordable(f"{caller()}: the size of what {_name(func)} returns depends on values")
        if func is torch.Tensor.__getitem__:
            return call(args[0], self._index(args[1], None))
        if func is torch.Tensor.__setitem__:
            target, given, value = args
            index = self._index(given, value)
            return call(target, index, _number_on_device(target, index, value))
        if func in (torch.where, torch.Tensor.where):
            return call(*self._numbers_on_device(args), **self._with_numbers_on_device(args, kwargs))
        if func in _MAKERS and self._copies(args[-1 if func is torch.Tensor.new_tensor else 0] if args else None):
            return self._constant(lambda: func(*args, **kwargs))
        if func in _MOVERS and isinstance(args[0], torch.Tensor) and args[0].device != self.device:
            return self._constant(lambda: func(*args, **kwargs))
        result = func(*args, **kwargs)
        if func in _MOVERS and isinstance(result, torch.Tensor) and result.device != self.device:
            raise NotRecordable(f"{caller()}: {_name(func)} copies a tensor to the host")
        return result

    def _numbers_on_device(self, args: Sequence[object]) -> list[object]:
        """Arguments of ``torch.where`` with numbers as tensors, as it would copy numbers from the host."""
        tensors = [a for a in args if isinstance(a, torch.Tensor) and a.dtype != torch.bool]
        numbers = [a for a in args if isinstance(a, (bool, int, float))]
        if not numbers:
            return list(args)
        kind = torch.result_type(tensors[0] if tensors else numbers[-1], numbers[0])
        make = partial(torch.full, (), dtype=kind, device=self.device)
        return [make(fill_value=a) if isinstance(a, (bool, int, float)) else a for a in args]

    def _with_numbers_on_device(self, args: Sequence[object], kwargs: Mapping[str, object]) -> dict[str, object]:
        names = list(kwargs)
        changed = self._numbers_on_device([*args, *kwargs.values()])[len(args) :]
        return dict(zip(names, changed, strict=True))

    def _copies(self, data: object) -> bool:
        """Whether a tensor made of this copies from the host. One of an array of the device shares its memory."""
        if isinstance(data, np.ndarray):
            return self.device.type != "cpu"
        return isinstance(data, (int, float, list, tuple))

    def _index(self, index: object, value: object) -> object:
        if isinstance(index, tuple):
            return tuple(self._index(i, value) for i in index)
        if isinstance(index, list) and not index:
            return index
        if isinstance(index, (list, np.ndarray)) or (isinstance(index, torch.Tensor) and index.device != self.device):
            given = index
            index = self._constant(lambda: torch.as_tensor(given, device=self.device))
        if isinstance(index, torch.Tensor) and index.dtype in (torch.bool, torch.uint8):
            if value is None:
                raise NotRecordable(f"{caller()}: the size of x[mask] depends on values; torch.where has a fixed one")
            if not isinstance(value, (bool, int, float)):
                raise NotRecordable(f"{caller()}: x[mask] = tensor waits for the size of the mask; use torch.where")
        return index

    def _constant(self, make: Callable[[], object]) -> object:
        where = caller(of_task=False)
        if self.first:
            with _waits_allowed():
                made = make()
            if not isinstance(made, torch.Tensor) or made.device != self.device:
                return made
            self.constants.append((where, made.clone()))
            return made
        if self._next >= len(self.constants) or self.constants[self._next][0] != where:
            raise NotRecordable(f"{caller()}: a tensor is made of numbers in some steps only")
        made = self.constants[self._next][1].clone()
        self._next += 1
        return made


class NumbersOnDevice(TorchFunctionMode):
    """While active, ``x[indices] = number`` takes the number from the device.

    Otherwise torch copies it from the host, and waits for that copy. The results are the same.
    """

    def __torch_function__(
        self,
        func: Callable[..., object],
        types: Sequence[type],
        args: Sequence[object] = (),
        kwargs: Mapping[str, object] | None = None,
    ) -> object:
        if func is torch.Tensor.__setitem__:
            target, index, value = args
            return _call(func, target, index, _number_on_device(target, index, value))
        return func(*args, **(kwargs or {}))


def _call(func: Callable[..., object], *args: object) -> object:
    return func(*args)  # what `func` is compared with would narrow its type


def _number_on_device(target: object, index: object, value: object) -> object:
    """The value for ``target[index]``: a number as a tensor, where torch would copy it from the host."""
    if isinstance(value, (int, float)) and _has_indices(index) and isinstance(target, torch.Tensor):
        return torch.full((), value, dtype=target.dtype, device=target.device)
    return value


def _has_indices(index: object) -> bool:
    parts = index if isinstance(index, tuple) else (index,)
    tensors = [p for p in parts if isinstance(p, torch.Tensor)]
    return bool(tensors) and all(t.dtype not in (torch.bool, torch.uint8) for t in tensors)


@contextlib.contextmanager
def _waits_allowed() -> Iterator[None]:
    if not torch.cuda.is_available():
        yield
        return
    mode = torch.cuda.get_sync_debug_mode()
    torch.cuda.set_sync_debug_mode("default")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode(mode)


def _name(func: Callable[..., object]) -> str:
    return getattr(func, "__name__", str(func)) + "()"


# -- places in source code


def caller(of_task: bool = True) -> str:
    """File and line of the innermost call from outside the libraries, or of that from outside torch."""
    frame: FrameType | None = sys._getframe(1)
    while frame is not None:
        name = frame.f_globals.get("__name__", "")
        library = name.partition(".")[0] in (_LIBRARIES if of_task else ("torch",)) or name == __name__
        if not library:
            return short_location(frame.f_code.co_filename, frame.f_lineno)
        frame = frame.f_back
    return "?"


def error_location(error: BaseException) -> str:
    """File and line of the innermost frame of a traceback from outside the libraries; empty if there is none."""
    step: TracebackType | None = error.__traceback__
    found = ""
    while step is not None:
        name = step.tb_frame.f_globals.get("__name__", "")
        if name.partition(".")[0] not in _LIBRARIES:
            found = short_location(step.tb_frame.f_code.co_filename, step.tb_lineno)
        step = step.tb_next
    return found


def short_location(file: str, line: int) -> str:
    """The last two parts of a path, and a line."""
    return f"{'/'.join(FilePath(file).parts[-2:])}:{line}"


# -- code that ran


@dataclass
class ExecutedCode:
    """Code of the Python functions that ran, each with the globals of its module."""

    globals_of: dict[CodeType, dict[str, object]] = field(default_factory=dict)

    @property
    def names(self) -> set[str]:
        """Names of attributes and globals in it, and strings, which may be keys."""
        found: set[str] = set()
        for code in self.globals_of:
            found.update(code.co_names, code.co_freevars, (c for c in code.co_consts if isinstance(c, str)))
        return found

    def global_numbers(self) -> dict[str, dict[str, object]]:
        """Globals that it names and that are numbers now, each with the dict that holds it."""
        return {
            name: scope
            for code, scope in self.globals_of.items()
            for name in code.co_names
            if isinstance(scope.get(name), (bool, int, float))
        }


@contextlib.contextmanager
def executed_code(into: ExecutedCode) -> Iterator[None]:
    """Note which Python functions run, but for those of libraries that know nothing of the environment."""
    ignored = {"torch", "warp", "newton", "numpy"}
    before = sys.getprofile()

    def note(frame: FrameType, event: str, argument: object) -> None:
        if event == "call":
            name = frame.f_globals.get("__name__", "")
            if name.partition(".")[0] not in ignored and not name.startswith(__package__):
                into.globals_of[frame.f_code] = frame.f_globals

    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(None)
        enable = getattr(before, "enable", None)  # that of cProfile is no function
        if enable is not None:
            enable()
        else:
            sys.setprofile(before)


def location_of_name(code: ExecutedCode, name: str) -> str:
    """File and line where a name is used first, that of a task's own code if there is any."""
    import dis  # only where a reason is wanted

    found: list[tuple[bool, str]] = []
    for each, scope in code.globals_of.items():
        line = each.co_firstlineno
        starts = dict(dis.findlinestarts(each))
        for instruction in dis.get_instructions(each):
            line = starts.get(instruction.offset) or line
            if instruction.argval == name:
                own = str(scope.get("__name__", "")).partition(".")[0] not in _LIBRARIES
                found.append((not own, short_location(each.co_filename, line)))
                break
    return min(found, default=(True, ""))[1]
