# SPDX-License-Identifier: Apache-2.0
"""Actuation: all actuators of a model, which turn targets into efforts before each physics step."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence

import newton
import numpy as np
import warp as wp
from newton.actuators import Actuator, DriveNeuralGRU, DriveNeuralLSTM

from stripe_kernels.actuation import repeat_mask
from stripe_kernels.actuators import JointDrives, drive_joints, mask_gains, reset_drives
from stripe_kernels.episode import seed_streams

from .drive_table import MADE, DriveTable, read_drives
from .torch_actuators import TorchDrive
from .torch_targets import ChangedTargets

__all__ = ["Actuation"]

_GAINS = ("joint_target_ke", "stiffness"), ("joint_target_kd", "damping")
"""Arrays of the model with gains, and what ``JointDrives`` calls them."""


class Actuation:
    """Turns the targets of joints into efforts, and keeps the memory of actuators.

    Newton's actuators of the laws in :mod:`stripe_kernels.actuators` are computed by one launch, together with what
    accompanies the solver's own drives. Others, the networks, are stepped by Newton and limited in that same launch.
    ``model.joint_target_ke``, ``joint_target_kd`` and ``joint_effort_limit`` hold gains and limits of both kinds, so
    that events and writers need not know which kind a joint has; the actuators of the model keep the numbers they were
    made with, which nothing reads any more.

    Attributes:
        drives: Arrays of all joints, ``stripe_kernels.actuators.JointDrives``.
        explicit: Degrees of freedom of an environment that an explicit actuator drives, bool, shape ``(dofs,)``.
        drives_orientations: Whether an explicit actuator drives a degree of freedom of a free joint or a ball.
        computed_effort: Efforts of the laws in the last physics step, before any limit, shape ``(joint_dof_count,)``.
        changed_targets: What shows the solver's drives other targets during a physics step.
        rng: Random streams that lags are drawn from, uint32, shape ``(num_envs,)``.
    """

    def __init__(self, model: newton.Model, num_envs: int, dt: float, knows_modes: bool, use_graph: bool):
        """Take over the actuators of ``model``, before its solver is made.

        Args:
            model: The model, on the device.
            num_envs: Number of environments.
            dt: Time step of the physics [s].
            knows_modes: Whether the solver obeys ``joint_target_mode``, as MuJoCo does. From others the gains of
                explicit actuators are hidden.
            use_graph: Whether it must be possible to record the launches as a CUDA graph.

        Raises:
            ValueError: for actuators that do not fit, or cannot be part of a graph.
        """
        self._model, self._num_envs = model, num_envs
        self.changed_targets: list[ChangedTargets] = []
        self._dofs = model.joint_dof_count // num_envs
        table = read_drives(model, num_envs)
        self._stepped = [(a, *_states(a)) for a in table.stepped]
        for actuator in table.stepped:
            if use_graph and model.device.is_cuda and not actuator.is_graphable():
                if isinstance(actuator.drive, TorchDrive):
                    raise ValueError(
                        f"actuator '{actuator.drive.slot.name}' is a law in torch, which cannot be part of a CUDA "
                        "graph: set SimulationCfg(use_cuda_graph=False)"
                    )
                raise ValueError(
                    f"{type(actuator.drive).__name__} of '{getattr(actuator.drive, 'model_path', '')}' cannot be part "
                    "of a CUDA graph: export the network to ONNX, or set SimulationCfg(use_cuda_graph=False)"
                )
        self.explicit = table.law > 0
        self.drives_orientations = bool((self.explicit & (table.coord < 0)).any())
        self._delays: list[tuple[int, int]] = []
        # Delays of a config share one lag: each slot of the history knows its group, -1 where the lag is fixed.
        self._delay_group = np.full(int(table.delay_slot.max(initial=-1)) + 1, -1, dtype=np.int32)
        self.drives = self._make_drives(table, dt, knows_modes)
        self.computed_effort = self.drives.computed_effort.flatten()
        self.rng = wp.zeros(num_envs, dtype=wp.uint32)
        wp.launch(seed_streams, dim=num_envs, inputs=[0], outputs=[self.rng])
        # Stand-ins for the model's arrays, in which explicit joints have no gains.
        self._hidden = {n: getattr(self.drives, f"solver_{k}").flatten() for n, k in _GAINS} if self._masks else {}
        self._masks_of = [(s, wp.empty(a.num_actuators, dtype=wp.bool)) for a, s, _ in self._stepped if s is not None]
        self._make_groups()

    def _make_drives(self, table: DriveTable, dt: float, knows_modes: bool) -> JointDrives:
        model, drives, shape = self._model, JointDrives(), (self._num_envs, self._dofs)
        drives.dt, drives.feeds_velocity = dt, knows_modes
        drives.masks_gains = self._masks = bool(self.explicit.any()) and not knows_modes
        for name in ("coord", "law", "has_curve", "table_start", "table_count", "table_pos", "table_effort",
                     "delay_slot"):  # fmt: skip
            setattr(drives, name, wp.array(getattr(table, name)))
        table.write_gains(model)
        for name, attribute in (
            ("mode", "joint_target_mode"), ("stiffness", "joint_target_ke"), ("damping", "joint_target_kd"),
            ("effort_limit", "joint_effort_limit"),
        ):  # fmt: skip
            setattr(drives, name, getattr(model, attribute).reshape(shape))
        # Arrays that only explicit actuators need are empty without one: the kernel then reads none of them.
        explicit = shape if self.explicit.any() else (0, 0)
        for name in ("integral_gain", "integral_limit", "bias_effort", "saturation_effort", "no_load_speed"):
            setattr(drives, name, wp.array(table.floats[name].reshape(shape)) if explicit == shape else None)
        drives.made_effort = wp.zeros(explicit, dtype=float)
        drives.integral = wp.zeros(explicit if (table.law == 2).any() else (0, 0), dtype=float)
        drives.computed_effort = wp.zeros(shape, dtype=float)
        masked = shape if self._masks else (0, 0)
        drives.solver_stiffness, drives.solver_damping = wp.zeros(masked, dtype=float), wp.zeros(masked, dtype=float)
        self._allocate_delays(drives, table.lag.reshape(self._num_envs, -1), table.depth)
        return drives

    def _allocate_delays(self, drives: JointDrives, lag: np.ndarray, depth: int) -> None:
        slots = lag.shape[1]
        drives.lag = wp.array(np.ascontiguousarray(lag, dtype=np.int32), ndim=2)
        drives.pushes = wp.zeros((self._num_envs, slots), dtype=int)
        drives.history = wp.zeros((depth, self._num_envs, slots), dtype=wp.vec3)

    def bind(self, state: newton.State, control: newton.Control) -> None:
        """Read the joints from ``state`` and the targets from ``control`` from now on, and write its ``joint_f``."""
        drives, shape = self.drives, (self._num_envs, -1)
        self._state, self._control = state, control
        if not self._dofs:
            return
        drives.joint_pos, drives.joint_vel = state.joint_q.reshape(shape), state.joint_qd.reshape(shape)
        drives.pos_target = control.joint_target_q.reshape(shape)
        drives.vel_target = control.joint_target_qd.reshape(shape)
        drives.effort_target, drives.effort = control.joint_act.reshape(shape), control.joint_f.reshape(shape)
        setattr(control, MADE, drives.made_effort.flatten())
        self.hide_gains()

    @property
    def draws_delays(self) -> bool:
        """Whether delays differ from episode to episode."""
        return any(low < high for low, high in self._delays)

    def delay(self, dofs: Sequence[int], low: int, high: int) -> None:
        """Delay targets by a lag that is drawn for each environment when an episode begins, the same for all ``dofs``.

        Args:
            dofs: Degrees of freedom of an environment; their actuators have a delay.
            low: Least lag [physics steps].
            high: Largest lag, at most that of the actuators.
        """
        slots = self.drives.delay_slot.numpy()[list(dofs)]
        self._delay_group[slots] = len(self._delays)
        self._delays.append((low, high))
        with wp.ScopedDevice(self._model.device):
            self._make_groups()
            self.reset(wp.ones(self._num_envs, dtype=wp.bool))

    def _make_groups(self) -> None:
        bounds = np.array(self._delays, dtype=np.int32).reshape(-1, 2)
        self._groups = [wp.array(x) for x in (self._delay_group, bounds[:, 0].copy(), bounds[:, 1].copy())]

    @property
    def networks(self) -> list[str]:
        """Names of Newton's classes of the drives that Newton steps itself, such as ``DriveNeuralLSTM``."""
        return sorted({type(actuator.drive).__name__ for actuator, _, _ in self._stepped})

    # -- at work

    def launch(self, index: int = 0, last: bool = True) -> None:
        """Compute the efforts of a physics step; may be captured.

        Args:
            index: Physics steps before it among those that are launched together.
            last: Whether it is the last of them.
        """
        # Newton's networks read one state and write another. The two take turns, without copies, and the next launch
        # must find the newest in the first one again: after an odd number of steps it is copied there.
        for actuator, first, second in self._stepped:
            now, following = (first, second) if index % 2 == 0 else (second, first)
            actuator.step(self._state, self._control, now, following, dt=self.drives.dt)
            if last and first is not None and first is not second and index % 2 == 0:
                first.assign(second)
        self._launch(drive_joints)

    @contextlib.contextmanager
    def targets_of_step(self) -> Iterator[None]:
        """During a physics step: targets as laws in torch change them, where there are such."""
        for targets in self.changed_targets:
            targets.change()
        yield
        for targets in self.changed_targets:
            targets.restore()

    def reset(self, env_mask: wp.array) -> None:
        """Forget the past of environments and draw new lags; may be captured.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """
        if self._delay_group.size or self.drives.integral.size:
            inputs = [env_mask, *self._groups, self.rng, self.drives]
            wp.launch(reset_drives, dim=self._num_envs, inputs=inputs, device=self._model.device)
        for state, mask in self._masks_of:
            count = mask.size // self._num_envs
            wp.launch(repeat_mask, dim=mask.shape, inputs=[env_mask, count], outputs=[mask], device=mask.device)
            state.reset(mask)
        if self.changed_targets:
            ids = wp.to_torch(env_mask).nonzero().flatten()
            for targets in self.changed_targets if len(ids) else ():
                targets.reset(ids)

    def hide_gains(self) -> None:
        """Bring the gains that :meth:`solver_gains` shows up to date."""
        if self._masks:
            self._launch(mask_gains)

    @contextlib.contextmanager
    def solver_gains(self) -> Iterator[None]:
        """Show the solver the gains of its own drives alone, if it would take those of explicit actuators for them.

        The model's arrays are swapped for masked copies while the solver looks, which launches nothing.
        """
        shown = {name: getattr(self._model, name) for name in self._hidden}
        vars(self._model).update(self._hidden)
        try:
            yield
        finally:
            vars(self._model).update(shown)

    def _launch(self, kernel: wp.Kernel) -> None:
        if self._dofs:
            dim = self._num_envs, self._dofs
            wp.launch(kernel, dim=dim, inputs=[self.drives], device=self._model.device)

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that persist from step to step, by name."""
        found = {n: getattr(self.drives, n) for n in ("integral", "lag", "pushes", "history")}
        found |= {"rng": self.rng} if self._delays else {}
        for i, (_, state, _) in enumerate(self._stepped):
            for part in ("delay_state", "drive_state"):
                value = getattr(state, part, None)
                for field in dataclasses.fields(value) if value is not None else ():
                    found[f"{i}.{part}.{field.name}"] = getattr(value, field.name)
        return {n: a for n, a in found.items() if isinstance(a, wp.array) and a.size}


def _states(actuator: Actuator) -> tuple[Actuator.State | None, Actuator.State | None]:
    """States before and after a step: one and the same where each number is read before it is written."""
    first = actuator.state()
    alone = type(actuator.drive) in (DriveNeuralGRU, DriveNeuralLSTM, TorchDrive) and actuator.delay is None
    return first, first if alone or first is None else actuator.state()
