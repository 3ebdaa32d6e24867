# SPDX-License-Identifier: Apache-2.0
"""Hook parts: torch hooks of a direct environment as items of its step, which join graphs once they are recorded."""

from __future__ import annotations

import contextlib
import weakref
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import torch
import warp as wp

from stripe_newton.fusion import HostFunction
from stripe_newton.sim.capture import TorchGraph

from .call_counts import warp_waits
from .env_state import repeats, state_arrays
from .hook_graphs import EnvRows, HookGraph, HookRecorder, RecordedHook
from .hook_graphs.fused import NotFusible
from .hook_graphs.host_values import NotRecordable
from .hook_graphs.reachable import NOTHING, assign, scan, value_at
from .hook_results import leaves_of

if TYPE_CHECKING:
    from .recording_env import RecordingEnv

__all__ = ["HookPart", "PhysicsPart", "ResetPart", "fuses_on", "hook_recorder", "records_on", "rehearse"]

SKIPPED = frozenset({
    "extras", "obs_buf", "_observed", "_given", "_plan", "_steps_before", "_recaptures", "_np_random",
    "_np_random_seed", "_observation_buffers", "_pictures", "_checked",
})  # fmt: skip
"""Attributes of an environment that the framework sets in every step, and that are not state of hooks."""


_MODEL = ("joint_target_k", "joint_armature", "joint_friction", "joint_effort", "joint_velocity", "joint_limit",
          "joint_X", "body_mass", "body_inv", "body_inertia", "body_com", "gravity", "shape_material")  # fmt: skip
"""Beginnings of the names of the model's arrays that hooks may change."""


def records_on(device: str) -> bool:
    """Whether hooks are recorded on a device: a CPU has no graphs to gain from."""
    return device != "cpu"


def fuses_on(device: str) -> bool:
    """Whether chains of operations of recorded hooks become kernels on a device."""
    return device != "cpu"


def hook_recorder(env: RecordingEnv) -> HookRecorder | None:
    """The recorder of an environment; None where its config or its device wants none."""
    if env.cfg.hooks_graph is False or not env.cfg.sim.use_cuda_graph or not records_on(env.device):
        return None
    recorder = HookRecorder(
        env,
        SKIPPED,
        lambda: _arrays(env),
        Recorder(env),
        no_waits,
        required=env.cfg.hooks_graph is True,
        changed=lambda: env.plan.recapture(),
        fused_envs=env.num_envs if env.cfg.hooks_fusion and fuses_on(env.device) else 0,
    )
    recorder.context.log_memory = env.outputs.reserve_logged
    recorder.context.flags.append((env.sim, "roots_moved"))
    return recorder


def _arrays(env: RecordingEnv) -> dict[str, torch.Tensor]:
    """Memory of the simulation that hooks may write, by name."""
    sim = env.sim
    arrays = {k: v for k, v in state_arrays(env).items() if isinstance(v, wp.array)}
    for holder in (sim.state, sim.control):
        arrays |= {k: v for k, v in vars(holder).items() if isinstance(v, wp.array) and v.size}
    found = {name: wp.to_torch(array) for name, array in arrays.items()}
    for name, array in vars(sim.model).items():
        if isinstance(array, wp.array) and array.size and name.startswith(_MODEL):
            found[f"model.{name}"] = wp.to_torch(array)
    for i, part in enumerate(env.state_parts()):
        found |= {f"part {i}.{k}": v for k, v in part.items() if isinstance(v, torch.Tensor)}
    for k, group in env.observation_buffers().items():
        leaves = leaves_of(group)
        found |= {f"observations '{k}'" + f"[{i}]" * (len(leaves) > 1): leaf for i, leaf in enumerate(leaves)}
    # Last, as a difference is named after the first memory that has it: these hold arrays that have names above.
    return found | {f"outputs '{name}'": wp.to_torch(array) for name, array in env.outputs.arrays.items()}


class Recorder:
    """Records functions of torch and Warp on one stream, with one pool of memory for all graphs of an environment."""

    def __init__(self, env: RecordingEnv):
        self.env, self._device = env, env.device
        self._stream: torch.cuda.Stream | None = None
        self._pool: tuple[int, int] | None = None
        self._in_pool: weakref.WeakSet[TorchGraph] = weakref.WeakSet()

    def __call__(self, function: Callable[[], None]) -> HookGraph:
        with torch.cuda.device(self._device):
            if self._stream is None:
                self._stream = torch.cuda.Stream(self._device)
            if not self._in_pool:
                # A pool ends with its last graph, such as when all are recorded anew. Torch refuses to use it again.
                self._pool = torch.cuda.graph_pool_handle()
            generators = scan(self.env, SKIPPED).generators  # of a task's own, beside torch's default
            try:
                graph = TorchGraph(function, self._stream, self._pool, generators, free_memory=False)
            except NotFusible:  # the hook has given fusion up: without it, it can be recorded
                self._in_pool.clear()
                return self(function)
            except Exception:
                self._in_pool.clear()  # nor can a pool be used after a recording that failed
                raise
        self._in_pool.add(graph)
        return graph


