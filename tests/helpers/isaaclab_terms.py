# SPDX-License-Identifier: Apache-2.0
"""Terms of ``isaaclab.envs.mdp`` with parameters, and an environment in which they and Isaac Lab's own have values.

``applied_torque_limits`` and ``joint_effort_out_of_limit`` are not among them: theirs is the law before the step.
"""

from __future__ import annotations

import importlib.util
from functools import cached_property
from pathlib import Path
from types import ModuleType
from typing import Any

import torch

from stripe_newton.managers import RewardTermCfg
from tests.helpers.isaaclab_source import isaaclab_source

__all__ = ["TERMS", "Bench"]

KNEES, SHINS = {"joint_names": ".*_knee"}, {"body_names": ".*_shin"}
OBSERVATIONS = {
    "base_pos_z": {},
    "base_lin_vel": {},
    "base_ang_vel": {},
    "projected_gravity": {},
    "root_pos_w": {},
    "root_quat_w": {"make_quat_unique": True},
    "root_lin_vel_w": {},
    "root_ang_vel_w": {},
    "body_pose_w": {"asset_cfg": SHINS},
    "body_projected_gravity_b": {"asset_cfg": SHINS},
    "joint_pos": {"asset_cfg": KNEES},
    "joint_pos_rel": {"asset_cfg": KNEES},
    "joint_pos_limit_normalized": {},
    "joint_vel": {},
    "joint_vel_rel": {"asset_cfg": KNEES},
    "joint_effort": {},
    "height_scan": {"sensor_cfg": {"name": "scanner"}, "offset": 0.3},
    "imu_orientation": {"asset_cfg": {"name": "imu"}},
    "imu_ang_vel": {"asset_cfg": {"name": "imu"}},
    "imu_lin_acc": {"asset_cfg": {"name": "imu"}},
    "imu_projected_gravity": {"asset_cfg": {"name": "imu"}},
    "last_action": {},
    "generated_commands": {"command_name": "pose"},
    "current_time_s": {},
    "remaining_time_s": {},
}
REWARDS = {
    "is_alive": {},
    "is_terminated": {},
    "is_terminated_term": {"term_keys": "fell"},
    "lin_vel_z_l2": {},
    "ang_vel_xy_l2": {},
    "flat_orientation_l2": {},
    "base_height_l2": {"target_height": 0.4},
    "body_lin_acc_l2": {"asset_cfg": SHINS},
    "joint_torques_l2": {},
    "joint_vel_l1": {"asset_cfg": KNEES},
    "joint_vel_l2": {},
    "joint_acc_l2": {},
    "joint_deviation_l1": {"asset_cfg": KNEES},
    "joint_pos_limits": {},
    "joint_vel_limits": {"soft_ratio": 0.3},
    "action_rate_l2": {},
    "action_l2": {},
    "undesired_contacts": {"threshold": 5.0, "sensor_cfg": {"name": "contacts", **SHINS}},
    "desired_contacts": {"sensor_cfg": {"name": "contacts", **SHINS}},
    "contact_forces": {"threshold": 5.0, "sensor_cfg": {"name": "contacts", **SHINS}},
    "track_lin_vel_xy_exp": {"std": 0.7, "command_name": "velocity"},
    "track_ang_vel_z_exp": {"std": 0.7, "command_name": "velocity"},
}
TERMINATIONS = {
    "time_out": {},
    "command_resample": {"command_name": "velocity"},
    "bad_orientation": {"limit_angle": 1.0},
    "root_height_below_minimum": {"minimum_height": 0.1},
    "joint_pos_out_of_limit": {},
    "joint_pos_out_of_manual_limit": {"bounds": (-0.5, 0.7)},
    "joint_vel_out_of_limit": {},
    "joint_vel_out_of_manual_limit": {"max_velocity": 6.0},
    "illegal_contact": {"threshold": 2.0, "sensor_cfg": {"name": "contacts", **SHINS}},
}
TERMS = {f"{part}.{name}": params for part, every in (
    ("observations", OBSERVATIONS), ("rewards", REWARDS), ("terminations", TERMINATIONS)
) for name, params in every.items()}  # fmt: skip


class Bench:
    """The walker's environment, the dialect's terms, and Isaac Lab's files of terms, loaded under the dialect.

    Attributes:
        env: The environment.
        ours: The dialect's terms.
    """

    def __init__(self, task: ModuleType):
        cfg = task.WalkerEnvCfg()
        cfg.rewards.shakes = task.RewTerm(func=task.mdp.body_lin_acc_l2, weight=-1e-6)
        self.env = task.ManagerBasedRLEnv(cfg)
        self.env.reset(seed=1)
        self.ours = task.mdp
        self._entity = task.SceneEntityCfg

    @cached_property
    def theirs(self) -> dict[str, ModuleType]:
        """Isaac Lab's files of terms; skips the test where there are none."""
        folder = isaaclab_source() / "isaaclab/isaaclab/envs/mdp"
        return {part: self._load(folder / f"{part}.py") for part in ("observations", "rewards", "terminations")}

    @staticmethod
    def _load(path: Path) -> ModuleType:
        spec = importlib.util.spec_from_file_location(f"theirs_{path.stem}", path)
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    def params(self, given: dict[str, Any]) -> dict[str, Any]:
        """Parameters with entities that are resolved, as a manager hands them to a torch term."""
        made = {}
        for key, value in given.items():
            if key.endswith("_cfg"):
                value = self._entity(**{"name": "robot", **value})
                value.resolve(self.env.scene)
            made[key] = value
        return made

    def value_of(self, term: str) -> torch.Tensor:
        """Value of a term of the dialect in the present state."""
        return getattr(self.ours, term.split(".")[1])(self.env, **self.params(TERMS[term]))

    def value_of_isaac_lab(self, term: str) -> torch.Tensor:
        """Value of Isaac Lab's own term."""
        (part, name), params = term.split("."), self.params(TERMS[term])
        function = getattr(self.theirs[part], name)
        if isinstance(function, type):  # a class term
            function = function(RewardTermCfg(func=function, weight=1.0, params=params), self.env)
        return function(self.env, **params)
