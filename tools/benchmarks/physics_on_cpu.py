# SPDX-License-Identifier: Apache-2.0
"""Physics on a CPU: ``taskset -c 0 python tools/benchmarks/physics_on_cpu.py [--num-envs N]``.

It prints the milliseconds that the physics of a step of the flat quadruped takes in one kernel and in MuJoCo Warp, and
those of MuJoCo's C for the same model and states, one world after another, and for mjlab's Go1, which stands.
"""

from __future__ import annotations

import argparse
import importlib.util
import time
from pathlib import Path

import mujoco
import numpy as np
import torch
import warp as wp

from stripe_newton.envs import ManagerBasedRLEnv
from stripe_tasks.velocity.quadruped import QuadrupedFlatEnvCfg

STEPS = 4
"""Physics steps in a step of the environment, each of 5 ms."""


def walking(num_envs: int, fused: bool) -> ManagerBasedRLEnv:
    """Quadrupeds after 30 random actions."""
    cfg = QuadrupedFlatEnvCfg()
    cfg.scene.num_envs, cfg.sim.device, cfg.sim.solver.fused = num_envs, "cpu", fused
    env = ManagerBasedRLEnv(cfg)
    torch.manual_seed(0)
    env.reset(seed=0)
    for _ in range(30):
        env.step(2.0 * torch.rand(num_envs, 12) - 1.0)
    return env


def physics_ms(env: ManagerBasedRLEnv, repeats: int) -> float:
    """Median duration of the physics of a step [ms]."""
    took = []
    for _ in range(repeats):
        env.step(2.0 * torch.rand(env.num_envs, 12) - 1.0)
        start = time.perf_counter()
        env.sim.step(STEPS)
        took.append(time.perf_counter() - start)
    return 1e3 * float(np.median(took))


def mujoco_ms(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, ctrl: np.ndarray) -> float:
    """Duration of MuJoCo's C for as many states, one after another [ms]."""
    model.opt.timestep = 0.005
    data = mujoco.MjData(model)
    start = time.perf_counter()
    for q, v, u in zip(qpos, qvel, ctrl, strict=True):
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
        for _ in range(STEPS):
            mujoco.mj_step(model, data)
    return 1e3 * (time.perf_counter() - start)


def standing_go1(num_envs: int) -> float:
    """Duration of MuJoCo's C for mjlab's Go1 on a plane [ms]."""
    found = importlib.util.find_spec("mjlab")
    assert found is not None, "mjlab is not installed: its wheel has the robot's file"
    assert found.origin is not None
    file = next(Path(found.origin).parent.rglob("go1.xml"))
    spec = mujoco.MjSpec.from_file(str(file))
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
    model = spec.compile()
    model.opt.timestep = 0.005
    data = mujoco.MjData(model)
    for _ in range(200):
        mujoco.mj_step(model, data)
    state = (np.repeat(x[None], num_envs, axis=0) for x in (data.qpos, data.qvel, data.ctrl))
    return mujoco_ms(model, *state)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--num-envs", type=int, default=256)
    num_envs = parser.parse_args().num_envs
    torch.set_num_threads(1)
    wp.config.log_level = wp.LOG_WARNING
    env = walking(num_envs, True)
    print(f"one kernel                  {physics_ms(env, 20):8.1f} ms")
    data = env.sim.solver.mjw_data
    state = (getattr(data, name).numpy() for name in ("qpos", "qvel", "ctrl"))
    print(f"MuJoCo's C, the same model  {mujoco_ms(env.sim.solver.mj_model, *state):8.1f} ms")
    env.close()
    print(f"MuJoCo's C, Go1             {standing_go1(num_envs):8.1f} ms")
    env = walking(num_envs, False)
    print(f"MuJoCo Warp                 {physics_ms(env, 5):8.1f} ms")
    env.close()


if __name__ == "__main__":
    main()
