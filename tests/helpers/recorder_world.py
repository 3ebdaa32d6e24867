# SPDX-License-Identifier: Apache-2.0
"""Recorder manager between steps of an environment whose numbers are known."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from stripe_newton.fusion import HostFunction
from stripe_newton.managers.recorder_manager import RecorderManager
from stripe_newton.managers.recorders import ActionStateRecorderManagerCfg
from tests.helpers.manager_world import manager_context, plan, set_reset

ENVS, ACTIONS, JOINTS, BOX = 3, 2, 4, 7
QUAT = [0.1, 0.2, 0.3, 0.927]


def number(env: Any, episode: Any, step: Any) -> Any:
    """Number that identifies a sample."""
    return 100.0 * env + 10.0 * episode + step


class Owner:
    """Stands for an environment: what it hands out follows from environment, episode and step."""

    def __init__(self, num_envs: int, success: list[bool] | None):
        self.env = torch.arange(num_envs, dtype=torch.float32)
        self.episode, self.step = torch.zeros(num_envs), torch.zeros(num_envs)
        self.obs_buf: dict[str, Any] = {}
        self.scene = self.querier = self
        self.spec = SimpleNamespace(id="Toy-v0")
        self._np_random_seed = 42
        self.success = success
        if success is not None:
            self.termination_manager = SimpleNamespace(active_terms=["success"], get_term=self.get_term)

    def get_term(self, name: str) -> torch.Tensor:
        assert name == "success"
        return torch.tensor(self.success)

    @property
    def sample(self) -> torch.Tensor:
        return number(self.env, self.episode, self.step)

    @property
    def actions(self) -> torch.Tensor:
        return self.sample[:, None] + torch.tensor([0.25, 0.5])

    @property
    def processed_actions(self) -> torch.Tensor:
        return self.sample[:, None] * 2.0

    def get_state(self, is_relative: bool) -> dict[str, Any]:
        assert is_relative
        pose = torch.cat((self.sample[:, None].expand(-1, 3), torch.tensor([QUAT]).expand(len(self.env), 4)), dim=1)
        root = {"root_pose": pose, "root_velocity": self.sample[:, None].expand(-1, 6)}
        joints = self.sample[:, None] + torch.arange(JOINTS)
        robot = {**root, "joint_position": joints, "joint_velocity": -joints}
        return {"articulation": {"robot": robot}, "rigid_object": {"box": root}}


class World:
    """Runs a recorder manager through steps as an environment would: an episode of ``env`` has ``lengths[env]``."""

    def __init__(self, cfg: Any, num_envs: int = ENVS, success: list[bool] | None = None, context: Any = None):
        self.context = context = context or manager_context(num_envs, "cartpole")
        self.owner = context.owner = Owner(num_envs, success)
        context.termination_names = ["success"] if success is not None else []
        self.manager = manager = RecorderManager(cfg, context)
        self.items = [
            manager.pre_step_items(),
            manager.post_step_items(),
            manager.pre_reset_items(),
            manager.post_reset_items(),
        ]
        if context.problems:
            return
        advance, restart = HostFunction("physics", self._advance, "test"), HostFunction("reset", self._restart, "test")
        before, after, ended, begun = self.items
        self.step_plan = plan(context, before, [advance], after, ended, [restart], begun)
        self.reset_plan = plan(context, ended, [restart], begun)

    def _advance(self) -> None:
        self.owner.step += 1.0
        if self.lengths is not None:
            set_reset(self.context, self.owner.step >= torch.tensor(self.lengths))

    def _restart(self) -> None:
        mask = self.context.torch(self.context.reset)
        self.owner.episode += mask
        self.owner.step[mask] = 0.0

    def reset(self, mask: list[bool] | None = None) -> None:
        set_reset(self.context, [True] * len(self.owner.env) if mask is None else mask)
        self.reset_plan.run()
        self.owner.obs_buf = {"policy": self.owner.sample[:, None] + 0.125}

    def step(self, count: int = 1, lengths: list[int] | None = None) -> None:
        self.lengths = lengths
        for _ in range(count):
            if lengths is None:
                set_reset(self.context, [False] * len(self.owner.env))
            self.step_plan.run()
            self.owner.obs_buf = {"policy": self.owner.sample[:, None] + 0.125}


def settings(**changes: Any) -> ActionStateRecorderManagerCfg:
    return ActionStateRecorderManagerCfg(dataset_export_dir_path="out", dataset_filename="toy", **changes)


def read(path: str | Path = "out/toy.hdf5") -> dict[str, dict[str, Any]]:
    """Attributes and datasets of each episode, by plain h5py."""
    h5py = pytest.importorskip("h5py")
    episodes: dict[str, dict[str, Any]] = {}
    with h5py.File(path, "r") as file:
        for name, group in file["data"].items():
            datasets: dict[str, Any] = {"attrs": dict(group.attrs)}

            def visit(path: str, item: Any, datasets: dict[str, Any] = datasets) -> None:
                if isinstance(item, h5py.Dataset):
                    datasets[path] = item[()]

            group.visititems(visit)
            episodes[name] = datasets
    return episodes
