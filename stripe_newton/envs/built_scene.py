# SPDX-License-Identifier: Apache-2.0
"""Built scene: a simulation and a scene made from a config, with the buffers that a step writes.

The part of environments that is there before the first step: config, construction, sizes, seeds and closing.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable
from typing import Any, ClassVar, NoReturn, SupportsIndex

import numpy as np
import torch
import warp as wp
from gymnasium.utils import seeding
from typing_extensions import Self

from stripe_newton.call_checks import checked_lengths, checked_seed
from stripe_newton.configclass import check_types, is_config
from stripe_newton.managers import ManagerContext
from stripe_newton.scene import InteractiveScene
from stripe_newton.sim import Simulation, SimulationCfg
from stripe_newton.value_types import short

from .output_block import OutputBlock
from .rl_env_cfg import RLEnvCfg
from .safety import Safety
from .single_caller import SingleCaller

__all__ = ["RENDER_MODES", "BuiltScene", "Extras", "Observations"]

Observations = dict[str, Any]
"""Observations by group; a dict by term in the place of a tensor where a group's terms are not concatenated."""
Extras = dict[str, Any]
"""Extras of a reset or step, gymnasium's ``infos``; ``"log"`` is a dict of numbers."""
RENDER_MODES = (None, "rgb_array")
"""Render modes of all environments."""


