# SPDX-License-Identifier: Apache-2.0
"""Contact sensor: net forces and contact times of bodies."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import newton
import numpy as np
import torch
import warp as wp

from stripe_kernels.sensors import contact as kernels
from stripe_kernels.sensors.contact_mujoco import CONTACT_FIELDS, add_mujoco_contacts
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.fusion.warp_types import struct_fields
from stripe_newton.matching import match_names
from stripe_newton.noise import NoiseCfg, NoiseModelCfg
from stripe_newton.sim.mujoco_solver_cfg import MuJoCoSolverCfg
from stripe_newton.solvers import SolverFused
from stripe_newton.value_types import NonNegativeFloat, NonNegativeInt

from .clock import SensorClock, period_steps
from .corruption import Corruption
from .prim_paths import find_bodies, find_colliders, per_shape
from .sensor_base import SensorBase, SensorBaseCfg
from .sensor_data import SensorData
from .warp_struct import copy_struct

if TYPE_CHECKING:
    from stripe_newton.sim import Simulation

__all__ = ["ContactSensor", "ContactSensorCfg"]

_TIMES = "current_air_time", "last_air_time", "current_contact_time", "last_contact_time"


def _contact_sensor(cfg: ContactSensorCfg) -> ContactSensor:
    return ContactSensor(cfg)


@configclass
class ContactSensorCfg(SensorBaseCfg):
    """Contact forces on bodies; ``prim_path`` names the bodies."""

    class_type: Callable[..., SensorBase] | None = _contact_sensor
    """Class that the scene makes of this config."""
    filter_prim_paths_expr: Sequence[str] = ()
    """Sources of the forces in ``force_matrix_w``: bodies, or prims with all colliders below them, such as
    ``/World/ground`` or ``{ENV_REGEX_NS}/Ball``. Each that matches is one filter."""
    track_air_time: bool = False
    """Whether times in the air and in contact are kept."""
    track_pose: bool = False
    """Whether ``pos_w`` and ``quat_w`` are handed out."""
    force_threshold: NonNegativeFloat = 1.0
    """Force above which a body is in contact [N]."""
    substeps: bool | None = None
    """Measure after every physics step, so that the history holds physics steps and times are as fine; otherwise once,
    at the end of the environment's step. By default where a history is kept, or ``update_period`` is a physics step."""
    noise: NoiseCfg | NoiseModelCfg | None = None
    """Noise on ``net_forces_w`` and its history; times and ``force_matrix_w`` have none. A noise model draws its bias
    at the start of an episode."""
    delay: NonNegativeInt = 0
    """Age of ``net_forces_w`` and its history, in measurements; times and ``force_matrix_w`` are not late."""


