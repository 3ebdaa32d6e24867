# SPDX-License-Identifier: Apache-2.0
"""Sensor base: how a sensor is built, what a step launches of it, and what terms read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, ClassVar

import newton
import numpy as np
import torch
import warp as wp

from stripe_newton.configclass import MISSING, configclass
from stripe_newton.sim.physics_hook import PhysicsHook
from stripe_newton.sim.scene_context import authored_path, current_scene
from stripe_newton.value_types import NonNegativeFloat, NonNegativeInt

from .sensor_data import SensorData

if TYPE_CHECKING:
    from stripe_newton.assets.scene_assets import SceneAssets
    from stripe_newton.sim import Simulation

__all__ = ["SensorBase", "SensorBaseCfg", "SensorCfg"]


@configclass
class SensorCfg:
    """Base of all configs that become ``scene.sensors``."""

    MAY_BE_NONE: ClassVar[bool] = True

    prim_path: str = MISSING
    """Body or bodies that it measures, such as ``{ENV_REGEX_NS}/Robot/.*_foot``; the last part may be an expression."""
    class_type: Callable[..., SensorBase] | None = None
    """Class that the scene makes of this config."""


@configclass
class SensorBaseCfg(SensorCfg):
    """Base of the configs of sensors that measure in periods."""

    update_period: NonNegativeFloat = 0.0
    """Time between two measurements [s], a whole number of environment steps; 0 for one in each step."""
    history_length: NonNegativeInt = 0
    """Past measurements that are kept; 0 for none."""
    debug_vis: bool = False
    """Draw rays, contact forces and frames in pictures and films, and in the live view from the start; there a checkbox
    does so, too."""

    def problems(self) -> Iterator[tuple[str, str]]:
        """Pairs of a field and what is wrong with it, beyond its type."""
        return iter(())


class SensorBase(PhysicsHook):
    """A sensor of the scene under construction.

    The scene calls :meth:`prepare` before the model is made and :meth:`initialize` after it, and adds the sensor to the
    physics as a hook. A step calls the ``launch_*`` methods, which launch kernels and do nothing else, so that they
    become part of its graph; see :class:`PhysicsHook` for what that forbids.
    """

    cfg: SensorCfg
    """The config."""
    data: SensorData
    """Measurements as tensors, which share the memory of the struct."""
    struct: object | None = None
    """Measurements as the Warp struct that terms read; its arrays lead with the environment. None if there is none."""
    unavailable: dict[str, str]
    """Fields of :attr:`struct` that terms may not read, with the reason and what to set; empty by default."""
    every_substep: bool = False
    """Whether :meth:`launch_substep` runs after every physics step; a sensor may set it for itself."""
    adds_shapes: bool = False
    """Whether :meth:`prepare` adds shapes: such sensors are prepared first, before those that count shapes."""

    def __init__(self, cfg: SensorCfg):
        cfg.validate()
        self.cfg = cfg.copy()
        self.unavailable = {}
        self._scene: SceneAssets = current_scene()
        parent, _, self.expression = self.cfg.prim_path.rpartition("/")
        self.parent_path = authored_path(parent)
        """Prim above those that it measures, in the first environment."""

    # -- construction

    def prepare(self, sim: Simulation, template: newton.ModelBuilder, static: newton.ModelBuilder) -> None:
        """Find what it measures in the builders, and ask the solver for what it must report.

        A sensor may add sites to the builder of one environment here.

        Args:
            sim: The simulation, before its model is made.
            template: Builder of one environment.
            static: Builder of what all environments share.
        """

    def initialize(self, sim: Simulation) -> None:
        """Make the arrays, once the model is there."""
        self._sim = sim
        self.device, self.num_envs = sim.device, sim.num_envs

    # -- what is known of it

    @property
    def body_names(self) -> list[str]:
        """Names of the bodies it measures, in the order of its data."""
        return []

    @property
    def counts(self) -> dict[str, int]:
        """Numbers that sizes of observations depend on, such as ``num_rays``; none by default."""
        return {}

    @property
    def arrays(self) -> dict[str, wp.array]:
        """Arrays that persist from step to step, by name; none by default.

        They are part of an environment's state. Names that end in ``rng`` are random streams, which seeding restarts.
        """
        return {}

    def names_of(self, kind: str) -> list[str] | None:
        """Names among which terms choose bodies (``kind="body"``); None for ``"joint"``, as sensors have none."""
        return self.body_names if kind == "body" else None

    @property
    def measures(self) -> list[str]:
        """Names of the measuring ``launch_*`` methods that it has."""
        return [n for n in _LAUNCHES if getattr(type(self), n) is not getattr(SensorBase, n)]

    # -- what a step launches

    @property
    def follows_each_step(self) -> bool:
        return self.every_substep

    def launch_after_step(self) -> None:
        if self.every_substep:
            self.launch_substep()

    def launch_substep(self) -> None:
        """Measure after a physics step; called where :attr:`every_substep` is set."""

    def launch_measured(self) -> None:
        """Measure on the state after the physics of a step, before terminations and rewards."""

    def launch_reset(self, env_mask: wp.array) -> None:
        """Forget the measurements of environments whose episode just ended.

        Args:
            env_mask: bool, shape ``(num_envs,)``.
        """

    def launch_observed(self) -> None:
        """Measure after forward kinematics of the environments that were reset, before the observations."""

    @property
    def launch_fields(self) -> frozenset[str] | None:
        """Fields of structs that terms have, which its launches read or write; None if it may be any field."""
        return None

    # -- another ground in the same scene, see InteractiveScene.regenerate

    def why_not_regenerable(self, name: str, ground: int) -> str:
        """Reason why a scene with this sensor cannot get another ground, and what to do about it; empty if it can.

        Args:
            name: Name of the sensor in the scene.
            ground: Shape of the model that is the ground's height field.
        """
        return ""

    def replace_ground(self, ground: int, heights: np.ndarray) -> None:
        """Measure other heights of the ground; graphs stay as they are.

        Args:
            ground: Shape of the model that is the ground's height field.
            heights: World z [m] on the same grid, shape ``(nrow, ncol)``.
        """

    # -- outside a graph

    def update(self, dt: float) -> None:
        """Measure, after ``dt`` seconds of physics; for scripts and environments with torch hooks."""
        with wp.ScopedDevice(self.device):
            self.launch_measured()
            self.launch_observed()

    def reset(self, env_ids: Sequence[int] | torch.Tensor | slice | None = None) -> None:
        """Forget the measurements of some environments, default all."""
        mask = torch.zeros(self.num_envs, dtype=torch.bool, device=self.device)
        mask[slice(None) if env_ids is None else env_ids] = True
        with wp.ScopedDevice(self.device):
            self.launch_reset(wp.from_torch(mask, dtype=wp.bool))


_LAUNCHES = "launch_substep", "launch_measured", "launch_reset", "launch_observed"
