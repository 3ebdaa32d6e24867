# SPDX-License-Identifier: Apache-2.0
"""Fused kernel: sections of source as one Warp kernel, kept as a readable file and compiled once."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from pathlib import Path

import warp as wp

from .kernel_source import KernelSource, write_kernel
from .scope import Scope
from .stage import Section
from .usage import usage_of

__all__ = ["FusedKernel", "fuse"]


class FusedKernel:
    """A kernel with its arguments, ready to be launched.

    Attributes:
        name: Name of the kernel.
        source: Its source.
        path: File that holds the source.
        terms: Terms that are in it.
    """

    def __init__(
        self, name: str, source: str, path: Path, terms: Sequence[str], kernel: wp.Kernel, launch: dict[str, object]
    ):
        self.name, self.source, self.path, self.terms = name, source, path, list(terms)
        self._kernel, self._launch = kernel, launch
        self._command: wp.Launch | None = None

    def launch(self) -> None:
        """Launch it."""
        if self._command is None:  # its arguments are packed once: they never change
            self._command = wp.launch(self._kernel, **self._launch, record_cmd=True)
        self._command.launch()


def fuse(name: str, sections: Sequence[Section], scope: Scope, num_envs: int, device: str) -> FusedKernel:
    """Make one kernel of sections; see :func:`write_kernel` for how they share it.

    Args:
        name: Name of the kernel.
        sections: All with parts, or all without.
        scope: The names that they use.
        num_envs: Number of environments.
        device: Where it runs.
    """
    source = write_kernel(name, sections, scope, num_envs)
    compiled = _compiled(name, source)
    counts = [num_envs] if source.layout.neighbours else []
    launch = {
        "dim": source.layout.dim(num_envs),
        "inputs": [*counts, *(scope.values[v] for v in source.arguments)],
        "device": device,
        "block_dim": source.layout.block_dim,
    }
    terms = [term for section in sections for term in section.terms]
    return FusedKernel(name, source.text, compiled.path, terms, compiled.kernel, launch)


@dataclass(frozen=True)
class _Compiled:
    path: Path
    kernel: wp.Kernel
    aliases: dict[str, object]
    """Held, as the kernels that are known are told apart by the identity of these."""


_KNOWN: dict[tuple[Hashable, ...], _Compiled] = {}


def _compiled(name: str, source: KernelSource) -> _Compiled:
    """The kernel of a source, the same one for the same source and functions.

    File and module are named by everything that is baked into the kernel: its source and that of all functions that it
    calls. So an equal kernel is compiled once, in this process and in later ones.
    """
    called = {f.adj.source for own in source.functions for f in (own, *usage_of(own).calls)}
    baked = "".join([source.text, *sorted(called)])
    digest = hashlib.sha256(baked.encode()).hexdigest()[:12]
    key = (digest, *sorted((alias, id(thing)) for alias, thing in source.aliases.items()))
    if key not in _KNOWN:
        wp.init()  # it sets the folder of the cache
        path = Path(wp.config.kernel_cache_dir) / "stripe_newton" / f"{name}_{digest}.py"
        _write(path, source.text)
        module = f"stripe_newton.generated.{name}_{digest}"
        # Equal source may stand for other functions: those of a file that was loaded twice, say.
        again = sum(known[0] == digest for known in _KNOWN)
        space = {"wp": wp, "__name__": f"{module}_{again}" if again else module, **source.aliases}
        # Warp looks a kernel's source up by the name of its file.
        exec(compile(source.text, str(path), "exec"), space)
        _KNOWN[key] = _Compiled(path, space[name], source.aliases)
    return _KNOWN[key]


def _write(path: Path, text: str) -> None:
    """Write a file whole or not at all: other processes may want the same one at the same time."""
    if not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        draft = path.with_suffix(f".{os.getpid()}")
        draft.write_text(text)
        os.replace(draft, path)
