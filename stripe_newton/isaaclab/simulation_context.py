# SPDX-License-Identifier: Apache-2.0
"""Simulation context of the Isaac Lab dialect: the simulation of an environment, or of a script with its own scene.

Isaac Lab has one of them in a process. Here each environment has its own, and :meth:`SimulationContext.instance` is the
one that was made last.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from pxr import Usd

from stripe_newton.configclass import is_config
from stripe_newton.scene import InteractiveScene as NativeScene
from stripe_newton.sim import GroundPlaneCfg, Simulation
from stripe_newton.sim import SimulationCfg as NativeSimulationCfg
from stripe_newton.viewers import ViewerCfg

from .app import get_settings
from .latest_simulation import latest_simulation, set_latest_simulation
from .simulation_cfg import SimulationCfg
from .standalone_scene import StandaloneScene, begin_authoring, end_authoring

__all__ = ["SimulationContext", "build_simulation_context"]

Point = Sequence[float]


class SimulationContext(Simulation):
    """:class:`stripe_newton.sim.Simulation` with Isaac Lab's methods.

    A script makes one, spawns prims and creates assets, calls :meth:`reset`, and then steps it.
    """

    class RenderMode(enum.IntEnum):
        """How Isaac Sim would draw. Nothing is drawn but the pictures that somebody asks for."""

        NO_GUI_OR_RENDERING = -1
        NO_RENDERING = 0
        PARTIAL_RENDERING = 1
        FULL_RENDERING = 2

    def __init__(self, cfg: NativeSimulationCfg | None = None, standalone: bool = True):
        """Begin a scene.

        Args:
            cfg: Settings.
            standalone: Whether a script authors the scene, rather than an environment.
        """
        super().__init__(SimulationCfg() if cfg is None else cfg)
        set_latest_simulation(self)
        self.camera = ViewerCfg(eye=(7.5, 7.5, 7.5), lookat=(0.0, 0.0, 0.0), origin_type="world", resolution=(960, 540))
        """Camera of the pictures that :class:`SimulationApp` writes."""
        self.render_mode = self.RenderMode.NO_GUI_OR_RENDERING
        self.current_time = 0.0
        """Simulated time [s]."""
        self.current_time_step_index = 0
        """Number of physics steps."""
        self._callbacks: dict[str, Callable[[float], None]] = {}
        self.scene: NativeScene | None = None
        """The scene that the script makes; that of an environment, once it has one."""
        if standalone:
            self.scene = StandaloneScene(self)
            begin_authoring(self.scene)

    # -- the one of this process

    @classmethod
    def instance(cls) -> SimulationContext | None:
        """The simulation that was made last; None if it was closed."""
        found: SimulationContext | None = latest_simulation()
        return found

    @classmethod
    def clear_instance(cls) -> None:
        """Forget the simulation that was made last."""
        set_latest_simulation(None)
        end_authoring()

    def close(self) -> None:
        super().close()
        if latest_simulation() is self:
            self.clear_instance()

    def take_scene(self, scene: NativeScene) -> None:
        """Go on with another scene on the same stage, with the assets and sensors that were made before it."""
        before = self.scene
        if before is not None:
            scene.assets[:0] = before.assets
            for name in ("articulations", "rigid_objects", "rigid_object_collections", "sensors", "extras"):
                setattr(scene, name, getattr(before, name) | getattr(scene, name))
        self.scene = scene
        begin_authoring(scene)

    # -- running

    def reset(self, soft: bool = False) -> None:
        """Make the model, the first time; afterwards bring all assets back to their initial state.

        Args:
            soft: Leave the states as they are.
        """
        scene = self._authored()
        if not scene.built:
            scene.build()
        elif not soft:
            scene.controller.reset_robots(None, to_default=True)
        self.current_time, self.current_time_step_index = 0.0, 0

    def step(self, substeps: int | bool = 1, render: bool | None = None) -> None:
        """Advance the physics.

        Args:
            substeps: Number of physics steps; a bool is Isaac Lab's ``render``, and means one.
            render: Has no effect.
        """
        count = 1 if isinstance(substeps, bool) else substeps
        for callback in list(self._callbacks.values()):
            callback(self.physics_dt)
        super().step(count)
        self.current_time += count * self.physics_dt
        self.current_time_step_index += count

    def render(self, mode: RenderMode | None = None) -> None:
        """Nothing: pictures are drawn when they are asked for."""

    def set_camera_view(self, eye: Point, target: Point, camera_prim_path: str = "") -> None:
        """Put the camera of pictures at ``eye`` and look at ``target`` [m], world frame."""
        points = [tuple(float(x) for x in point) for point in (eye, target)]
        self.camera = self.camera.replace(eye=points[0], lookat=points[1])

    def play(self) -> None:
        """Nothing: time passes in :meth:`step` alone."""

    pause = stop = play

    def add_physics_callback(self, callback_name: str, callback_fn: Callable[[float], None]) -> None:
        """Call a function with the time step before each physics step."""
        self._callbacks[callback_name] = callback_fn

    def remove_physics_callback(self, callback_name: str) -> None:
        """Stop calling a function."""
        self._callbacks.pop(callback_name, None)

    def clear_all_callbacks(self) -> None:
        """Stop calling all functions."""
        self._callbacks.clear()

    def clear(self) -> None:
        """Nothing: the next simulation has a stage of its own."""

    # -- what it is

    @property
    def stage(self) -> Usd.Stage:
        """The USD stage."""
        return self._authored().stage

    get_initial_stage = property(lambda self: lambda: self.stage)

    def get_physics_dt(self) -> float:
        """Time step of the physics [s]."""
        return self.physics_dt

    def get_rendering_dt(self) -> float:
        """Time between two pictures of a live view [s]."""
        return self.physics_dt * self.cfg.render_interval

    def is_playing(self) -> bool:
        """Whether the model is made."""
        return self.scene is not None and self.scene.built

    def is_stopped(self) -> bool:
        """Whether the model is not made yet."""
        return not self.is_playing()

    def has_gui(self) -> bool:
        """False: there is no window."""
        return False

    def has_rtx_sensors(self) -> bool:
        """False: cameras do not need NVIDIA's renderer."""
        return False

    def is_fabric_enabled(self) -> bool:
        """False: states are Newton's arrays."""
        return False

    def set_setting(self, name: str, value: object) -> None:
        """Remember a setting. It has no effect."""
        get_settings().set(name, value)

    def get_setting(self, name: str) -> object:
        """A setting that was remembered, or None."""
        return get_settings().get(name)

    def _authored(self) -> NativeScene:
        if self.scene is None:
            raise RuntimeError("the simulation has no scene: it belongs to an environment that is not built yet")
        return self.scene


