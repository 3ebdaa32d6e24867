# SPDX-License-Identifier: Apache-2.0
"""Peer of ``compare_mjlab.py``: the part that runs under mjlab's interpreter.

    python tools/comparison/compare_mjlab_peer.py {describe,evaluate,measure} REQUEST.json

Of this repository it imports only ``compare_mjlab_measure``. Answers go to the file ``out`` of the request, which also
has ``num_envs``, ``seed``, ``device`` and ``randomize``:

* ``describe``: the robot as mjlab writes it to MJCF after its own settings (``robot.xml`` beside ``out``), and the
  task's numbers, read from its configs and from the model that it runs;
* ``evaluate``: observations, rewards and one control step of the physics from given states, see :func:`evaluate`;
* ``measure``: see :func:`compare_mjlab_measure.measure`.
"""

from __future__ import annotations

import dataclasses
import json
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from compare_mjlab_measure import Side, measure, versions

if TYPE_CHECKING:
    from mjlab.envs import ManagerBasedRlEnv, ManagerBasedRlEnvCfg
    from mjlab.rl import MjlabOnPolicyRunner

Json = dict[str, Any]
"""Requests, facts and results, which go from process to process as JSON."""
TASK = "Mjlab-Velocity-Flat-Unitree-Go1"


def make_cfg(request: Json) -> ManagerBasedRlEnvCfg:
    """Config of the task, with the requested ``"cone"`` and ``"njmax"``.

    Without ``"randomize"`` it has no noise, no pushes and no randomisation at the start.
    """
    import mjlab.tasks  # noqa: F401
    from mjlab.tasks.registry import load_env_cfg

    cfg = load_env_cfg(TASK)
    cfg.scene.num_envs, cfg.seed = request["num_envs"], request["seed"]
    cfg.sim.mujoco.cone = request.get("cone") or cfg.sim.mujoco.cone
    cfg.sim.njmax = request.get("njmax") or cfg.sim.njmax
    if not request["randomize"]:
        for group in cfg.observations.values():
            group.enable_corruption = False
        cfg.events = {name: term for name, term in cfg.events.items() if term.mode == "reset"}
    return cfg


def make_side(request: Json) -> Side:
    """Build mjlab's environment."""
    import warp as wp
    from mjlab.envs import ManagerBasedRlEnv
    from mjlab.rl import MjlabOnPolicyRunner, RslRlVecEnvWrapper
    from mjlab.tasks.registry import load_rl_cfg
    from mjlab.utils.torch import configure_torch_backends

    configure_torch_backends(allow_tf32=request["tf32"])
    cfg = make_cfg(request)
    env = ManagerBasedRlEnv(cfg, device=request["device"])
    env.reset(seed=request["seed"])

    def physics() -> None:
        for _ in range(cfg.decimation):
            env.sim.step()

    def spread(lengths: torch.Tensor) -> None:
        env.episode_length_buf = lengths

    def make_runner(folder: str) -> MjlabOnPolicyRunner:
        agent = dataclasses.asdict(load_rl_cfg(TASK))
        agent |= {"logger": "tensorboard", "upload_model": False, "save_interval": 10**9, "seed": request["seed"]}
        torch.manual_seed(request["seed"])
        return MjlabOnPolicyRunner(RslRlVecEnvWrapper(env, agent["clip_actions"]), agent, folder, request["device"])

    def velocity_error() -> torch.Tensor:
        velocity = env.scene["robot"].data.root_link_lin_vel_b[:, :2]
        return (env.command_manager.get_command("twist")[:, :2] - velocity).norm(dim=1)

    data = env.sim.wp_data
    return Side(
        device=request["device"],
        num_envs=env.num_envs,
        num_actions=env.action_manager.total_action_dim,
        step=env.step,
        physics=physics,
        state=[wp.to_torch(array) for array in (data.qpos, data.qvel, data.qacc_warmstart)],
        targets=[wp.to_torch(data.ctrl)],
        spread=spread,
        max_episode_length=env.max_episode_length,
        make_runner=make_runner,
        velocity_error=velocity_error,
    )