@contextlib.contextmanager
def no_waits() -> Iterator[None]:
    """Context within which a wait of the host for the device raises, where there is a GPU."""
    if not torch.cuda.is_available():
        yield
        return
    mode = torch.cuda.get_sync_debug_mode()
    torch.cuda.set_sync_debug_mode("error")
    try:
        with warp_waits(NotRecordable("Warp waits for the device")):
            yield
    finally:
        torch.cuda.set_sync_debug_mode(mode)


REHEARSED = 40
"""Largest number of steps of a rehearsal."""


def rehearse(env: RecordingEnv, recorder: HookRecorder) -> None:
    """Take steps with actions of zero until it is known which hooks are recorded, and bring the state back.

    Tensors, numbers and random generators are brought back, lists that hooks lengthen are not.
    """
    before, state = recorder.context.snapshot(), env.get_state()
    values = scan(env, SKIPPED)
    tensors = {path: tensor.clone() for path, tensor in values.tensors.items()}
    extras, observations = env.extras, env.obs_buf
    action = torch.zeros(env.action_space.shape or (), device=env.device)
    for _ in range(REHEARSED):
        env.step(action)
        if recorder.is_settled:
            break
    before.restore_memory()
    for path, tensor in scan(env, SKIPPED).tensors.items():
        if path in tensors and tensors[path].shape == tensor.shape and not repeats(tensor):
            tensor.copy_(tensors[path])
    for path, number in values.numbers.items():
        holder, key = values.holders.get(path, (None, ""))
        if holder is None or value_at(holder, key) in (number, NOTHING):
            continue
        if isinstance(holder, type):
            setattr(holder, str(key), number)
        else:
            assign(env, path, number)
    env.set_state(state)
    before.restore_random()
    env.extras, env.obs_buf = extras, observations


class HookPart:
    """A torch hook as an item of a step."""

    def __init__(self, recorder: HookRecorder, hook: RecordedHook, before: Callable[[], None] | None = None):
        """Wrap a hook.

        Args:
            recorder: The recorder of the environment.
            hook: The hook.
            before: The host's part before the hook, which runs in each step.
        """
        self._recorder, self.hook, self._before = recorder, hook, before

    def item(self, name: str) -> HostFunction:
        """The hook as an item."""
        return HostFunction(name, self.run, "torch hook", part=self)

    def run(self) -> None:
        """Run the hook, in the way of its recorder."""
        if self._before is not None:
            self._before()
        self._recorder.run(self.hook)

    @property
    def is_capturable(self) -> bool:
        """Whether its launches may be part of a graph now."""
        return self._recorder.joined(self.hook)

    @property
    def status(self) -> str:
        """Way in which it runs, for the description."""
        return in_graph(self.hook) if self.is_capturable else f"eager: torch hook; {why_eager(self.hook)}"

    def launch(self) -> Sequence[Callable[[], None]]:
        """Launch the hook within a recording."""
        after = self.hook.launch().parts()
        return after if self._before is None else [self._before, *after]


class PhysicsPart:
    """The physics of a step with the torch hook ``_apply_action``, as an item of a step."""

    def __init__(self, env: RecordingEnv, recorder: HookRecorder, hook: RecordedHook):
        self._env, self._recorder, self.hook = env, recorder, hook

    @property
    def is_capturable(self) -> bool:
        """Whether it may be part of a graph now."""
        return self._recorder.joined(self.hook)

    @property
    def status(self) -> str:
        """Way in which it runs, for the description."""
        eager = f"eager: torch hook; {why_eager(self.hook)}; the physics is one CUDA graph"
        return in_graph(self.hook) if self.is_capturable else eager

    def launch(self) -> Sequence[Callable[[], None]]:
        """Launch hook and physics within a recording."""
        steps = self._env.cfg.decimation
        per_call = 1 if self._env.applies_each_substep else steps
        after: list[Callable[[], None]] = [self._env.count_physics]
        for _ in range(0, steps, per_call):
            after += self.hook.launch().parts()
            self._env.sim.launch(per_call)
        return after


