# SPDX-License-Identifier: Apache-2.0
"""Fused kernel: sections of source code compiled as one Warp kernel, with the source kept in a readable file."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path

import warp as wp

from stripe_newton.compile_ahead import compile_ahead, wait_for
from stripe_newton.generated_files import write_generated

from .kernel_source import KernelSource, write_kernel
from .scope import Scope
from .section import Section
from .usage import usage_of

__all__ = ["FusedKernel", "fuse"]


class FusedKernel:
    """A generated kernel with its arguments, ready to be launched.

    Attributes:
        name: Name of the kernel.
        source: Source code.
        path: File with the source code.
        terms: Names of the terms in it.
    """

    def __init__(
        self,
        name: str,
        source: str,
        path: Path,
        terms: Sequence[str],
        kernel: wp.Kernel,
        launch: dict[str, object],
        check: Callable[[], None],
    ):
        """``check`` raises an error if the source code is not that of the arrays any more."""
        self.name, self.source, self.path, self.terms = name, source, path, list(terms)
        self._kernel, self._launch, self._check = kernel, launch, check
        self._command: wp.Launch | None = None

    def compile_ahead(self) -> None:
        """Begin to compile the kernel, which the first launch waits for."""
        compile_ahead(self._kernel, int(str(self._launch["block_dim"])), str(self._launch["device"]))

    def launch(self) -> None:
        """Launch the kernel on the current stream."""
        # The arguments never change, so they are packed once. Packing takes longer than the launch itself.
        if self._command is None:
            self._check()
            wait_for(self._kernel)
            self._command = wp.launch(self._kernel, **self._launch, record_cmd=True)
        self._command.launch()


def fuse(name: str, sections: Sequence[Section], scope: Scope, num_envs: int, device: str) -> FusedKernel:
    """Compile sections as one kernel; :func:`write_kernel` describes its threads.

    Args:
        name: Name of the kernel.
        sections: Sections, all with parts or all without.
        scope: Arrays, structs and functions by the names that the sections use.
        num_envs: Number of environments.
        device: Device of the kernel.
    """
    source = write_kernel(name, sections, scope, num_envs)
    compiled = _compiled(name, source)

    def check() -> None:
        if write_kernel(name, sections, scope, num_envs).text != source.text:
            raise RuntimeError(
                f"'{name}': an array was replaced by one of another shape after the kernel was written; "
                "allocate the arrays of a step before its plan is made"
            )

    counts = [num_envs] if source.layout.coalesced else []
    launch = {
        "dim": source.layout.dim(num_envs),
        "inputs": [*counts, *(scope.values[v] for v in source.arguments)],
        "device": device,
        "block_dim": source.layout.block_dim,
    }
    terms = [term for section in sections for term in section.terms]
    return FusedKernel(name, source.text, compiled.path, terms, compiled.kernel, launch, check)


@dataclass(frozen=True)
class _Compiled:
    path: Path
    kernel: wp.Kernel
    aliases: dict[str, object]
    """Functions and structs of the kernel. Held here, as ``_COMPILED`` tells kernels apart by their identities."""


_COMPILED: dict[tuple[Hashable, ...], _Compiled] = {}


def _compiled(name: str, source: KernelSource) -> _Compiled:
    """The kernel of some source code; the same one for equal source code and functions.

    File and module are named by a hash of the source code of the kernel and of all functions that it calls. So an equal
    kernel is compiled once, in this process and in later ones.
    """
    called = {f.adj.source for own in source.functions for f in (own, *usage_of(own).calls)}
    digest = hashlib.sha256("".join([source.text, *sorted(called)]).encode()).hexdigest()[:12]
    key = (digest, *sorted((alias, id(thing)) for alias, thing in source.aliases.items()))
    if key not in _COMPILED:
        path = write_generated(f"{name}_{digest}.py", source.text)
        module = f"stripe_newton.generated.{name}_{digest}"
        # Equal source code may call different functions, for example of a module that was loaded twice. Warp would mix
        # them up if both modules had the same name.
        equal = sum(other[0] == digest for other in _COMPILED)
        space = {"wp": wp, "__name__": f"{module}_{equal}" if equal else module, **source.aliases}
        # Warp reads the source code of a kernel back from the file that its code object names.
        exec(compile(source.text, str(path), "exec"), space)
        _COMPILED[key] = _Compiled(path, space[name], source.aliases)
    return _COMPILED[key]