def describe(request: Json) -> None:
    """Write the robot and the task's numbers."""
    import mujoco
    from mjlab.entity import Entity
    from mjlab.envs import ManagerBasedRlEnv
    from mjlab.tasks.registry import load_rl_cfg

    cfg, out = make_cfg(request), Path(request["out"])
    spec = Entity(cfg.scene.entities["robot"]).spec
    spec.meshdir = str(Path(spec.modelfiledir) / spec.meshdir)
    spec.compile()
    # MuJoCo leaves out the second number where it is the default, Newton's importer wants both
    whole = re.sub(r'solref="([^" ]+)"', r'solref="\1 1"', spec.to_xml())
    (out.parent / "robot.xml").write_text(whole)
    env = ManagerBasedRlEnv(cfg, device="cpu")
    robot, model = env.scene["robot"], env.sim.mj_model
    facts = {
        "versions": versions(),
        "env": plain(cfg),
        "agent": plain(load_rl_cfg(TASK)),
        "joint_names": robot.joint_names,
        "joint_pos": robot.data.default_joint_pos[0].tolist(),
        "root_pos": robot.data.default_root_state[0, :3].tolist(),
        "soft_limit_factor": cfg.scene.entities["robot"].articulation.soft_joint_pos_limit_factor,
        "action_scale": env.action_manager.get_term("joint_pos").scale[0].tolist(),
        "sites": {name: model.site(f"robot/{name}").pos.tolist() for name in robot.site_names},
        "reward_weights": {n: env.reward_manager.get_term_cfg(n).weight for n in env.reward_manager.active_terms},
        "multiccd": not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_MULTICCD,
        "room": {"contacts_a_world": env.sim.wp_data.naconmax / env.num_envs, "constraints": env.sim.wp_data.njmax},
        "geoms": {
            model.geom(g).name.removeprefix("robot/"): {
                "condim": int(model.geom_condim[g]),
                "priority": int(model.geom_priority[g]),
                "friction": model.geom_friction[g].tolist(),
                "solref": model.geom_solref[g].tolist(),
                "solimp": model.geom_solimp[g].tolist(),
            }
            for g in range(model.ngeom)
            if model.geom_contype[g]
        },
        "bodies": {
            name: [float(model.body(f"robot/{name}").mass[0]), *model.body(f"robot/{name}").inertia.tolist()]
            for name in robot.body_names
        },
        "dofs": {
            name: [float(model.dof_armature[d]), float(model.dof_damping[d]), float(model.dof_frictionloss[d])]
            for name, d in ((n, model.joint(f"robot/{n}").dofadr[0]) for n in robot.joint_names)
        },
        "drives": {
            model.actuator(a).name.removeprefix("robot/"): [
                *model.actuator_biasprm[a, 1:3],
                *model.actuator_forcerange[a],
            ]
            for a in range(model.nu)
        },
    }
    out.write_text(json.dumps(facts, indent=1))


def evaluate(request: Json) -> None:
    """Put the environments into the states of the file ``states``; write mjlab's observations, rewards and next state.

    Arrays of the states lead with the environment: ``root_pos``, ``root_quat`` (x, y, z, w), ``root_lin_vel`` (of the
    link's origin) and ``root_ang_vel`` in the world frame, ``joint_pos``, ``joint_vel``, ``action``, ``prev_action``,
    ``command``; of the feet ``force`` (zero for those without contact), ``current_air_time``, ``current_contact_time``,
    ``peak``. Written are ``obs_GROUP``, ``reward_TERM`` (weighted), and after a control step from the same states,
    without warm start: the six arrays of the state, and ``found``, ``force``, ``current_air_time`` of the feet.
    """
    from mjlab.envs import ManagerBasedRlEnv

    given = {name: torch.from_numpy(array) for name, array in np.load(request["states"]).items()}
    env = ManagerBasedRlEnv(make_cfg(request), device="cpu")
    found = _terms_of_states(env, given, request["seed"]) | _state_after_step(env, given, request["seed"])
    np.savez(request["out"], **{name: np.asarray(value.clone()) for name, value in found.items()})


