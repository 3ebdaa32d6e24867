# SPDX-License-Identifier: Apache-2.0
"""Environment of mjlab's flat velocity task: its Go1 in this package.

All numbers come from the facts that ``compare_mjlab_peer.py describe`` reads from the installed mjlab. The robot is the
MJCF that mjlab writes after it has applied its settings, so gains, limits, armature, friction and contact parameters
are those of mjlab. ``docs/comparison.md`` lists the remaining differences.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import compare_mjlab_terms as terms
import warp as wp

from stripe_kernels.model_data import BodyModelData
from stripe_newton.actuators import ImplicitActuatorCfg
from stripe_newton.assets import ArticulationCfg, AssetBaseCfg
from stripe_newton.configclass import configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.managers.model_data import ModelStructs
from stripe_newton.matching import match_values
from stripe_newton.noise import UniformNoiseCfg
from stripe_newton.rl import RslRlMLPModelCfg, RslRlOnPolicyRunnerCfg, RslRlPpoAlgorithmCfg
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sensors import ContactSensorCfg
from stripe_newton.sim import GroundPlaneCfg, MjcfFileCfg, MuJoCoSolverCfg, RigidBodyMaterialCfg, SimulationCfg

__all__ = ["Go1Env", "make_agent_cfg", "make_env_cfg"]

Json = dict[str, Any]
"""Facts about mjlab's task, requests, and parameters of terms."""
FEET = ("FR", "FL", "RR", "RL")
"""The feet in mjlab's order: sites of that name, on bodies ``*_calf``."""
STDS = ("std_standing", "std_walking", "std_running")


@configclass
class ForwardVelocityCommandCfg(mdp.UniformVelocityCommandCfg):
    """Uniform velocity command, a share of which goes straight ahead."""

    rel_forward_envs: float = 0.0
    """Share of commands that go straight ahead."""
    resample: wp.Function = terms.resample_velocity


class Go1Env(ManagerBasedRLEnv):
    """Environment whose terms may read the centres of mass."""

    def _provide_structs(self) -> None:
        ModelStructs(self.context).get(BodyModelData, "robot", ["com"])


def make_env_cfg(facts: Json, robot_file: Path, request: Json) -> ManagerBasedRLEnvCfg:
    """Config of the environment.

    Args:
        facts: Facts that the peer found.
        robot_file: The robot as mjlab writes it.
        request: ``num_envs``, ``seed``, ``device`` and ``randomize``; without the last there is no noise, no push and
            no randomisation at the start. ``fused`` is that of the solver, by default None.
    """
    task, solver, randomize = facts["env"], facts["env"]["sim"]["mujoco"], request["randomize"]
    fallen = task["terminations"]["fell_over"]["params"]
    groups = {"policy": task["observations"]["actor"], "critic": task["observations"]["critic"]}
    names = ("iterations", "ls_iterations", "tolerance", "ls_tolerance", "ccd_iterations", "solver", "integrator")
    return ManagerBasedRLEnvCfg(
        seed=request["seed"],
        decimation=task["decimation"],
        episode_length_s=task["episode_length_s"],
        scale_rewards_by_dt=task["scale_rewards_by_dt"],
        sim=SimulationCfg(
            dt=solver["timestep"],
            on_overflow="warn",  # as mjlab does
            device=request["device"],
            gravity=tuple(solver["gravity"]),
            physics_material=RigidBodyMaterialCfg(static_friction=1.0, dynamic_friction=1.0),  # MuJoCo's default
            solver=MuJoCoSolverCfg(
                fused=request.get("fused"),
                drive_limits=True,
                **{name: solver[name] for name in (*names, "jacobian", "cone")},
                impratio=float(solver["impratio"]),
                enable_multiccd=facts["multiccd"],
                njmax=facts["room"]["constraints"],
                nconmax=round(facts["room"]["contacts_a_world"]),
            ),
        ),
        scene=_scene(facts, robot_file)(num_envs=request["num_envs"], env_spacing=task["scene"]["env_spacing"]),
        observations={name: _observations(facts, group, randomize) for name, group in groups.items()},
        actions={
            "joint_pos": mdp.JointPositionActionCfg(
                joint_names=facts["joint_names"],
                preserve_order=True,
                scale=facts["action_scale"],
                use_default_offset=True,
                apply=mdp.apply_joint_position_biased,
            )
        },
        commands={"twist": _command(task["commands"]["twist"])},
        rewards=_rewards(facts),
        terminations={
            "time_out": TerminationTermCfg(func=mdp.time_out, time_out=True),
            "fell_over": TerminationTermCfg(func=mdp.bad_orientation, params=fallen),
        },
        events=_events(task["events"], randomize),
    )


