# SPDX-License-Identifier: Apache-2.0
"""What the managers of an environment share."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from typing import Any

import torch
import warp as wp

from stripe_kernels.data import EpisodeData
from stripe_kernels.episode import seed_streams
from stripe_kernels.model_data import EncoderData
from stripe_newton.fusion import EpisodeLog, Parameters, Scope
from stripe_newton.scene import InteractiveScene

__all__ = ["ManagerContext"]


class ManagerContext:
    """Arrays, names and numbers of one environment; managers get this and never the environment.

    Attributes:
        scene: The scene, built.
        step_dt: Time step of the environment [s].
        decimation: Physics steps in it.
        max_episode_length_s: Duration of an episode [s].
        max_episode_length: Environment steps in it.
        scope: Names in generated source.
        parameters: Numbers that are tuned.
        log: The log of a step.
        episode: Length and end of the episodes.
        reset: Environments whose episode just ended, bool, shape ``(num_envs,)``.
        moved: Environments whose joints were written since the physics, bool, shape ``(num_envs,)``.
        reward: Rewards of the step, shape ``(num_envs,)``.
        rng: Random streams, uint32, shape ``(num_envs,)``.
        step: Environment steps taken, int64, shape ``(1,)``.
        provided: Structs that terms may ask for, by type and name.
        problems: What is wrong with the config, gathered.
        stepping: 1 within a step, 0 while environments are reset from outside; int32, shape ``(1,)``.
        owner: What torch terms get as their environment.
        arrays: Everything that lasts from step to step, by name.
    """

    def __init__(
        self,
        scene: InteractiveScene,
        step_dt: float,
        decimation: int,
        max_episode_length_s: float,
        max_episode_length: int,
        num_terminations: int = 0,
        owner: Any = None,
        reserve: Callable[..., wp.array] | None = None,
    ):
        self.scene, self.owner = scene, owner
        self.step_dt, self.decimation = step_dt, decimation
        self.max_episode_length_s, self.max_episode_length = max_episode_length_s, max_episode_length
        self.num_envs, self.device = scene.num_envs, scene.device
        self.scope = Scope()
        self.parameters = Parameters(self.scope, self.device)
        self.log = EpisodeLog(self.scope, self.device)
        self.arrays: dict[str, wp.array] = {}
        self.provided: dict[Any, dict[str, Any]] = {}
        self.problems: list[str] = []
        self._streams: list[str] = []
        self._indices: dict[tuple[int, ...], wp.array] = {}
        self.termination_names: list[str] = []
        self.action_slices: dict[str, tuple[int, int]] = {}
        self.action_parts: dict[str, Any] = {}
        reserve = reserve or (lambda name, dtype, shape: wp.zeros(shape, dtype=dtype, device=self.device))
        self.arrays["reward"] = reserve("reward", wp.float32, (self.num_envs,))
        for name in ("terminated", "truncated"):
            self.arrays[f"episode.{name}"] = reserve(name, wp.bool, (self.num_envs,))
        self.log.bind(reserve("log", wp.float32, (self.log.capacity,)))
        self.reset = self.array("reset", wp.bool)
        self.moved = self.array("moved", wp.bool)
        self.reward = self.array("reward", float)
        self.rng = self.array("rng", wp.uint32)
        self.step = self.shared("step", wp.int64, 1)
        self.stepping = self.shared("stepping", int, 1, fill=1)
        episode = EpisodeData()
        episode.length = self.array("episode.length", wp.int64)
        episode.terminated = self.array("episode.terminated", wp.bool)
        episode.truncated = self.array("episode.truncated", wp.bool)
        episode.term_terminated = self.array("episode.term_terminated", wp.bool, num_terminations)
        episode.max_length, episode.max_length_s, episode.step_dt = max_episode_length, max_episode_length_s, step_dt
        self.episode = episode
        for name in ("reset", "moved", "reward", "rng", "step", "stepping", "episode"):
            self.scope.name(name, getattr(self, name))
        for name, sensor in scene.sensors.items():
            if sensor.struct is not None:
                self.provide(sensor.struct, name)
        if scene.terrain is not None:
            if scene.terrain.struct is not None:
                self.provide(scene.terrain.struct, "terrain")
            self.arrays |= {f"terrain.{k}": v for k, v in scene.terrain.arrays.items()}
        for name, articulation in scene.articulations.items():
            encoder = EncoderData()
            encoder.bias = wp.zeros((self.num_envs, articulation.num_joints), dtype=float, device=self.device)
            self.provide(encoder, name)
        self.arrays |= {
            "log": self.log.values,
            "parameters": self.parameters.floats,
            "int_parameters": self.parameters.ints,
        }
        self.arrays |= {f"actuators.{k}": v for k, v in scene.sim.actuation.arrays.items()}
        self._streams += [k for k in ("actuators.rng",) if k in self.arrays]
        for name, sensor in scene.sensors.items():
            lasting = {f"sensors.{name}.{k}": v for k, v in getattr(sensor, "arrays", {}).items()}
            self.arrays |= lasting
            self._streams += [k for k in lasting if k.endswith("rng")]
        self.seed(0)

    def seed(self, seed: int) -> None:
        """Restart the random streams."""
        self._seed = seed
        wp.launch(seed_streams, dim=self.num_envs, inputs=[seed % 2**31], outputs=[self.rng], device=self.device)

        for name in self._streams:
            array = self.arrays[name]
            own = (seed + zlib.crc32(name.encode())) % 2**31
            wp.launch(seed_streams, dim=array.shape, inputs=[own], outputs=[array], device=self.device)

    def stream(self, name: str, count: int = 1) -> wp.array:
        """Random streams beside :attr:`rng`, uint32, shape ``(num_envs,)``, for what runs beside other draws.

        With a ``count`` above 1 so many for each environment, shape ``(num_envs * count,)``.
        """
        if name not in self._streams:
            self._streams.append(name)
            self.shared(name, wp.uint32, self.num_envs * count)
            self.seed(self._seed)
        return self.arrays[name]

    def array(self, name: str, dtype: Any, *shape: int, fill: float = 0) -> wp.array:
        """An array ``(num_envs, *shape)`` that lasts from step to step; the same one for the same name."""
        return self.shared(name, dtype, self.num_envs, *shape, fill=fill)

    def shared(self, name: str, dtype: Any, *shape: int, fill: float = 0) -> wp.array:
        """An array that lasts from step to step, of any shape.

        Raises:
            ValueError: if the name is taken by another type or shape.
        """
        dtype = {float: wp.float32, int: wp.int32, bool: wp.bool}.get(dtype, dtype)
        there = self.arrays.get(name)
        if there is None:
            there = self.arrays[name] = wp.zeros(shape, dtype=dtype, device=self.device)
            if fill:
                there.fill_(fill)
        if there.dtype is not dtype or tuple(there.shape) != tuple(shape):
            kind = f"{there.dtype.__name__} {tuple(there.shape)}"
            raise ValueError(f"array '{name}' is {kind} already, asked for {dtype.__name__} {tuple(shape)}")
        return there

    def index_array(self, ids: list[int]) -> wp.array:
        """Indices as an array of int32; equal ones share it."""
        key = tuple(ids)
        if key not in self._indices:
            self._indices[key] = wp.array(list(ids), dtype=int, device=self.device)
        return self._indices[key]

    def entity_names(self) -> list[str]:
        """Names of the assets that terms may be about."""
        return [*self.scene.articulations, *self.scene.rigid_objects]

    def entity(self, name: str) -> Any:
        """An articulation, rigid object or sensor by name.

        Raises:
            KeyError: if there is none; the message says what there is.
        """
        scene = self.scene
        for family in (scene.articulations, scene.rigid_objects, scene.sensors):
            if name in family:
                return family[name]
        there = ", ".join([*self.entity_names(), *scene.sensors]) or "none"
        raise KeyError(f"no asset or sensor '{name}' in the scene; it has {there}")

    def provide(self, value: Any, name: str) -> None:
        """Offer a struct to terms, by its type and a name."""
        self.provided.setdefault(value._cls, {})[name] = value

    def torch(self, array: wp.array) -> torch.Tensor:
        """An array as a tensor, same memory."""
        return wp.to_torch(array)