def _enter(env: ManagerBasedRlEnv, given: dict[str, torch.Tensor], seed: int) -> None:
    """Put the environments into the given states, without a memory of others."""
    robot, first_last = env.scene["robot"], [3, 0, 1, 2]  # mjlab's quaternions begin with the real part
    env.reset(seed=seed)
    env.sim.reset()
    velocity = torch.cat([given["root_lin_vel"], given["root_ang_vel"]], dim=1)
    pose = torch.cat([given["root_pos"] + env.scene.env_origins, given["root_quat"][:, first_last]], dim=1)
    robot.write_root_state_to_sim(torch.cat([pose, velocity], dim=1))
    robot.write_joint_state_to_sim(given["joint_pos"], given["joint_vel"])


def _terms_of_states(env: ManagerBasedRlEnv, given: dict[str, torch.Tensor], seed: int) -> dict[str, torch.Tensor]:
    """Observations and rewards in the given states.

    Actions, commands and what the feet feel are written where mjlab keeps them, as no step led to these states.
    """
    sensor = env.scene["feet_ground_contact"]
    _enter(env, given, seed)
    env.sim.forward()
    env.sim.sense()
    env.action_manager._action[:], env.action_manager._prev_action[:] = given["action"], given["prev_action"]
    env.command_manager.get_command("twist")[:] = given["command"]
    for index, slot in enumerate(s for s in sensor._slots if s.field_name == "force"):
        slot.data_view[:] = given["force"][:, index]
    for index, slot in enumerate(s for s in sensor._slots if s.field_name == "found"):
        slot.data_view[:] = (given["force"][:, index].norm(dim=1, keepdim=True) > 0.0).float()
    for name in ("current_air_time", "current_contact_time"):
        getattr(sensor._air_time_state, name)[:] = given[name]
    for each in env.scene.sensors.values():
        each._invalidate_cache()
    env.reward_manager.get_term_cfg("foot_swing_height").func.peak_heights[:] = given["peak"]
    env.reward_manager.compute(dt=env.step_dt)
    seen = env.observation_manager.compute(update_history=True)
    found = {f"obs_{name}": value.clone() for name, value in seen.items()}
    for index, name in enumerate(env.reward_manager.active_terms):
        found[f"reward_{name}"] = env.reward_manager._step_reward[:, index].clone()
    return found


def _state_after_step(env: ManagerBasedRlEnv, given: dict[str, torch.Tensor], seed: int) -> dict[str, torch.Tensor]:
    """State of the robots and contacts of their feet after a control step from the given states."""
    robot, sensor = env.scene["robot"], env.scene["feet_ground_contact"]
    _enter(env, given, seed)
    env.action_manager.process_action(given["action"])
    for _ in range(env.cfg.decimation):
        env.action_manager.apply_action()
        env.scene.write_data_to_sim()
        env.sim.step()
        env.scene.update(dt=env.physics_dt)
    contacts = {"found": sensor.data.found, "force": sensor.data.force, "air": sensor.data.current_air_time}
    env.sim.forward()
    state = robot.data
    return contacts | {
        "root_pos": state.root_link_pos_w - env.scene.env_origins,
        "root_quat": state.root_link_quat_w[:, [1, 2, 3, 0]],
        "root_lin_vel": state.root_link_lin_vel_w,
        "root_ang_vel": state.root_link_ang_vel_w,
        "joint_pos": state.joint_pos,
        "joint_vel": state.joint_vel,
    }


def plain(value: object) -> object:
    """Convert a config to JSON; functions and classes become names."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, dict):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if value is None or isinstance(value, (str, int, float, bool)):
        return value
    return getattr(value, "__name__", type(value).__name__)


def main() -> None:
    """Do what the command line asks for."""
    what, request = sys.argv[1], json.loads(Path(sys.argv[2]).read_text())
    if what == "measure":
        Path(request["out"]).write_text(json.dumps(measure(lambda: make_side(request), request), indent=1))
    else:
        {"describe": describe, "evaluate": evaluate}[what](request)


if __name__ == "__main__":
    main()