class BuiltScene:
    """Simulation and scene of a config, and the buffers of an environment.

    Attributes:
        cfg: The config.
        sim: The simulation.
        scene: The scene.
        context: Arrays and names that kernels share.
        common_step_counter: Environment steps taken.
        reset_buf: Environments that ended in the last step, bool, shape ``(num_envs,)``.
        reset_terminated: Environments that ended in failure or success, bool, shape ``(num_envs,)``.
        reset_time_outs: Environments that ran out of time, bool, shape ``(num_envs,)``.
        extras: Extras of the last reset or step; ``extras["log"]`` is a new dict in every step.
    """

    scene_class: ClassVar[type[InteractiveScene]] = InteractiveScene
    """Class of the scene."""
    simulation_class: ClassVar[Callable[[SimulationCfg], Simulation]] = Simulation
    """Class of the simulation, or a function that makes one."""

    cfg: RLEnvCfg
    closed: bool = False
    """Whether :meth:`close` was called."""
    _np_random: np.random.Generator | None = None
    _np_random_seed: int | None = None

    def __init_subclass__(cls, **kwargs: object):
        """Let constructors make tensors that can be written anywhere, wherever an environment is made."""
        super().__init_subclass__(**kwargs)
        if "__init__" in vars(cls):
            setattr(cls, "__init__", torch.inference_mode(False)(cls.__init__))  # noqa: B010  (a method, to mypy)

    @torch.inference_mode(False)
    def __init__(self, cfg: RLEnvCfg, render_mode: str | None = None, **kwargs: object):
        """Build scene and simulation.

        Args:
            cfg: The config; it is copied.
            render_mode: ``"rgb_array"`` for ``render()`` to return pictures.
            kwargs: Not used; a subclass may have arguments of its own, and unknown ones are an error.

        Raises:
            ConfigError: all problems of the config at once.
            TypeError: for an unknown argument.
        """
        if kwargs:
            raise TypeError(f"{type(self).__name__} got unexpected arguments: {', '.join(kwargs)}")
        if render_mode is not None and (not isinstance(render_mode, str) or render_mode not in RENDER_MODES):
            raise ValueError(f"render_mode: is {short(render_mode)}, must be None or 'rgb_array'")
        self.cfg = _completed(cfg, type(self).__name__)
        self.render_mode = render_mode
        self._single_caller = SingleCaller(type(self).__name__)
        if self.cfg.seed is not None:
            self._seed_host(self.cfg.seed)  # before the scene, as hooks draw from torch and NumPy while they make it
        self.sim = type(self).simulation_class(self.cfg.sim)
        self.sim.decimation = self.cfg.decimation
        self._prepare_simulation()
        self.scene = self.scene_class(self.cfg.scene, self.sim)
        with self.scene.construction():
            self._setup_scene()
        self.scene.builder.checks.append(self._name_problems)
        self.scene.build()
        self._make_buffers()

    def _prepare_simulation(self) -> None:
        """Set options of the simulation that must be known before the model is built. The default sets none."""

    def _name_problems(self) -> Iterable[str]:
        """Names in the config that the scene does not have, asked before the model is made; here none."""
        return ()

    def _setup_scene(self) -> None:
        """Create assets that the scene config does not name; called while the scene is under construction."""

    def _num_terminations(self) -> int:
        """Number of termination terms."""
        return 0

    def _make_buffers(self) -> None:
        """Make the arrays that a step writes, and the tensors that show them."""
        self.outputs = OutputBlock(self.num_envs, self.device)
        self.context = context = ManagerContext(
            self.scene,
            step_dt=self.step_dt,
            decimation=self.cfg.decimation,
            max_episode_length_s=self.max_episode_length_s,
            max_episode_length=self.max_episode_length,
            num_terminations=self._num_terminations(),
            owner=self,
            reserve=self.outputs.reserve,
        )
        context.seed(self._np_random_seed or int(torch.randint(2**31, ()).item()))
        self._safety = Safety(self.sim, context)
        self._episode_length_buf = wp.to_torch(context.episode.length)
        self.reset_terminated = wp.to_torch(context.episode.terminated)
        self.reset_time_outs = wp.to_torch(context.episode.truncated)
        self.reset_buf = context.reset_mask.tensor
        self.reset_buf[:] = True
        self.reward_buf = wp.to_torch(context.reward)
        self._stepping = wp.to_torch(context.stepping)
        self.obs_buf: Observations = {}
        self.extras: Extras = {"log": {}}
        self.common_step_counter = 0

    # -- sizes

    @property
    def num_envs(self) -> int:
        """Number of environments."""
        return self.scene.num_envs

    @property
    def device(self) -> str:
        """Device of the simulation and of every tensor."""
        return self.sim.device

    @property
    def physics_dt(self) -> float:
        """Time step of the physics [s]."""
        return self.sim.physics_dt

    @property
    def step_dt(self) -> float:
        """Time step of the environment [s]."""
        return self.sim.physics_dt * self.cfg.decimation

    @property
    def max_episode_length_s(self) -> float:
        """Duration of an episode [s]."""
        return self.cfg.episode_length_s

    @property
    def max_episode_length(self) -> int:
        """Environment steps in an episode."""
        # The tolerance: 0.3 s are three steps of 0.1 s, however the quotient is rounded.
        return max(1, math.ceil(self.max_episode_length_s / self.step_dt - 1.0e-9))

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Steps since the last reset, int64, shape ``(num_envs,)``; assigning copies into the same memory."""
        return self._episode_length_buf

    @episode_length_buf.setter
    def episode_length_buf(self, value: torch.Tensor) -> None:
        self._episode_length_buf.copy_(checked_lengths(value, self.num_envs, self.device))

    # -- random numbers

    def seed(self, seed: int | None = None) -> int:
        """Seed Python's, NumPy's and torch's random numbers; ``None`` draws a seed. Returns the seed.

        Raises:
            ValueError: if the seed is no whole number from 0 to 2**63 - 1.
        """
        seed = int(np.random.default_rng().integers(2**31)) if seed is None else checked_seed(seed)
        self._seed_host(seed)
        if "context" in vars(self):  # a hook may seed while the scene is made
            self.context.seed(seed)
        return seed

    def _seed_host(self, seed: int) -> None:
        """Seed the random numbers that hooks and the scene draw on the host."""
        random.seed(seed)
        np.random.seed(seed % 2**32)  # noqa: NPY002  (what users' hooks draw from)
        torch.manual_seed(seed)
        self._np_random, self._np_random_seed = seeding.np_random(seed)

    # -- closing

    def close(self, **kwargs: object) -> None:
        """Release renderer and simulation; a second call does nothing."""
        if not self.closed:
            self.close_extras(**kwargs)
            self.closed = True

    def close_extras(self, **kwargs: object) -> None:
        """Release the simulation."""
        if "scene" in vars(self):  # the constructor may have failed before
            self.scene.close()

    def _check_open(self) -> None:
        """Raise if the environment is closed: its model and solver are gone."""
        if self.closed:
            raise RuntimeError(f"{type(self).__name__}: is closed; make a new one")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def __reduce_ex__(self, protocol: SupportsIndex) -> NoReturn:
        """Refuse to be copied or pickled, as for a process that is spawned: memory of a device cannot be."""
        raise TypeError(
            f"{type(self).__name__}: an environment cannot be copied or pickled; make another of its config, env.cfg, "
            "in the process that uses it"
        )


def _completed(cfg: RLEnvCfg, owner: str) -> RLEnvCfg:
    """A copy of a config, completed and checked, for a class of environments."""
    if not is_config(cfg):
        given = f"the class {cfg.__name__}; call it" if isinstance(cfg, type) else short(cfg)
        raise TypeError(f"{owner}: cfg: is {given}, must be a config of the environment")
    cfg = cfg.copy()
    try:
        cfg.complete()
    except (AttributeError, TypeError):
        check_types(("cfg", cfg))  # what a value of a wrong type has led to is no help
        raise
    cfg.validate()
    return cfg