class ContactSensor(SensorBase):
    """Net and filtered contact forces on bodies, their history, and times in contact and in the air.

    The fused solver writes the forces of contacts, which one launch a measurement reads. With MuJoCo Warp they are read
    from its contacts and constraints: two launches a measurement, and one more a step for the times. Other solvers must
    report contact forces, which the sensor switches on. A measurement reads the forces of the last physics step, so
    that an episode has none before its first step.

    ``data`` has ``net_forces_w``, ``net_forces_w_history``, ``force_matrix_w``, ``current_air_time``,
    ``last_air_time``, ``current_contact_time``, ``last_contact_time`` (see the struct
    :class:`stripe_kernels.sensors.contact.ContactSensorData`), ``pos_w`` and ``quat_w``; ``None`` for what the config
    does not ask for.

    Attributes:
        filter_names: Names of the bodies or prims of the columns of ``force_matrix_w``.
    """

    cfg: ContactSensorCfg
    data: _ContactData
    struct: kernels.ContactSensorData

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        where = f"{type(self).__name__} '{self.cfg.prim_path}'"
        self._bodies, self._names = find_bodies(template, self.cfg.prim_path, f"{where}.prim_path")
        self.filter_names: list[str] = []
        self._columns = np.full(template.shape_count, -1), np.full(static.shape_count, -1)
        for path in self.cfg.filter_prim_paths_expr:
            for name, shapes in find_colliders(template, static, path, f"{where}.filter_prim_paths_expr").items():
                self._add_filter(name, shapes, f"{where}.filter_prim_paths_expr: '{path}'")
        # A contact that lasts less than a step may be missed by one measurement a step: a history asks for all.
        self._period = period_steps(sim, self.cfg.update_period, where)
        substeps = self.cfg.substeps
        if substeps is None:
            substeps = self.cfg.history_length > 0 or 0.0 < self.cfg.update_period < sim.physics_dt * sim.decimation
        self.every_substep = bool(substeps) and self._period == 1
        self._require_forces(sim, where)

    def _add_filter(self, name: str, shapes: tuple[list[int], list[int]], where: str) -> None:
        """Give the colliders of a body or prim the next column of ``force_matrix_w``."""
        for column, indices in zip(self._columns, shapes):
            taken = column[indices].max(initial=-1)
            if taken >= 0:
                raise ConfigError([f"{where} has colliders of '{self.filter_names[taken]}' too; name each once"])
            column[indices] = len(self.filter_names)
        self.filter_names.append(name)

    def _require_forces(self, sim: Simulation, where: str) -> None:
        """Find out how the solver gives its contact forces, and ask for them."""
        solver = sim.cfg.solver
        if isinstance(solver, MuJoCoSolverCfg) and solver.disable_contacts:
            raise ConfigError([f"{where}: the solver computes no contacts, set disable_contacts=False"])
        self._reads_mujoco = solver.uses_mujoco_warp
        if not self._reads_mujoco:
            if "contact_f" not in solver.newton_class.SUPPORTED_OBSERVABLES:
                raise ConfigError(
                    [f"{where}: {solver.solver_class} does not report contact forces, use MuJoCoSolverCfg"]
                )
            sim.cfg.contact_forces = True  # the simulation allocates for them when it is built, after this

    def initialize(self, sim: Simulation) -> None:
        super().initialize(sim)
        self._forces = sim.solver.fill_contact_forces() if isinstance(sim.solver, SolverFused) else None
        self._clock = SensorClock(sim, self.cfg.update_period, type(self).__name__, starts_fresh=False)
        step = sim.physics_dt * (1 if self.every_substep else sim.decimation * self._period)
        self.struct = struct = kernels.ContactSensorData()
        shape = self.num_envs, len(self._bodies)
        with wp.ScopedDevice(self.device):
            struct.net_forces_w_history = wp.zeros((shape[0], max(1, self.cfg.history_length), shape[1]), dtype=wp.vec3)
            struct.net_forces_w = struct.net_forces_w_history[:, 0]  # the newest one is the first of the history
            struct.force_matrix_w = wp.zeros((*shape, len(self.filter_names)), dtype=wp.vec3)
            for name in _TIMES:
                setattr(struct, name, wp.zeros(shape, dtype=float))
            struct.force_threshold, struct.measurement_dt = self.cfg.force_threshold, step
            self._pending, self._remainder = wp.zeros(shape, dtype=wp.bool), wp.zeros(shape, dtype=float)
            self._elapsed = wp.full(1, value=step, dtype=float)
            self._raw = struct
            self._corruption: Corruption | None = None
            if self.cfg.noise is not None or self.cfg.delay:
                self._corrupt(struct)
            self._make_tables(sim)
        missing = [] if self.cfg.track_air_time else list(_TIMES)
        self.unavailable = dict.fromkeys(missing, "not kept; set track_air_time=True in the sensor's config")
        if self._period > 1:  # from measurement_dt terms tell that a foot landed in the last step
            why = f"it measures in every {self._period}. step, which hides what began in the last one"
            self.unavailable["measurement_dt"] = f"{why}; leave out update_period in the sensor's config"
        self.data = _ContactData(struct, [*missing, *([] if self.filter_names else ["force_matrix_w"])])
        if self.cfg.track_pose:
            self.data.track(sim, self._bodies)

    def _corrupt(self, struct: kernels.ContactSensorData) -> None:
        """Keep the net forces that are measured apart from those that are read."""
        self._raw = copy_struct(struct, kernels.ContactSensorData)
        bodies = len(self._bodies)
        block, out = wp.zeros((self.num_envs, 3 * bodies), dtype=float), wp.to_torch(struct.net_forces_w).flatten(1)
        self._raw.net_forces_w = wp.from_torch(wp.to_torch(block).unflatten(1, (bodies, 3)), dtype=wp.vec3)
        where = f"{type(self).__name__} '{self.cfg.prim_path}'.noise"
        noise = [] if self.cfg.noise is None else [(slice(0, 3 * bodies), self.cfg.noise)]
        self._corruption = Corruption(block, noise, self.cfg.delay, where, wp.from_torch(out))

    def _make_tables(self, sim: Simulation) -> None:
        """Find the body and the filter of each shape, or of each of MuJoCo's geoms."""
        template, static, count = sim.template, sim.static, len(self._bodies)
        place = np.full(template.body_count + 1, -1)  # the last one for shapes without a body, whose index is -1
        place[self._bodies] = np.arange(count)
        here = place[np.array(template.shape_body, dtype=int)]
        rows = per_shape(here, np.full(static.shape_count, -1), self.num_envs)
        env = np.arange(self.num_envs).repeat(template.shape_count)
        rows[static.shape_count :] += np.where(rows[static.shape_count :] >= 0, env * count, 0).astype(np.int32)
        # There may be more shapes than when the filters were found: other sensors add sites.
        there = template.shape_count, static.shape_count
        own, shared = (np.append(c, [-1] * (n - len(c))) for c, n in zip(self._columns, there))
        columns = per_shape(own, shared, self.num_envs)
        if self._reads_mujoco:
            shapes = sim.solver.mjc_geom_to_newton_shape.numpy()
            # In MuJoCo every world has its own geoms, and in Newton every environment its own shapes: rows count from
            # the start of each world.
            first = count * np.arange(len(shapes))[:, None]
            rows = np.where((shapes >= 0) & (rows[shapes] >= 0), rows[shapes] - first, -1).astype(np.int32)
            filters, columns = columns, np.where(shapes >= 0, columns[shapes], -1)
            if (rows == rows[0]).all() and (columns == columns[0]).all():  # one row serves all worlds
                rows, columns = rows[:1], columns[:1]
            if isinstance(sim.solver, SolverFused):  # static shapes that are no geoms come behind them
                hidden = sim.solver.hidden_shapes
                rows = np.pad(rows, ((0, 0), (0, len(hidden))), constant_values=-1)
                columns = np.concatenate([columns, np.tile(filters[hidden], (len(columns), 1))], axis=1)
        self._rows, self._filters = wp.array(rows, dtype=int), wp.array(columns, dtype=int)

    # -- what is known of it

    @property
    def body_names(self) -> list[str]:
        return list(self._names)

    @property
    def num_bodies(self) -> int:
        """Number of bodies."""
        return len(self._names)

    @property
    def counts(self) -> dict[str, int]:
        return {"num_filters": len(self.filter_names)}

    @property
    def arrays(self) -> dict[str, wp.array]:
        kept = {name: getattr(self.struct, name) for name in ("net_forces_w_history", "force_matrix_w", *_TIMES)}
        kept["time_remainder"] = self._remainder
        return kept | self._clock.arrays | (self._corruption.arrays if self._corruption else {})

    def find_bodies(self, name_keys: str | Sequence[str], preserve_order: bool = False) -> tuple[list[int], list[str]]:
        """Indices and names of the bodies that match regular expressions.

        Raises:
            ValueError: if an expression matches nothing.
        """
        return match_names(name_keys, self._names, preserve_order, f"body of '{self.cfg.prim_path}'")

    def compute_first_contact(self, dt: float, abs_tol: float | None = None) -> torch.Tensor:
        """Mask of the bodies that came into contact in the last ``dt`` seconds and still are.

        Args:
            dt: The time [s], such as the step of the environment; not less than from one measurement to the next.
            abs_tol: Tolerance [s], by default half the time between two measurements.

        Returns:
            bool, shape ``(num_envs, num_bodies)``.

        Raises:
            RuntimeError: if the sensor keeps no times.
            ValueError: if ``dt`` is shorter than the time between two measurements.
        """
        return self._began(self.data.current_contact_time, dt, abs_tol)

    def compute_first_air(self, dt: float, abs_tol: float | None = None) -> torch.Tensor:
        """Mask of the bodies that left the contact in the last ``dt`` seconds; see :meth:`compute_first_contact`."""
        return self._began(self.data.current_air_time, dt, abs_tol)

    def _began(self, time: torch.Tensor | None, dt: float, abs_tol: float | None) -> torch.Tensor:
        """Mask of the times that began to run in the last ``dt`` seconds."""
        if time is None:
            raise RuntimeError(f"ContactSensor '{self.cfg.prim_path}' keeps no times: set 'track_air_time=True'")
        step = float(self.struct.measurement_dt)
        if dt < 0.999 * step:
            where = f"ContactSensor '{self.cfg.prim_path}'"
            raise ValueError(f"dt: is {dt:g} s, but {where} measures every {step:g} s; ask for that time at least")
        # Times are sums of steps in float32: a time of exactly dt may come out above it.
        tolerance = 0.5 * step if abs_tol is None else abs_tol
        return (time > 0.0) & (time < dt + tolerance)

    # -- what a step launches

    def _launch_measurement(self) -> None:
        struct, due = self._raw, self._clock.due
        begin = [due, self._elapsed, self.cfg.track_air_time]
        if self._forces is not None:
            inputs = [*begin, self._rows, self._filters, self._forces.geoms, self._forces.forces]
            wp.launch(kernels.measure_contacts, struct.net_forces_w.shape, inputs, [self._remainder, struct])
        else:
            outputs = [self._pending, self._remainder, struct]
            wp.launch(kernels.begin_contacts, struct.net_forces_w.shape, begin, outputs)
            if self._reads_mujoco:
                self._add_mujoco_contacts()
            else:
                self._add_newton_contacts()
        if self._corruption is not None:
            self._corruption.launch(due)

    def _add_mujoco_contacts(self) -> None:
        """Read the forces of MuJoCo Warp's constraints; its contacts of all worlds lie in one buffer."""
        data, model = self._sim.solver.mjw_data, self._sim.solver.mjw_model
        fields = [getattr(data.contact, name) for name in CONTACT_FIELDS]
        tables = [self._clock.due, self._rows, self._filters, model.opt.cone]
        inputs = [*tables, *fields, data.efc.force, data.njmax, data.nacon]
        wp.launch(add_mujoco_contacts, data.naconmax, inputs, [self._raw])

    def _add_newton_contacts(self) -> None:
        contacts, forces = self._sim.contacts, self._sim.reported("contact_f")
        assert contacts is not None  # as _require_forces asked for them
        found = [contacts.rigid_contact_count, contacts.rigid_contact_shape0, contacts.rigid_contact_shape1]
        inputs = [self._clock.due, *found, forces, self._rows, self._filters]
        wp.launch(kernels.add_newton_contacts, contacts.rigid_contact_max, inputs, [self._raw])

    def launch_substep(self) -> None:
        self._launch_measurement()

    def launch_measured(self) -> None:
        if not self.every_substep:
            self._launch_measurement()
        if self.cfg.track_air_time and self._forces is None:
            # The last forces become times, which terms of this step read.
            outputs = [self._pending, self._remainder, self._raw]
            wp.launch(kernels.finish_contacts, self._pending.shape, [self._elapsed], outputs)
        self._clock.advance()

    def launch_reset(self, env_mask: wp.array) -> None:
        wp.launch(kernels.reset_contacts, self._pending.shape, [env_mask], [self._pending, self.struct])
        self._clock.restart(env_mask)
        if self._corruption is not None:
            self._corruption.restart(env_mask)

    @property
    def launch_fields(self) -> frozenset[str]:
        return frozenset(struct_fields(kernels.ContactSensorData))

    def update(self, dt: float) -> None:
        if not self.every_substep:
            self._elapsed.fill_(dt * self._period)
            self.struct.measurement_dt = dt * self._period
        super().update(dt)


class _ContactData(SensorData):
    """Data of a contact sensor: its arrays, and the poses of its bodies."""

    _sim: Simulation | None = None

    def track(self, sim: Simulation, bodies: list[int]) -> None:
        contiguous = bodies == list(range(bodies[0], bodies[-1] + 1))
        self._sim, self._rows = sim, slice(bodies[0], bodies[-1] + 1) if contiguous else bodies

    @property
    def pos_w(self) -> torch.Tensor | None:
        """Origins of the bodies, world frame [m], shape ``(num_envs, num_bodies, 3)``."""
        return None if self._sim is None else self._sim.per_env(self._sim.state.body_q)[:, self._rows, :3]

    @property
    def quat_w(self) -> torch.Tensor | None:
        """Orientations of the bodies (x, y, z, w), world frame, shape ``(num_envs, num_bodies, 4)``."""
        return None if self._sim is None else self._sim.per_env(self._sim.state.body_q)[:, self._rows, 3:]