def _scene(facts: Json, robot_file: Path) -> type[InteractiveSceneCfg]:
    """Config class of the scene: the robot on a plane, with a contact sensor on its feet."""
    joint_pos = dict(zip(facts["joint_names"], facts["joint_pos"], strict=True))
    start = ArticulationCfg.InitialStateCfg(pos=tuple(facts["root_pos"]), joint_pos=joint_pos)
    drives, dofs = facts["drives"], facts["dofs"]
    # the same numbers as in the file, which has only six digits
    legs = ImplicitActuatorCfg(
        joint_names_expr=[".*"],
        stiffness={joint: -numbers[0] for joint, numbers in drives.items()},
        damping={joint: -numbers[1] for joint, numbers in drives.items()},
        effort_limit_sim={joint: numbers[3] for joint, numbers in drives.items()},
        armature={joint: numbers[0] for joint, numbers in dofs.items()},
    )
    plane = GroundPlaneCfg(physics_material=RigidBodyMaterialCfg(static_friction=1.0, dynamic_friction=1.0))

    @configclass
    class SceneCfg(InteractiveSceneCfg):
        """The robot on a plane."""

        ground: AssetBaseCfg = AssetBaseCfg(prim_path="/World/ground", spawn=plane)
        robot: ArticulationCfg = ArticulationCfg(
            prim_path="{ENV_REGEX_NS}/Robot",
            spawn=MjcfFileCfg(asset_path=str(robot_file)),
            init_state=start,
            soft_joint_pos_limit_factor=facts["soft_limit_factor"],
            actuators={"legs": legs},
        )
        feet: ContactSensorCfg = ContactSensorCfg(
            prim_path="{ENV_REGEX_NS}/Robot/.*_calf", track_air_time=True, force_threshold=0.0, substeps=True
        )

    return SceneCfg


def _feet(facts: Json, *parts: str) -> Json:
    """Parameters of terms about the feet, by short names."""
    bodies = [f"{foot}_calf" for foot in FEET]
    params = {
        "sensor": ("sensor_cfg", SceneEntityCfg("feet", body_names=bodies, preserve_order=True)),
        "asset": ("asset_cfg", SceneEntityCfg("robot", body_names=bodies, preserve_order=True)),
        "points": ("points", [facts["sites"][foot] for foot in FEET]),
        "command": ("command_name", "twist"),
        "model": ("model", "robot"),
    }
    return dict(params[part] for part in parts)


def _observations(facts: Json, group: Json, randomize: bool) -> ObservationGroupCfg:
    """Observation group with the terms of mjlab's group, in its order."""
    order = {"asset_cfg": SceneEntityCfg("robot", joint_names=facts["joint_names"], preserve_order=True)}
    known: dict[str, tuple[wp.Function, Json, int | None]] = {
        "base_lin_vel": (terms.point_lin_vel, {"point": tuple(facts["sites"]["imu"])}, 3),
        "base_ang_vel": (mdp.base_ang_vel, {}, None),
        "projected_gravity": (mdp.projected_gravity, {}, None),
        "joint_pos": (mdp.joint_pos_rel, order, None),
        "joint_pos_biased": (mdp.joint_pos_rel_biased, order, None),
        "joint_vel": (mdp.joint_vel_rel, order, None),
        "actions": (mdp.last_action, {}, None),
        "command": (mdp.generated_commands, {"command_name": "twist"}, None),
        "foot_height": (terms.foot_height, _feet(facts, "asset", "points"), len(FEET)),
        "foot_air_time": (mdp.feet_current_air_time, _feet(facts, "sensor"), None),
        "foot_contact": (mdp.feet_contact, _feet(facts, "sensor"), None),
        "foot_contact_forces": (mdp.feet_contact_forces, _feet(facts, "sensor"), None),
    }
    found: Json = {}
    for name, term in group["terms"].items():
        kind = f"{name}_biased" if term["params"].get("biased") else name
        function, params, size = known[kind]
        noise = term["noise"]
        noise = UniformNoiseCfg(n_min=noise["n_min"], n_max=noise["n_max"]) if noise else None
        scale = -1.0 if name == "foot_contact_forces" else None  # mjlab's are forces of the foot on the ground
        found[name] = ObservationTermCfg(func=function, params=params, size=size, scale=scale, noise=noise)
    fields = {"__annotations__": dict.fromkeys(found, ObservationTermCfg), **found, "__doc__": "A group of mjlab's."}
    corrupt = group["enable_corruption"] and randomize
    return configclass(type("GroupCfg", (ObservationGroupCfg,), fields))(enable_corruption=corrupt)


def _command(term: Json) -> ForwardVelocityCommandCfg:
    """Velocity command with mjlab's ranges and shares."""
    bounds = {name: tuple(pair) for name, pair in term["ranges"].items()}
    shares = {name: term[name] for name in term if name.startswith(("heading_", "rel_")) and name != "rel_world_envs"}
    ranges = mdp.UniformVelocityCommandCfg.Ranges(**bounds)
    return ForwardVelocityCommandCfg(
        resampling_time_range=tuple(term["resampling_time_range"]), ranges=ranges, **shares
    )


