# SPDX-License-Identifier: Apache-2.0
"""Kernels of chains: all chains of a hook in one Warp module, which is compiled once for equal code."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence

import warp as wp

from stripe_newton.generated_files import write_generated

from .chain import ChainCode

__all__ = ["BLOCK_DIM", "compile_chains", "is_compiled", "launch_chain", "module_of"]

BLOCK_DIM = 32
"""Threads of a block: one warp, so that some thousands of environments are spread over all multiprocessors."""

_KERNELS: dict[str, wp.Kernel] = {}
"""Kernels by the digest of their code."""


def is_compiled(code: ChainCode) -> bool:
    """Whether there is a kernel for a chain."""
    return code.digest in _KERNELS


def compile_chains(codes: Iterable[ChainCode], device: str) -> None:
    """Compile the chains that have no kernel yet, as one module, and load it.

    Args:
        codes: The chains.
        device: Device that they run on. The code of a chain is for a kind of device.
    """
    new = list({c.digest: c for c in codes if not is_compiled(c)}.values())
    if not new:
        return
    module, kernels = module_of(new, fuse_fp=device != "cpu")
    wp.load_module(module, device=device, block_dim=1 if device == "cpu" else BLOCK_DIM)
    _KERNELS.update(kernels)


def module_of(codes: Sequence[ChainCode], fuse_fp: bool) -> tuple[wp.Module, dict[str, wp.Kernel]]:
    """A module with a kernel for each chain, not compiled yet.

    Args:
        codes: Chains with different code.
        fuse_fp: Whether the compiler may contract products and sums, where the code leaves that open.

    Returns:
        The module, and its kernels by the digest of their code.
    """
    text = "".join([_HEADER, *map(_kernel_source, codes)])
    name = f"chains_{hashlib.sha256(text.encode()).hexdigest()[:12]}"
    path = write_generated(f"{name}.py", text)
    space = {"wp": wp, "__name__": f"stripe_newton.generated.{name}"}
    # Warp reads the source code of a kernel back from the file that its code object names.
    exec(compile(text, str(path), "exec"), space)
    kernels: dict[str, wp.Kernel] = {code.digest: space[f"chain_{code.digest}"] for code in codes}
    module = next(iter(kernels.values())).module
    module.options.update(fuse_fp=fuse_fp, enable_backward=False)
    return module, kernels


def launch_chain(code: ChainCode, device: str) -> None:
    """Launch the kernel of a chain on its memory."""
    wp.launch(_KERNELS[code.digest], code.rows, list(code.addresses), device=device, block_dim=BLOCK_DIM)


_HEADER = '"""Chains of torch operations on the rows of tensors, each as one kernel."""\n'


def _kernel_source(code: ChainCode) -> str:
    names = [f"p{index}" for index in range(len(code.addresses))]
    typed = ", ".join(f"{name}: wp.uint64" for name in names)
    return f'''

@wp.func_native("""
{code.body}
""")
def row_{code.digest}(row: wp.int64, {typed}): ...


@wp.kernel(enable_backward=False)
def chain_{code.digest}({typed}):
    row_{code.digest}(wp.int64(wp.tid()), {", ".join(names)})
'''
