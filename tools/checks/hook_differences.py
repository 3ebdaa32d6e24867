# SPDX-License-Identifier: Apache-2.0
"""Hook differences: provokes replays of torch hooks that differ from the hooks, and says which numbers and why.

    python tools/checks/hook_differences.py OUT [--device cuda:0] [--repeats 5] [--parts torch carts]

First, what torch does around a recording: whether the first replay draws the right random numbers when the stream of
the recording is late, whether a pool can be used again, and whether random numbers can be drawn after a capture that
failed. Then carts with hooks of many kinds, many times: alone, among memory that others have just freed, and beside a
process that keeps the GPU busy; with and without the wait at the end of a recording. Each difference between replay
and hook is printed: name, elements, by how much, whether the hook itself repeats its bits, and whether the replay drew
random numbers of offset 0. OUT gets ``hook_differences.json``. The command fails if a difference is left with the wait.
On the CPU hooks are recorded on a tape, which tries the command itself.
"""

from __future__ import annotations

import argparse
import contextlib
import gc
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from unittest import mock

import torch
import warp as wp

sys.path.insert(0, str(Path(__file__).parents[2]))

from stripe_newton.envs.hook_graphs import RecordedHook, recorded_hook
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_newton.sim.capture import TorchGraph
from tests.helpers import recorded_cart
from tests.helpers.late_stream import draw_late

__all__ = ["Differences", "cart_runs", "main", "torch_facts"]

STEPS = 140
"""Steps of a cart: hooks are recorded and compared in the first ones, and once more after 64."""
BUSY = (
    "import torch; a = torch.randn(8192, 8192, device='{}')\n"
    "while True:\n    for _ in range(8): a = (a @ a).clamp(-1, 1)\n    torch.cuda.synchronize()"
)
"""Program that keeps a GPU busy."""


# -- torch alone


def torch_facts(device: str) -> dict[str, Any]:
    """What torch does around a recording, with and without this project's own."""
    wp.init()
    found: dict[str, Any] = {"torch": torch.__version__, "device": torch.cuda.get_device_name(device)}
    found["late stream, torch alone"] = _late(device, _plain_graph)
    found["late stream, TorchGraph"] = _late(device, lambda f, s: TorchGraph(f, s, free_memory=False))
    found["pool used again, torch alone"] = _said(lambda: _pool_again(device))
    found["random numbers after a failed capture, torch alone"] = _said(lambda: _failed(device, _plain_graph))
    # The next recording that succeeds ends what the failed one left behind.
    found["healed by TorchGraph"] = _said(lambda: _failed(device, lambda f, s: TorchGraph(f, s, free_memory=False)))
    return found


def _plain_graph(
    function: Callable[[], None], stream: torch.cuda.Stream, pool: tuple[int, int] | None = None
) -> torch.cuda.CUDAGraph:
    graph = torch.cuda.CUDAGraph()
    torch.cuda.synchronize()
    with torch.cuda.stream(stream):
        graph.capture_begin(pool=pool, capture_error_mode="thread_local")  # type: ignore[arg-type]
        try:
            function()
        finally:
            graph.capture_end()
    return graph


def _late(device: str, record: Callable[[Callable[[], None], torch.cuda.Stream], Any]) -> str:
    """Whether the first replay draws the right numbers where the stream of the recording has other work first."""
    late = draw_late(device, record)
    if late.is_right:
        return "right"
    return "wrong: of offset 0" if torch.equal(late.drawn, late.of_offset_0) else "wrong"


def _pool_again(device: str) -> None:
    pool, stream, x = torch.cuda.graph_pool_handle(), torch.cuda.Stream(device), torch.zeros(4, device=device)
    for _ in range(2):
        graph = _plain_graph(lambda: x.add_(x * 2.0), stream, pool)
        graph.replay()
        del graph


def _failed(device: str, record: Callable[[Callable[[], None], torch.cuda.Stream], Any]) -> None:
    def spoiled() -> None:
        torch.randn(4, device=device)
        torch.cuda.current_stream().synchronize()

    with contextlib.suppress(RuntimeError):
        record(spoiled, torch.cuda.Stream(device))
    torch.rand(4, device=device)


def _said(function: Callable[[], None]) -> str:
    try:
        function()
    except RuntimeError as error:
        return str(error).strip().partition("\n")[0]
    return "works"


# -- carts