@contextmanager
def build_simulation_context(
    create_new_stage: bool = True,
    gravity_enabled: bool = True,
    device: str = "cuda:0",
    dt: float = 0.01,
    sim_cfg: NativeSimulationCfg | None = None,
    add_ground_plane: bool = False,
    add_lighting: bool = False,
    auto_add_lighting: bool = False,
) -> Iterator[SimulationContext]:
    """A simulation for the duration of a ``with`` block, with Isaac Lab's options.

    Args:
        create_new_stage: Has no effect: each simulation has a stage of its own.
        gravity_enabled: Whether there is gravity.
        device: Device.
        dt: Time step of the physics [s].
        sim_cfg: Settings in place of those above.
        add_ground_plane: Spawn a ground at ``/World/defaultGroundPlane``.
        add_lighting: Has no effect: pictures have light.
        auto_add_lighting: Has no effect, as above.
    """
    chosen = device if device == "cpu" or torch.cuda.is_available() else "cpu"
    gravity = (0.0, 0.0, -9.81) if gravity_enabled else (0.0, 0.0, 0.0)
    cfg: Any = sim_cfg if is_config(sim_cfg) else SimulationCfg(device=chosen, dt=dt, gravity=gravity)
    sim = SimulationContext(cfg)
    try:
        if add_ground_plane:
            ground = GroundPlaneCfg()
            ground.func("/World/defaultGroundPlane", ground)
        yield sim
    finally:
        sim.close()
