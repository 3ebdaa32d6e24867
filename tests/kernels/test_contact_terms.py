# SPDX-License-Identifier: Apache-2.0
"""Contact and IMU terms, against float64 references on random states, and in an environment."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.mdp import contact, feet, imu
from stripe_kernels.sensors.contact import ContactSensorData
from stripe_kernels.sensors.imu import ImuData
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    ObservationGroupCfg,
    ObservationTermCfg,
    RewardTermCfg,
    SceneEntityCfg,
    TerminationTermCfg,
)
from stripe_newton.sensors import ContactSensorCfg, ImuCfg
from stripe_newton.sim import MuJoCoSolverCfg, SimulationCfg
from stripe_tasks.robot_scene import RobotSceneCfg
from stripe_tasks.robots import QUADRUPED_CFG
from tests.helpers import term_kernels as tk
from tests.helpers.small_scenes import numpy
from tests.helpers.term_launch import close, rounded

NUM_ENVS, BODIES, HISTORY = 64, 6, 3
STEP_DT, DT = 0.02, 0.005
STRUCTS = {"ContactSensorData": ContactSensorData, "ImuData": ImuData}
PARAMS: dict[str, Any] = {
    "threshold": 20.0,
    "step_dt": STEP_DT,
    "command_threshold": 0.5,
    "target_height": 0.3,
    "sensor_body_ids": [4, 0, 3],
    "body_ids": [1, 4, 2],
}
TIMED = {"threshold": 0.12}
CASES: dict[str, list[dict[str, Any]]] = {
    "undesired_contacts": [{}, {"body_ids": [5]}, {"body_ids": []}],
    "desired_contacts": [{"threshold": 45.0}, {"threshold": 1000.0}],
    "illegal_contact": [{"threshold": 45.0}, {"body_ids": []}],
    "feet_air_time": [TIMED, TIMED | {"command_threshold": 0.0}],
    "feet_air_time_positive_biped": [TIMED, TIMED | {"body_ids": [0, 3]}],
}


def terms() -> dict[str, Any]:
    return {n: getattr(m, n) for m in (contact, feet, imu) for n in m.__all__ if isinstance(getattr(m, n), wp.Function)}


ALL_CASES = [(name, case) for name in terms() for case in CASES.get(name, [{}])]


def values() -> dict[str, dict[str, Any]]:
    """Random states; some bodies touch nothing, times are whole physics steps and every edge of a step is there."""
    v, rng, shape = tk.random_values(NUM_ENVS), np.random.default_rng(4), (NUM_ENVS, BODIES)
    history = 25.0 * rng.normal(size=(NUM_ENVS, HISTORY, BODIES, 3)) * (rng.random((NUM_ENVS, 1, BODIES, 1)) < 0.6)
    touches = np.linalg.norm(history[:, 0], axis=-1) > 1.0
    ticks = DT * rng.integers(1, 9, shape)
    v["ContactSensorData"] = {
        "net_forces_w": history[:, 0],
        "net_forces_w_history": history,
        "force_matrix_w": np.zeros((NUM_ENVS, BODIES, 1, 3)),
        "current_contact_time": np.where(touches, ticks, 0.0),
        "current_air_time": np.where(touches, 0.0, ticks),
        "last_air_time": np.where(rng.random(shape) < 0.8, DT * rng.integers(1, 60, shape), 0.0),
        "last_contact_time": DT * rng.integers(0, 60, shape),
        "force_threshold": 1.0,
        "measurement_dt": DT,
    }
    v["ImuData"] = {n: rng.normal(size=(NUM_ENVS, 4 if n == "quat_w" else 3)) for n in ImuData.vars}
    return rounded(v)


# -- references


def largest(v: dict[str, Any], ids: list[int]) -> np.ndarray:
    return np.linalg.norm(v["ContactSensorData"]["net_forces_w_history"], axis=-1).max(axis=1)[:, ids]


def times(v: dict[str, Any], name: str, ids: list[int]) -> np.ndarray:
    return v["ContactSensorData"][name][:, ids]


def landed(v: dict[str, Any], ids: list[int]) -> np.ndarray:
    ticks = np.round(times(v, "current_contact_time", ids) / DT)
    return (ticks > 0) & (ticks <= 4)


def told(v: dict[str, Any], p: dict[str, Any], yaw: bool) -> np.ndarray:
    c = v["VelocityCommandData"]["command"]
    return np.linalg.norm(c[:, :2], axis=1) + yaw * np.abs(c[:, 2]) > p["command_threshold"]


def speed(v: dict[str, Any], p: dict[str, Any]) -> np.ndarray:
    return np.linalg.norm(v["ArticulationData"]["body_vel"][:, p["body_ids"], :2], axis=-1)


def height(v: dict[str, Any], p: dict[str, Any]) -> np.ndarray:
    r = v["ArticulationData"]
    return r["body_pose"][:, p["body_ids"], 2] - r["env_origin"][:, None, 2]


def biped(v: dict[str, Any], p: dict[str, Any]) -> np.ndarray:
    ids = p["body_ids"]
    on, off = times(v, "current_contact_time", ids), times(v, "current_air_time", ids)
    stance = ((on > 0.0).sum(axis=1) == 1)[:, None]
    least = np.where(stance, np.where(on > 0.0, on, off), 0.0).min(axis=1)
    return np.minimum(least, p["threshold"]) * told(v, p, yaw=False)


def swing(v: dict[str, Any], p: dict[str, Any]) -> np.ndarray:
    came = landed(v, p["sensor_body_ids"]) & (times(v, "last_air_time", p["sensor_body_ids"]) > 0.0)
    return (((p["peak"] / p["target_height"] - 1.0) ** 2) * came).sum(axis=1) * told(v, p, yaw=True)


def slip(v: dict[str, Any], p: dict[str, Any]) -> np.ndarray:
    forces = np.linalg.norm(v["ContactSensorData"]["net_forces_w"], axis=-1)[:, p["sensor_body_ids"]]
    return ((forces > 1.0) * speed(v, p) ** 2).sum(axis=1) * told(v, p, yaw=True)


def forces_log(v: dict[str, Any], p: dict[str, Any]) -> np.ndarray:
    f = v["ContactSensorData"]["net_forces_w"][:, p["body_ids"]]
    return (np.sign(f) * np.log1p(np.abs(f))).reshape(NUM_ENVS, -1)


REFERENCES: dict[str, Any] = {
    "undesired_contacts": lambda v, p: (largest(v, p["body_ids"]) > p["threshold"]).sum(axis=1),
    "desired_contacts": lambda v, p: (largest(v, p["body_ids"]) <= p["threshold"]).all(axis=1),
    "contact_forces": lambda v, p: np.maximum(largest(v, p["body_ids"]) - p["threshold"], 0.0).sum(axis=1),
    "illegal_contact": lambda v, p: (largest(v, p["body_ids"]) > p["threshold"]).any(axis=1),
    "feet_air_time": lambda v, p: (
        ((times(v, "last_air_time", p["body_ids"]) - p["threshold"]) * landed(v, p["body_ids"])).sum(axis=1)
        * told(v, p, yaw=False)
    ),
    "feet_air_time_positive_biped": biped,
    "feet_slide": lambda v, p: ((largest(v, p["sensor_body_ids"]) > p["threshold"]) * speed(v, p)).sum(axis=1),
    "feet_slip": slip,
    "feet_clearance": lambda v, p: (
        (np.abs(height(v, p) - p["target_height"]) * speed(v, p)).sum(axis=1) * told(v, p, yaw=True)
    ),
    "feet_swing_height": swing,
    "soft_landing": lambda v, p: (
        (largest(v, p["body_ids"]) * landed(v, p["body_ids"])).sum(axis=1) * told(v, p, yaw=True)
    ),
    "feet_contact": lambda v, p: (
        np.linalg.norm(v["ContactSensorData"]["net_forces_w"], axis=-1)[:, p["body_ids"]] > 1.0
    ).astype(float),
    "feet_contact_forces": forces_log,
    "feet_current_air_time": lambda v, p: times(v, "current_air_time", p["body_ids"]),
    "imu_ang_vel": lambda v, p: v["ImuData"]["ang_vel_b"],
    "imu_lin_acc": lambda v, p: v["ImuData"]["lin_acc_b"],
    "imu_orientation": lambda v, p: v["ImuData"]["quat_w"],
    "imu_projected_gravity": lambda v, p: v["ImuData"]["projected_gravity_b"],
}


# -- one kernel for each term


def source(name: str) -> str:
    types = dict(terms()[name].func.__annotations__)
    returns = types.pop("return", None)
    types.pop("env")

    def kind(arg: str, annotation: Any) -> str:
        struct = getattr(getattr(annotation, "cls", None), "__name__", "")
        if struct in STRUCTS:
            return f"{'imu' if struct == 'ImuData' else 'contact'}.{struct}"
        return "wp.array2d[float]" if arg in ("out", "peak") else tk.type_name(annotation)

    parameters = [f"{a}: {kind(a, t)}" for a, t in types.items()]
    call = f"mdp.{name}({', '.join(['env', *('out[env]' if a == 'out' else a for a in types)])})"
    if returns is not None:
        parameters.append(f"result: wp.array[{'wp.bool' if returns is bool else 'float'}]")
        call = f"result[env] = {call}"
    head = f"@wp.kernel(enable_backward=False)\ndef {name}({', '.join(parameters)}):\n"
    return f"{head}    env = wp.tid()\n    {call}\n\n\n"


@cache
def kernels() -> Any:
    head = (
        "import warp as wp\nfrom stripe_kernels import data, mdp\nfrom stripe_kernels.sensors import contact, imu\n\n\n"
    )
    return tk.import_source("term_kernels_contact", head + "".join(map(source, terms())), Path(mkdtemp()))


def struct_of(name: str, fields: dict[str, Any], device: str) -> Any:
    if name not in STRUCTS:
        return tk.build_struct(name, fields, device)
    instance = STRUCTS[name]()
    for field, value in fields.items():
        dtype = getattr(STRUCTS[name].vars[field].type, "dtype", None)
        array = value if dtype is None else wp.array(np.ascontiguousarray(value), dtype=dtype, device=device)
        setattr(instance, field, array)
    return instance


def launch(name: str, v: dict[str, Any], p: dict[str, Any], device: str) -> tuple[np.ndarray, dict[str, Any]]:
    """Result of a term, returned or written to ``out``, and its arguments."""
    types, arguments = dict(terms()[name].func.__annotations__), {}
    returns = types.pop("return", None)
    types.pop("env")
    for arg, kind in types.items():
        if getattr(kind, "cls", None) is not None:
            arguments[arg] = struct_of(kind.cls.__name__, v[kind.cls.__name__], device)
        elif hasattr(kind, "ndim"):
            arguments[arg] = wp.array(np.asarray(p[arg]), dtype=kind.dtype, device=device)
        else:
            arguments[arg] = kind(p[arg])
    if returns is not None:
        arguments["result"] = wp.zeros(NUM_ENVS, dtype=wp.bool if returns is bool else returns, device=device)
    wp.launch(getattr(kernels(), name), dim=NUM_ENVS, inputs=list(arguments.values()), device=device)
    return arguments["result" if returns is not None else "out"].numpy(), arguments


def params(case: dict[str, Any], name: str) -> dict[str, Any]:
    p = rounded(PARAMS | case)
    p["peak"] = rounded(np.random.default_rng(6).uniform(0.0, 0.5, (NUM_ENVS, len(p["sensor_body_ids"]))))
    function = terms()[name]
    if "out" in function.func.__annotations__:
        p["out"] = np.full((NUM_ENVS, tk.size_of(function, {"body_ids": len(p["body_ids"])})), np.nan)
    return p


@pytest.mark.parametrize(("name", "case"), ALL_CASES, ids=[f"{n}-{list(c)}" for n, c in ALL_CASES])
def test_term(name, case, device):
    v, p = values(), params(case, name)
    expected = np.asarray(REFERENCES[name](v, p))
    if name != "illegal_contact":
        expected = expected.astype(float)
    actual, arguments = launch(name, v, p, device)
    assert actual.shape == expected.shape
    close(actual, expected, name)
    if p["body_ids"]:
        assert np.unique(actual).size > 1 or case.get("threshold") == 1000.0  # it says something
    if name == "feet_swing_height":
        ids, h, peak = p["sensor_body_ids"], height(v, p), p["peak"]
        on, ticks = times(v, "current_contact_time", ids) > 0.0, np.round(times(v, "current_air_time", ids) / DT)
        kept = np.where(on | (ticks <= 4), h, np.maximum(h, peak))
        np.testing.assert_allclose(arguments["peak"].numpy(), kept, rtol=1e-5, atol=1e-6)


def test_every_term_is_public_and_has_a_reference():
    assert set(REFERENCES) == set(terms())
    assert set(terms()) <= set(mdp.__all__)


# -- in an environment


@configclass
class SceneCfg(RobotSceneCfg):
    contact_forces: ContactSensorCfg = ContactSensorCfg(
        prim_path="{ENV_REGEX_NS}/Robot/.*", history_length=4, track_air_time=True, update_period=DT
    )
    imu: ImuCfg = ImuCfg(prim_path="{ENV_REGEX_NS}/Robot/base/imu")


FEET = SceneEntityCfg("contact_forces", body_names=".*_foot")
FOOT_BODIES = SceneEntityCfg("robot", body_names=".*_foot")
TRUNK = SceneEntityCfg("contact_forces", body_names="base")
WALK = {"command_name": "base_velocity", "command_threshold": -1.0}


def group(**found: Any) -> ObservationGroupCfg:
    made: ObservationGroupCfg = configclass(type("Group", (ObservationGroupCfg,), found))()
    return made


def make_env(
    height: float = 0.34,
    num_envs: int = 2,
    track: bool = True,
    device: str = "cpu",
    period: float = 0.0,
    **rewards: Any,
) -> ManagerBasedRLEnv:
    state = QUADRUPED_CFG.init_state.replace(pos=(0.0, 0.0, height))
    robot = QUADRUPED_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot", init_state=state)
    cfg: Any = ManagerBasedRLEnvCfg(
        decimation=4,
        episode_length_s=10.0,
        seed=1,
        scale_rewards_by_dt=False,
        sim=SimulationCfg(dt=DT, device=device, solver=MuJoCoSolverCfg(njmax=150, nconmax=40, iterations=10)),
        scene=SceneCfg(num_envs=num_envs, env_spacing=3.0, robot=robot),
    )
    cfg.scene.contact_forces.track_air_time = track
    if period:
        cfg.scene.contact_forces.update_period, cfg.scene.contact_forces.history_length = period, 0
    still = mdp.UniformVelocityCommandCfg.Ranges(lin_vel_x=(0.0, 0.0), lin_vel_y=(0.0, 0.0), ang_vel_z=(0.0, 0.0))
    cfg.commands = {
        "base_velocity": mdp.UniformVelocityCommandCfg(
            asset_name="robot", resampling_time_range=(10.0, 10.0), heading_command=False, ranges=still
        )
    }
    cfg.actions = {"legs": mdp.JointPositionActionCfg(asset_name="robot", joint_names=[".*"])}
    sensor = {"sensor_cfg": FEET}
    cfg.observations = {
        "policy": group(
            contact=ObservationTermCfg(func=mdp.feet_contact, params=sensor),
            air=ObservationTermCfg(func=mdp.feet_current_air_time, params=sensor),
        ),
        "imu": group(
            acc=ObservationTermCfg(func=mdp.imu_lin_acc),
            spin=ObservationTermCfg(func=mdp.imu_ang_vel, params={"asset_cfg": SceneEntityCfg("imu")}),
            turn=ObservationTermCfg(func=mdp.imu_orientation, params={"sensor_cfg": SceneEntityCfg("imu")}),
        ),
    }
    cfg.rewards = {n: RewardTermCfg(func=getattr(mdp, n), weight=1.0, params=p) for n, p in rewards.items()}
    cfg.terminations = {
        "time_out": TerminationTermCfg(func=mdp.time_out, time_out=True),
        "trunk": TerminationTermCfg(func=mdp.illegal_contact, params={"sensor_cfg": TRUNK, "threshold": 1.0}),
    }
    return ManagerBasedRLEnv(cfg)


def test_a_robot_that_is_dropped_and_lands():
    """Times, rewards and observations are those that the forces of all physics steps say."""
    env = make_env(
        height=0.5,
        feet_air_time={"sensor_cfg": FEET, **WALK, "threshold": 0.1},
        feet_swing_height={"sensor_cfg": FEET, "asset_cfg": FOOT_BODIES, **WALK, "target_height": 0.2},
        feet_slide={"sensor_cfg": FEET, "asset_cfg": FOOT_BODIES},
    )
    env.reset(seed=0)
    sensor, robot = env.scene.sensors["contact_forces"], env.scene["robot"].data
    feet_of_sensor, feet_of_robot = sensor.find_bodies(".*_foot")[0], env.scene["robot"].find_bodies(".*_foot")[0]
    air = np.zeros((2, 4))
    peak = np.zeros((2, 4))
    landings = 0
    for _ in range(20):
        obs, reward, _, _, _ = env.step(torch.zeros(2, 12))
        forces = sensor.data.net_forces_w_history[:, :, feet_of_sensor].norm(dim=-1).numpy()
        expected, first = np.zeros(2), np.zeros((2, 4), dtype=bool)
        last = air.copy()
        for k in (3, 2, 1, 0):  # the oldest first
            touches = forces[:, k] > 1.0
            came = touches & (air > 0.0)
            first |= came
            last = np.where(came, air + DT, last)
            air = np.where(touches, 0.0, air + DT)
        stays = first & (forces[:, 0] > 1.0)
        landings += int(stays.sum())
        expected += ((last - 0.1) * stays).sum(axis=1)
        z = robot.body_pos_w[:, feet_of_robot, 2].numpy()
        error = np.where(stays, (peak / 0.2 - 1.0) ** 2, 0.0).sum(axis=1)
        peak = np.where(air > 0.0, np.where(air < STEP_DT + 0.5 * DT, z, np.maximum(peak, z)), z)
        slide = robot.body_lin_vel_w[:, feet_of_robot, :2].norm(dim=-1).numpy() * (forces.max(axis=1) > 1.0)
        total = expected + error + slide.sum(axis=1)
        np.testing.assert_allclose(reward.numpy(), total, rtol=1e-4, atol=1e-5)
        np.testing.assert_allclose(obs["policy"][:, :4].numpy(), forces[:, 0] > 1.0)
        np.testing.assert_allclose(obs["policy"][:, 4:].numpy(), air, rtol=1e-5, atol=1e-6)
    assert landings >= 8  # each foot of both
    env.close()


def test_the_robot_stands_on_its_feet_and_may_not_lie_on_its_trunk(device):
    env = make_env(device=device)
    env.reset(seed=0)
    sensor, robot, still = env.scene.sensors["contact_forces"], env.scene["robot"], torch.zeros(2, 12, device=device)
    for _ in range(80):
        obs, _, terminated, _, _ = env.step(still)
        assert not terminated.any()
    weight = float(robot.data.body_mass[0].sum()) * 9.81
    feet_ids = sensor.find_bodies(".*_foot")[0]
    np.testing.assert_allclose(numpy(sensor.data.net_forces_w[:, feet_ids, 2].sum(dim=1)), weight, rtol=0.02)
    assert obs["policy"][:, :4].all()
    np.testing.assert_allclose(numpy(obs["imu"][:, :3].norm(dim=1)), 9.81, atol=0.5)
    pose = robot.data.root_pose_w.clone()
    pose[1, 2:] = torch.tensor([0.25, 1.0, 0.0, 0.0, 0.0])  # the second one falls on its back
    robot.write_root_pose_to_sim(pose[1:], env_ids=torch.tensor([1], device=device))
    ended = []
    for _ in range(20):
        obs, _, terminated, _, _ = env.step(still)
        ended.append(terminated.tolist())
        if terminated[1]:
            break
    assert ended[-1] == [False, True]
    assert not sensor.data.net_forces_w_history[1].any()  # its episode began anew
    assert sensor.data.current_contact_time[0].any()
    assert not obs["policy"][1].any()
    np.testing.assert_allclose(numpy(obs["imu"][1]), [0, 0, 9.81, 0, 0, 0, 0, 0, 0, 1], atol=1e-4)
    assert "contact_forces" in env.describe()
    env.close()


def test_a_state_brings_the_sensors_back():
    env = make_env(height=0.45)
    env.reset(seed=0)
    action = torch.zeros(2, 12)
    for _ in range(5):
        env.step(action)
    state = env.get_state()
    first = [env.step(action)[0] for _ in range(10)]
    env.set_state(state)
    again = [env.step(action)[0] for _ in range(10)]
    for one, two in zip(first, again, strict=True):
        assert all(torch.equal(one[name], two[name]) for name in one)
    env.close()


LEGS = SceneEntityCfg("contact_forces", joint_names=".*")
BACK_FIRST = SceneEntityCfg("contact_forces", body_names=["RL_foot", "FL_foot"], preserve_order=True)


@pytest.mark.parametrize(
    ("rewards", "track", "message"),
    [
        (
            {"feet_slide": {"sensor_cfg": FEET, "asset_cfg": SceneEntityCfg("robot")}},
            True,
            "sensor_cfg names 4 bodies, asset_cfg 17; they must be the same",
        ),
        ({"feet_slide": {"sensor_cfg": SceneEntityCfg("contact_forces", body_names="tail")}}, True, "tail"),
        (
            {"feet_slide": {"sensor_cfg": BACK_FIRST, "asset_cfg": SceneEntityCfg("robot", body_names=".L_foot")}},
            True,
            "sensor_cfg names RL_foot, FL_foot, asset_cfg FL_foot, RL_foot; set preserve_order in both",
        ),
        (
            {
                "undesired_contacts": {
                    "sensor_cfg": SceneEntityCfg("contact_forces", joint_names=".*"),
                    "threshold": 1.0,
                }
            },
            True,
            "is about bodies of 'contact_forces', choose by body_names, not joint_names",
        ),
        (
            {"joint_torques_l2": {"asset_cfg": SceneEntityCfg("robot", body_names=".*_thigh")}},
            True,
            "is about joints of 'robot', choose by joint_names, not body_names",
        ),
        ({"undesired_contacts": {"sensor_cfg": SceneEntityCfg("imu"), "threshold": 1.0}}, True, "ContactSensorData"),
        (
            {"feet_air_time": {"sensor_cfg": FEET, **WALK, "threshold": 0.1}},
            False,
            "'current_contact_time' of 'contact_forces': not kept; set track_air_time=True",
        ),
    ],
)
def test_wrong_sensors_are_named(rewards, track, message):
    with pytest.raises(ConfigError) as error:
        make_env(num_envs=1, track=track, **rewards)
    assert message in str(error.value)


@pytest.mark.parametrize("name", ["feet_air_time", "soft_landing", "feet_swing_height"])
def test_landings_need_a_measurement_in_each_step(name):
    params = {
        "feet_air_time": {"threshold": 0.1},
        "soft_landing": {},
        "feet_swing_height": {"asset_cfg": SceneEntityCfg("robot", body_names=".*_foot"), "target_height": 0.1},
    }[name]
    with pytest.raises(ConfigError, match=f"'{name}' reads .* it measures in every 2. step"):
        make_env(num_envs=1, period=8 * DT, **{name: {"sensor_cfg": FEET, **WALK, **params}})