class Differences:
    """Notes every difference between a replay and its hook while it is active."""

    def __init__(self, device: str):
        self.found: list[dict[str, Any]] = []
        self._device = device
        self._results: list[tuple[Any, Any]] = []

    @contextlib.contextmanager
    def watch(self) -> Iterator[None]:
        compare, first = RecordedHook._compare, recorded_hook.first_difference

        def noted(one: Any, two: Any) -> str:
            self._results.append((one, two))
            return first(one, two)

        def compared(hook: RecordedHook, other: Callable[[], None]) -> str:
            self._results = []
            state = torch.cuda.get_rng_state(self._device) if self._device != "cpu" else None
            said = compare(hook, other)
            if self._results and first(*self._results[0]):
                self._note(hook, said, state)
            return said

        with (
            mock.patch.object(RecordedHook, "_compare", compared),
            mock.patch.object(recorded_hook, "first_difference", noted),
        ):
            yield

    def _note(self, hook: RecordedHook, said: str, state: torch.Tensor | None) -> None:
        replayed, eager = self._results[0]
        entry: dict[str, Any] = {"hook": hook.name, "said": said, "names": {}}
        for name in replayed.keys() | eager.keys():
            if name not in replayed or name not in eager:
                entry["names"][name] = "only in one of both"
            elif not torch.equal(replayed[name], eager[name]):
                entry["names"][name] = _where(_floats(replayed[name]), _floats(eager[name]))
        if len(self._results) > 1:  # the hook once more, from the same state
            again = self._results[1][1]
            entry["hook_repeats"] = not recorded_hook.first_difference(eager, again)
            entry["replay_is_second_run"] = not recorded_hook.first_difference(replayed, again)
        if state is not None:
            entry["noise_of_offset_0"] = self._drew_offset_0(replayed, state)
        self.found.append(entry)
        print(json.dumps(entry), flush=True)

    def _drew_offset_0(self, replayed: dict[str, torch.Tensor], state: torch.Tensor) -> bool | None:
        """Whether the noise in the observations of a cart is that of its seed from the beginning."""
        values = next((_floats(v) for k, v in replayed.items() if k.startswith("observations")), None)
        if values is None or values.numel() != 8 * recorded_cart.N:
            return None
        generator = torch.Generator(self._device)
        generator.set_state(torch.cat((state[:8], torch.zeros_like(state[8:]))))
        noise = 0.01 * torch.randn(recorded_cart.N, 2, device=self._device, generator=generator)
        return torch.equal(values.view(recorded_cart.N, 8)[:, 6:], noise)


def _floats(values: torch.Tensor) -> torch.Tensor:
    flat = values.reshape(-1)
    return flat.view(torch.float32) if flat.dtype == torch.uint8 and flat.numel() % 4 == 0 else flat


def _where(one: torch.Tensor, two: torch.Tensor) -> dict[str, Any]:
    if one.shape != two.shape:
        return {"shapes": [list(one.shape), list(two.shape)]}
    places = (one != two).nonzero().flatten()[:12].tolist()
    return {
        "elements": places,
        "of": one.numel(),
        "replayed": [float(one[i]) for i in places],
        "eager": [float(two[i]) for i in places],
    }


def cart_runs(device: str, repeats: int, waits: bool, around: str) -> list[dict[str, Any]]:
    """Differences in some carts.

    Args:
        device: The device.
        repeats: Number of carts.
        waits: Whether a recording ends with a wait for its stream, as it does.
        around: ``"alone"``, ``"memory"`` or ``"busy"``.
    """
    sim = SimulationCfg(device=device, dt=0.01, solver=MuJoCoSolverCfg(disable_contacts=True))
    found = Differences(device)
    with contextlib.ExitStack() as stack:
        stack.enter_context(found.watch())
        if device == "cpu":
            import pytest

            recorded_cart.record_on_cpu(stack.enter_context(pytest.MonkeyPatch.context()))
        elif not waits:
            stack.enter_context(mock.patch.object(torch.cuda.Stream, "synchronize", return_value=None))
        if around == "busy" and device != "cpu":
            stack.enter_context(busy(device))
        for _ in range(repeats):
            kept = [litter(device) for _ in range(64)] if around == "memory" else []
            env = recorded_cart.make(sim=sim)
            del kept[::2]
            for step in range(STEPS):
                recorded_cart.run(env, 1, step)
                if around == "memory":
                    kept.append(litter(device))
                    del kept[: -(step % 32)]
            reasons = {h.name: h.reason for h in recorded_cart.recorder_of(env).hooks if h.reason}
            if reasons:
                found.found.append({"reasons": reasons})
            env.close()
            del env
            if around != "memory":
                gc.collect()
    return found.found


def litter(device: str) -> torch.Tensor:
    """A tensor of some size that is full of large numbers, so that its memory shows where it is read."""
    size = int(torch.randint(1, 4096, (), generator=_SIZES))
    return torch.full((size,), 1.0e6, device=device)


_SIZES = torch.Generator().manual_seed(0)


@contextlib.contextmanager
def busy(device: str) -> Iterator[None]:
    """Keep the GPU busy with another process."""
    process = subprocess.Popen([sys.executable, "-c", BUSY.format(device)])
    try:
        time.sleep(8.0)
        yield
    finally:
        process.kill()
        process.wait()


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--parts", nargs="*", default=["torch", "carts"])
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    found: dict[str, Any] = {}
    if "torch" in args.parts and args.device != "cpu":
        found["torch"] = torch_facts(args.device)
        print(json.dumps(found["torch"], indent=1), flush=True)
    for around in ("alone", "memory", "busy") if "carts" in args.parts else ():
        for waits in (False, True):
            key = f"carts {around}, {'with' if waits else 'without'} the wait"
            found[key] = cart_runs(args.device, args.repeats, waits, around)
            print(f"{key}: {len(found[key])} differences", flush=True)
            (args.out / "hook_differences.json").write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    return 1 if any(found[k] for k in found if k.endswith(", with the wait")) else 0


if __name__ == "__main__":
    sys.exit(main())