class ResetPart:
    """``_reset_idx`` as an item of a step, with graphs for numbers of environments.

    The graph of a number resets fewer environments, too: its list is filled up with others, whose rows in all arrays
    are kept and brought back. Where that does not give what the hook gives, such as a mean over the environments in
    the log, numbers that come often have graphs of their own.

    Attributes:
        env_ids: The environments that the hook is called with, int64.
    """

    is_capturable = False
    """The host must know their number before it can choose the graph."""
    LEAST, STEP = 16, 4
    """Smallest number with a graph that stands for others, and the factor from one such number to the next. More of
    them would have to be recorded, fewer would reset more environments in vain."""

    def __init__(self, env: RecordingEnv, recorder: HookRecorder):
        """Prepare; the hook is set when the recorder has it."""
        self._env, self._recorder = env, recorder
        self._mask = env.context.reset_mask
        self._mask.listed_in_step = True
        self._order = wp.to_torch(self._mask.order)
        self.env_ids = self._order
        self._padded = 0
        self._rows: tuple[object, EnvRows] | None = None
        self.hook: RecordedHook

    def choose(self) -> tuple[int, object] | None:
        """The number that the graph of this step resets, and its own recording, if it resets fewer, too.

        Such a graph is recorded together with what follows in the step: after the host has waited for the number, one
        launch is all that the device waits for. Graphs of single numbers are not: there may be many.
        """
        self._env.outputs.prepare()  # before the host waits, as the device has work
        size = self._size_for(self._mask.number)
        recording = self._recorder.padded_recording(self.hook, size) if self._mask.number and size else None
        if recording is None:
            return None
        self._padded = size
        return size, recording

    def run(self) -> None:
        """Run the hook for the environments of the reset mask in the recorder's way; nothing if there are none."""
        number = self._mask.number
        if not number:
            return
        self.env_ids = self._order[:number]
        self._padded = self._size_for(number)
        if self._padded and self._recorder.context.carried is not None:
            self._env_rows()  # before a recording, as it copies from the host
        self._recorder.run(self.hook, number, self._padded if self._size_for(1) else None)

    def _size_for(self, number: int) -> int:
        """Number with a graph that covers smaller ones, at least as large; 0 if there is none.

        Only up to half of the environments: hooks may do other things where all are reset.
        """
        size = self.LEAST
        while size < number:
            size *= self.STEP
        return size if 2 * size <= self._env.num_envs else 0

    @contextlib.contextmanager
    def as_variant(self, variant: int) -> Iterator[None]:
        """Context in which the hook gets as many environments as the graph of a number has."""
        if variant != self._padded:
            yield
            return
        assert self._rows is not None  # made by run()
        rows, own = self._rows[1], self.env_ids
        rows.keep(self._mask.order, self._mask.count, variant)
        self.env_ids = self._order[:variant]
        try:
            yield
        finally:
            self.env_ids = own
        # A hook that binds tensors anew has new memory: what it holds of the others goes where their rows are kept.
        carried = self._recorder.context.carried
        assert carried is not None  # before that nothing is recorded
        carried.settle()
        rows.restore(self._mask.order, self._mask.count, variant)

    def _env_rows(self) -> EnvRows:
        carried = self._recorder.context.carried
        if self._rows is None or self._rows[0] is not carried:
            places = max(self._size_for(number) for number in range(1, self._env.num_envs + 1))
            self._rows = carried, EnvRows(_row_tensors(self._env), self._env.num_envs, places, self._env.device)
        return self._rows[1]

    @property
    def status(self) -> str:
        """Way in which it runs, for the description."""
        hook, why = self.hook, self.hook.why_not_padded
        if self._recorder.replayed(hook) and (why or not self._size_for(1)):
            frequent = f"eager: torch hook; graphs for {hook.variants} frequent numbers of resets"
            return f"{frequent}; one for all up to a number is not possible: {why}" if why else frequent
        if self._recorder.replayed(hook):
            sizes = ", ".join(map(str, hook.recorded_variants))
            return f"eager: torch hook; graphs for up to {sizes} resets{_fusion(hook)}"
        return f"eager: torch hook; {why_eager(self.hook)}"

    def launch(self) -> Sequence[Callable[[], None]]:
        """Launch the graph's form that :meth:`choose` has chosen, within a recording."""
        return self.hook.launch(self._padded).parts()


def _row_tensors(env: RecordingEnv) -> list[torch.Tensor]:
    """Tensors that hooks may write and that have a row for each environment."""
    own = [t for t in scan(env, SKIPPED).tensors.values() if t.dim() and t.shape[0] == env.num_envs]
    memory = _arrays(env)
    return own + [t for name, t in memory.items() if not name.startswith("outputs ")]


def in_graph(hook: RecordedHook) -> str:
    """Description of a hook that is part of a graph."""
    return f"graph, torch{_fusion(hook)}"


def _fusion(hook: RecordedHook) -> str:
    return f", {hook.fusion.status}" if hook.fusion.status else ""


def why_eager(hook: RecordedHook) -> str:
    """Reason why a hook is not part of a graph."""
    return hook.reason or "to be recorded after the first steps"
