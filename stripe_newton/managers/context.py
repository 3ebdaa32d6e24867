# SPDX-License-Identifier: Apache-2.0
"""Manager context: arrays, names, parameters and structs that the managers of one environment share."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Mapping

import torch
import warp as wp

from stripe_kernels.data import EpisodeData, Parameter
from stripe_kernels.episode import seed_streams
from stripe_newton.assets import BoundAsset, RigidObjectCollection
from stripe_newton.assets.term_structs import register_asset_structs
from stripe_newton.fusion import (
    Code,
    EpisodeLog,
    Flag,
    ParameterReferences,
    Parameters,
    Scope,
    SharedStruct,
    StructRegistry,
    code,
)
from stripe_newton.fusion.warp_types import StructInstance, struct_of
from stripe_newton.scene import InteractiveScene
from stripe_newton.sensors import SensorBase
from stripe_newton.sensors.term_structs import register_sensor_structs
from stripe_newton.sim import ResetMask
from stripe_newton.terrains.term_structs import register_terrain_struct

from .config_watch import ConfigWatch
from .term_class import TermEnv

__all__ = ["ManagerContext"]

Reserve = Callable[[str, type, tuple[int, ...]], wp.array]
"""Function that makes an array of a name, a type and a shape."""


class ManagerContext:
    """Arrays, names, parameters and structs that the managers of one environment share.

    Managers get this and not the environment, so that they can be tested, and used in other environments, without it.

    Attributes:
        scene: The scene, built.
        step_dt: Time step of the environment [s].
        decimation: Physics steps in an environment step.
        max_episode_length_s: Duration of an episode [s].
        max_episode_length: Environment steps in an episode.
        scope: Names in generated source.
        parameters: Numbers that a curriculum may change.
        config_watch: Configs whose numbers users may change in place.
        structs: Structs that terms may have as arguments, by type.
        log: Episode log of the step.
        episode: Length and end of the episodes.
        reset_mask: Environments whose episode just ended.
        reset: The array of :attr:`reset_mask`, bool, shape ``(num_envs,)``.
        moved: Environments whose joints were written since the physics, bool, shape ``(num_envs,)``.
        nonfinite: Worlds that were not finite after the physics, bool, shape ``(num_envs,)``.
        reward: Rewards of the step, shape ``(num_envs,)``.
        rng: Random streams, uint32, shape ``(num_envs,)``.
        step: Environment steps taken, int64, shape ``(1,)``.
        stepping: 1 within a step, 0 within ``reset()``; int32, shape ``(1,)``.
        within_step: Flag of sections that run within a step only.
        is_reset: Flag of sections that run where an episode just ended.
        is_finite: Flag of sections that run where the world was finite.
        within_step_or_reset: Flag of sections that run everywhere in a step, and within ``reset()`` in the environments
            that it resets.
        termination_names: Names of the termination terms.
        problems: Problems of the config, gathered so that all are reported at once.
        owner: The environment that torch terms are called with.
        arrays: All arrays that last from step to step, by name.
    """

    def __init__(
        self,
        scene: InteractiveScene,
        step_dt: float,
        decimation: int,
        max_episode_length_s: float,
        max_episode_length: int,
        num_terminations: int = 0,
        owner: TermEnv | None = None,
        reserve: Reserve | None = None,
    ):
        self.scene, self.owner = scene, owner
        self.step_dt, self.decimation = step_dt, decimation
        self.max_episode_length_s, self.max_episode_length = max_episode_length_s, max_episode_length
        self.num_envs, self.device = scene.num_envs, scene.device
        self.scope = Scope()
        self.parameters = Parameters(self.scope, self.device)
        self.log = EpisodeLog(self.scope, self.device)
        self.arrays: dict[str, wp.array] = {}
        self.problems: list[str] = []
        self.termination_names: list[str] = []
        self._streams: list[str] = []
        self._indices: dict[tuple[int, ...], wp.array] = {}
        self._reserve_outputs(reserve or self._make_array)
        self._make_state(num_terminations)
        self._make_flags()
        self.structs = self._make_structs()
        self.config_watch = ConfigWatch(self.parameters)
        self._add_arrays_of_others()
        self.seed(0)

    @property
    def env(self) -> TermEnv:
        """The environment that torch terms are called with.

        Raises:
            RuntimeError: if the context has been made without one.
        """
        if self.owner is None:
            raise RuntimeError("these managers belong to no environment, which torch terms and class terms need")
        return self.owner

    # -- construction

    def _reserve_outputs(self, reserve: Reserve) -> None:
        """Make the arrays of a step's results where the environment wants them, in its output block."""
        self.arrays["reward"] = reserve("reward", wp.float32, (self.num_envs,))
        for name in ("terminated", "truncated"):
            self.arrays[f"episode.{name}"] = reserve(name, wp.bool, (self.num_envs,))
        self.log.bind(reserve("log", wp.float32, (self.log.capacity,)))

    def _make_array(self, name: str, dtype: type, shape: tuple[int, ...]) -> wp.array:
        return wp.zeros(shape, dtype=dtype, device=self.device)

    def _make_state(self, num_terminations: int) -> None:
        self.reset_mask = ResetMask(self.num_envs, self.device)
        self.reset = self.arrays["reset"] = self.reset_mask.array
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
        episode.max_length, episode.max_length_s = self.max_episode_length, self.max_episode_length_s
        episode.step_dt = self.step_dt
        self.episode = episode
        self.nonfinite = self.array("nonfinite", wp.bool)
        for name in ("reset", "moved", "reward", "rng", "step", "stepping", "episode", "nonfinite"):
            self.scope.name(name, getattr(self, name))

    def _make_flags(self) -> None:
        # The rank is the order of nesting in a kernel. Tests with the same outcome in all environments come first, then
        # the ones that are true most often: more sections then share the outer test.
        self.within_step = Flag(0, self.code("{stepping}[0] != 0"))
        self.within_step_or_reset = Flag(1, self.code("({stepping}[0] != 0 or {reset}[env])"))
        self.is_finite = Flag(2, self.code("not {nonfinite}[env]"))
        self.is_reset = Flag(3, self.code("{reset}[env]"))

    def _make_structs(self) -> StructRegistry:
        structs, scene = StructRegistry(), self.scene
        structs.register(EpisodeData, SharedStruct("episode", self.episode))
        structs.register(Parameter, ParameterReferences())
        register_asset_structs(structs, scene.articulations)
        register_sensor_structs(structs, scene.sensors)
        register_terrain_struct(structs, scene.terrain)
        return structs

    def _add_arrays_of_others(self) -> None:
        """Add the arrays of terrain, actuators and sensors, so that they are saved and their random streams seeded."""
        scene = self.scene
        if scene.terrain is not None:
            self.arrays |= {f"terrain.{k}": v for k, v in scene.terrain.arrays.items()}
        self.arrays |= {
            "log": self.log.values,
            "parameters": self.parameters.floats,
            "int_parameters": self.parameters.ints,
        }
        self.arrays |= {f"actuators.{k}": v for k, v in scene.sim.actuation.arrays.items()}
        self._streams += [k for k in ("actuators.rng",) if k in self.arrays]
        for name, sensor in scene.sensors.items():
            lasting = {f"sensors.{name}.{k}": v for k, v in sensor.arrays.items()}
            self.arrays |= lasting
            self._streams += [k for k in lasting if k.endswith("rng")]

    # -- source

    def code(self, template: str, *parts: Code | str | int, **named: Code | str | int) -> Code:
        """Source code as of :func:`stripe_newton.fusion.code`, in which arrays of every environment have placeholders.

        These are ``{reset}``, ``{moved}``, ``{reward}``, ``{rng}``, ``{step}``, ``{stepping}``, ``{nonfinite}`` and
        ``{episode}``, with its fields, such as ``{episode.length}``.
        """
        return code(template, *parts, **(self._own_names() | named))

    def _own_names(self) -> dict[str, Code | str | int]:
        own = ("reset", "moved", "reward", "rng", "step", "stepping", "episode", "nonfinite")
        return {name: self.scope.name(name, getattr(self, name)) for name in own}

    # -- random numbers

    def seed(self, seed: int) -> None:
        """Restart the random streams."""
        self._seed = seed
        wp.launch(seed_streams, dim=self.num_envs, inputs=[seed % 2**31], outputs=[self.rng], device=self.device)
        for name in self._streams:
            array = self.arrays[name]
            # Seeded by its name, so that its draws do not depend on which other streams there are.
            own = (seed + zlib.crc32(name.encode())) % 2**31
            wp.launch(seed_streams, dim=array.shape, inputs=[own], outputs=[array], device=self.device)

    def stream(self, name: str, count: int = 1) -> wp.array:
        """Random streams other than :attr:`rng`, for sections that draw in parallel with others.

        Args:
            name: Name of the array; the same name gives the same streams.
            count: Number of streams for each environment.

        Returns:
            uint32, shape ``(num_envs * count,)``.
        """
        if name not in self._streams:
            self._streams.append(name)
            self.shared(name, wp.uint32, self.num_envs * count)
            self.seed(self._seed)
        return self.arrays[name]

    # -- arrays

    def array(self, name: str, dtype: type, *shape: int, fill: float = 0) -> wp.array:
        """An array of shape ``(num_envs, *shape)`` that lasts from step to step; see :meth:`shared`."""
        return self.shared(name, dtype, self.num_envs, *shape, fill=fill)

    def shared(self, name: str, dtype: type, *shape: int, fill: float = 0) -> wp.array:
        """An array of any shape that lasts from step to step. It is part of the environment's saved state.

        Args:
            name: Its name; the same name gives the same array.
            dtype: A Warp type, or ``float``, ``int`` or ``bool``.
            shape: Shape.
            fill: Initial value.

        Raises:
            ValueError: if the name belongs to an array of another type or shape.
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
        """Indices as an array of int32; equal lists share an array."""
        key = tuple(ids)
        if key not in self._indices:
            self._indices[key] = wp.array(list(ids), dtype=int, device=self.device)
        return self._indices[key]

    def log_now(self, key: str, value: float | torch.Tensor) -> None:
        """Log a value from now on, from the host.

        It bypasses the sums of the log, as the graph that finishes them may not know the key yet.
        """
        index = self.log.add(key, "last")
        self.torch(self.log.values)[index] = torch.as_tensor(value)

    # -- the scene

    def torch(self, array: wp.array) -> torch.Tensor:
        """An array as a tensor that shares its memory."""
        return wp.to_torch(array)

    def entity_names(self) -> list[str]:
        """Names of the articulations and rigid objects of the scene."""
        return [*self.scene.articulations, *self.scene.rigid_objects]

    def entity(self, name: str) -> BoundAsset | RigidObjectCollection | SensorBase:
        """An articulation, rigid object, collection of rigid objects or sensor by name.

        Raises:
            KeyError: if there is none; the message lists those that exist.
        """
        scene = self.scene
        families: tuple[Mapping[str, BoundAsset | RigidObjectCollection | SensorBase], ...] = (
            scene.articulations, scene.rigid_objects, scene.rigid_object_collections, scene.sensors,
        )  # fmt: skip
        for family in families:
            if name in family:
                return family[name]
        there = ", ".join([*self.entity_names(), *scene.rigid_object_collections, *scene.sensors]) or "none"
        raise KeyError(f"no asset or sensor '{name}' in the scene; it has {there}")

    def asset(self, name: str) -> BoundAsset:
        """An articulation or rigid object by name.

        Raises:
            KeyError: if there is none, or it is a sensor; the message lists those that exist.
        """
        entity = self.entity(name)
        if not isinstance(entity, BoundAsset):
            what = "a sensor"
            if isinstance(entity, RigidObjectCollection):
                what = f"a collection, of which terms take one object, such as '{name}_{entity.object_names[0]}'"
            raise KeyError(f"'{name}' is {what}; must be an articulation or a rigid object")
        return entity

    def provide(self, struct: StructInstance, name: str, counts: Mapping[str, int] | None = None) -> None:
        """Offer a user's struct to terms, by its type and a name. Call it before the managers are made.

        Args:
            struct: An instance of a Warp struct; the first dimension of its arrays is the environment.
            name: Its name. A term with an argument of this type gets the struct; if there are several of the type, the
                term's params name one by ``<argument>`` or ``<argument>_name``.
            counts: Numbers that sizes of observations may depend on, by name.
        """
        self.structs.named(struct_of(struct)).add(name, struct, counts)