def _rewards(facts: Json) -> dict[str, RewardTermCfg]:
    """Reward terms whose weight is not zero."""
    pose = facts["env"]["rewards"]["pose"]["params"]
    order = SceneEntityCfg("robot", joint_names=facts["joint_names"], preserve_order=True)
    by_joint = {name: match_values(pose[name], facts["joint_names"], what="joint") for name in STDS}
    spreads = {name: [values[i] for i in sorted(values)] for name, values in by_joint.items()}
    all_feet = _feet(facts, "sensor", "asset", "points", "command")
    known: dict[str, tuple[wp.Function, Json]] = {
        "track_linear_velocity": (terms.track_linear_velocity, {"command_name": "twist", "model": "robot"}),
        "track_angular_velocity": (terms.track_angular_velocity, {"command_name": "twist"}),
        "upright": (terms.upright, {}),
        "pose": (terms.variable_posture, {"command_name": "twist", "asset_cfg": order, **spreads}),
        "dof_pos_limits": (mdp.joint_pos_limits, {}),
        "action_rate_l2": (mdp.action_rate_l2, {}),
        "foot_clearance": (terms.feet_clearance, _feet(facts, "asset", "points", "command", "model")),
        "foot_swing_height": (terms.feet_swing_height, all_feet),
        "foot_slip": (terms.feet_slip, {**all_feet, "model": "robot"}),
        "soft_landing": (mdp.soft_landing, _feet(facts, "sensor", "command")),
    }
    found = {}
    for name, term in facts["env"]["rewards"].items():
        if term["weight"]:
            function, params = known[name]
            numbers = {k: v for k, v in term["params"].items() if isinstance(v, (int, float))}
            found[name] = RewardTermCfg(func=function, weight=term["weight"], params={**numbers, **params})
    return found


def _events(events: Json, randomize: bool) -> dict[str, EventTermCfg]:
    """Resets, and with ``randomize`` pushes and randomisation."""
    start, joints = events["reset_base"]["params"], events["reset_robot_joints"]["params"]
    found = {
        "reset_base": EventTermCfg(
            func=mdp.reset_root_state_uniform,
            mode="reset",
            params={"pose_range": start["pose_range"], "velocity_range": start["velocity_range"]},
        ),
        "reset_robot_joints": EventTermCfg(
            func=mdp.reset_joints_by_offset,
            mode="reset",
            params={name: tuple(joints[name]) for name in ("position_range", "velocity_range")},
        ),
    }
    if randomize:
        com = {axis: tuple(events["base_com"]["params"]["ranges"][str(k)]) for k, axis in enumerate("xyz")}
        push, bias = events["push_robot"], events["encoder_bias"]["params"]["bias_range"]
        friction = {n: events[f"foot_friction_{n}"]["params"] for n in ("slide", "spin", "roll")}
        found |= {
            "push_robot": EventTermCfg(
                func=mdp.push_by_setting_velocity,
                mode="interval",
                interval_range_s=tuple(push["interval_range_s"]),
                params=push["params"],
            ),
            "base_com": EventTermCfg(
                func=mdp.randomize_rigid_body_com,
                mode="startup",
                params={"asset_cfg": SceneEntityCfg("robot", body_names="trunk"), "com_range": com},
            ),
            "encoder_bias": EventTermCfg(
                func=mdp.randomize_encoder_bias, mode="startup", params={"bias_range": tuple(bias)}
            ),
            "foot_friction": EventTermCfg(
                func=terms.randomize_feet,
                mode="startup",
                params={
                    "asset_cfg": SceneEntityCfg("robot", body_names=".*_calf"),
                    "shape_names": friction["slide"]["asset_cfg"]["geom_names"],
                    **{name: tuple(params["ranges"]) for name, params in friction.items()},
                },
            ),
        }
    return found


def make_agent_cfg(facts: Json, request: Json) -> RslRlOnPolicyRunnerCfg:
    """Networks and PPO settings of mjlab's task."""
    agent = facts["agent"]
    names = ("hidden_dims", "activation", "obs_normalization")
    networks = {which: {name: agent[which][name] for name in names} for which in ("actor", "critic")}
    gaussian = RslRlMLPModelCfg.GaussianDistributionCfg(**agent["actor"]["distribution_cfg"])
    fields = RslRlPpoAlgorithmCfg.__dataclass_fields__
    return RslRlOnPolicyRunnerCfg(
        seed=request["seed"],
        num_steps_per_env=agent["num_steps_per_env"],
        save_interval=10**9,
        obs_groups={"actor": ["policy"], "critic": ["critic"]},
        clip_actions=agent["clip_actions"],
        actor=RslRlMLPModelCfg(distribution_cfg=gaussian, **networks["actor"]),
        critic=RslRlMLPModelCfg(**networks["critic"]),
        algorithm=RslRlPpoAlgorithmCfg(**{k: v for k, v in agent["algorithm"].items() if k in fields}),
    )
