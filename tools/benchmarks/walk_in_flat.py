# SPDX-License-Identifier: Apache-2.0
"""Walk through the imported flat and up its stairs: ``python tools/benchmarks/walk_in_flat.py RUN FILM.mp4``.

RUN is a run of a velocity task, such as ``logs/velocity_rough_quadruped/2026-01-31_12-00-00``. Its policy steers some
robots past places in the flat of ``tools/authoring/author_flat.py``: from the window through the living room, between
table and sofa, up the stairs, and along the gallery. The commands are those of the task, forward speed and heading. The
script prints how many robots arrived, and films the first of them. Options: ``--num-envs N``, ``--seconds S``,
``--speed V``, ``--device D``, ``--no-film``.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path

import torch

from stripe_newton.cli.env_and_policy import build_policy, find_policy
from stripe_newton.cli.run_configs import Configs, load_configs, use_one_minibatch
from stripe_newton.rl import Policy, RslRlVecEnvWrapper
from stripe_newton.rl.runs.video import video_timing
from stripe_newton.viewers import VideoWriter

sys.path.insert(0, str(Path(__file__).parents[1] / "authoring"))

from author_flat import EDGE, GALLERY, author_flat

START = (-0.4, -2.2, 0.0, 0.5 * math.pi)
"""Where robots begin: a point of the floor [m], and a heading [rad]."""
WAY = ((-0.9, 0.6), (-3.8, 1.85), (-4.95, 2.15), (-5.05, 2.75), (-4.6, 2.9), (EDGE + 0.6, 2.9), (2.6, 2.4), (3.0, -0.6))
"""Places that are passed [m]: the last but three is the first step of the stairs, which end at ``x = EDGE``."""
NEAR = 0.3
"""Distance at which a place counts as passed [m]."""
SHARPNESS = 4.0
"""How much slower a robot is that is not headed for the next place."""


class Walkers:
    """Robots that are steered past :data:`WAY`.

    Attributes:
        passed: How many each has passed before a fall, shape ``(num_envs,)``.
        fell: Whether each has fallen, shape ``(num_envs,)``.
        ends: Why and where episodes ended.
        arrived: Whether each has passed all places without a fall, shape ``(num_envs,)``.
    """

    def __init__(self, env: RslRlVecEnvWrapper, speed: float):
        self.env, self.speed = env, speed
        inner = env.unwrapped
        self._robot, self._command = inner.scene["robot"], inner.command_manager.get_term("base_velocity")
        self._way = torch.tensor(WAY, device=inner.device)

    def restart(self, seed: int) -> torch.Tensor:
        """Put all robots at the start; the observations."""
        self.env.reset(seed=seed)
        count, device = self.env.num_envs, self.env.unwrapped.device
        pose = self._robot.data.root_pose_w.clone()
        pose[:, :2] = torch.tensor(START[:2], device=device)
        pose[:, 2] = START[2] + self._robot.data.default_root_state[:, 2]
        pose[:, 3:] = torch.tensor([0.0, 0.0, math.sin(0.5 * START[3]), math.cos(0.5 * START[3])], device=device)
        self._robot.write_root_pose_to_sim(pose)
        self._next = torch.zeros(count, dtype=torch.long, device=device)
        self.passed = self._next.clone()
        self.ends: list[tuple[str, list[float]]] = []
        self.fell = torch.zeros(count, dtype=torch.bool, device=device)
        self._steer()
        return self.env.get_observations()

    def step(self, policy: Policy, observations: torch.Tensor) -> torch.Tensor:
        """A step of all; the observations."""
        self._before = self._robot.data.root_pos_w.clone()
        observations, _, dones, _ = self.env.step(policy(observations))
        policy.reset(dones)
        new = dones.bool() & ~self.arrived & ~self.fell
        for index in new.nonzero().flatten().tolist():
            manager = self.env.unwrapped.termination_manager
            why = [name for name in manager.active_terms if bool(manager.get_term(name)[index])]
            self.ends.append((", ".join(why), [round(x, 2) for x in self._before[index].tolist()]))
        self.fell |= new
        self.passed = torch.where(self.fell, self.passed, self._next)
        self._steer()
        return observations

    @property
    def arrived(self) -> torch.Tensor:
        return (self._next == len(WAY)) & ~self.fell

    def _steer(self) -> None:
        """Head for the next place, slower if it is not ahead; stand at the last one."""
        there = self._next == len(WAY)
        at = self._robot.data.root_pos_w[:, :2]
        to = self._way[self._next.clamp(max=len(WAY) - 1)] - at
        self._next += ((to.norm(dim=1) < NEAR) & ~there).long()
        heading = torch.atan2(to[:, 1], to[:, 0])
        off = torch.remainder(heading - self._robot.data.heading_w + math.pi, 2 * math.pi) - math.pi
        self._command.heading_target[:] = torch.where(there, self._robot.data.heading_w, heading)
        self._command.vel_command_b[:, 0] = self.speed * torch.exp(-SHARPNESS * off**2) * ~there
        self._command.vel_command_b[:, 1] = 0.0


def configs_of_walk(run: str, flat: Path, args: argparse.Namespace) -> tuple[str, Configs, Path]:
    """Task, configs and checkpoint of a run, in the flat, undisturbed."""
    checkpoint, folder = find_policy(run, args.task or "")
    task = args.task or (folder.read_task() if folder is not None else "")
    if checkpoint is None or not task:
        sys.exit(f"{run}: there is no run; an exported policy without one takes --task")
    is_exported = checkpoint.suffix == ".onnx"
    configs = load_configs(task, None if is_exported else folder, agent=not is_exported)
    cfg, command = configs.env, configs.env.commands.base_velocity
    cfg.scene.num_envs, cfg.seed, cfg.scene.scenery = args.num_envs, args.seed, str(flat)
    cfg.sim.device, cfg.events.push_robot, cfg.episode_length_s = args.device, None, 2.0 * args.seconds
    command.resampling_time_range, command.rel_standing_envs = (4.0 * args.seconds,) * 2, 0.0
    command.heading_control_stiffness, command.ranges.ang_vel_z = 2.0, (-1.0, 1.0)
    view = cfg.viewer
    view.origin_type, view.eye, view.lookat, view.fov = "world", (-6.4, -6.6, 7.2), (-1.2, 0.6, 1.0), 48.0
    cfg.complete()  # for a scenery it has other terms
    if configs.agent is not None:
        use_one_minibatch(configs.agent)
    return task, configs, checkpoint


@torch.inference_mode()
def main() -> None:
    """Walk, say how many arrived, and film one."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("run")
    parser.add_argument("film", type=Path)
    parser.add_argument("--task", help="that of an exported policy without a run folder")
    parser.add_argument("--num-envs", type=int, default=32)
    parser.add_argument("--seconds", type=float, default=40.0)
    parser.add_argument("--speed", type=float, default=0.8)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--device")
    parser.add_argument("--no-film", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        flat = author_flat(Path(folder) / "flat.usda")
        task, configs, checkpoint = configs_of_walk(args.run, flat, args)
        env, policy = build_policy(task, configs, checkpoint, render=not args.no_film)
    walkers, inner = Walkers(env, args.speed), env.unwrapped
    steps, taken = round(args.seconds / inner.step_dt), torch.full((args.num_envs,), math.inf)
    observations = walkers.restart(args.seed)
    policy.reset()
    highest = torch.zeros(args.num_envs)
    for step in range(steps):
        observations = walkers.step(policy, observations)
        taken[walkers.arrived.cpu() & taken.isinf()] = step * inner.step_dt
        height = inner.scene["robot"].data.root_pos_w[:, 2].cpu()
        highest = torch.where(walkers.fell.cpu(), highest, torch.maximum(highest, height))
    up, there = int((highest > GALLERY).sum()), taken.isfinite()
    print(f"{up} of {args.num_envs} robots came up the stairs, {int(there.sum())} arrived on the gallery", flush=True)
    print(f"places that they passed: {walkers.passed.tolist()} of {len(WAY)}")
    for why, where in walkers.ends[:10]:
        print(f"{why} at {where}")
    if there.any():
        print(f"they took {float(taken[there].min()):.1f} to {float(taken[there].max()):.1f} s")
    if not args.no_film:
        shown = int(taken.argmin()) if there.any() else int(highest.argmax())
        inner.cfg.viewer.env_index = shown
        print(film(walkers, policy, args, shown, float(taken[shown])))
    env.close()


def film(walkers: Walkers, policy: Policy, args: argparse.Namespace, shown: int, seconds: float) -> Path:
    """Walk once more, from the same seed, and write a video of one robot until it stands."""
    from stripe_newton.viewers import SceneRenderer

    inner = walkers.env.unwrapped
    stride, fps = video_timing(inner.step_dt, 30.0)
    renderer = SceneRenderer(inner.sim, inner.cfg.viewer, [shown])
    args.film.parent.mkdir(parents=True, exist_ok=True)
    observations = walkers.restart(args.seed)
    policy.reset()
    with VideoWriter(args.film, fps) as video:
        for step in range(round(min(seconds + 1.0, args.seconds) / inner.step_dt)):
            observations = walkers.step(policy, observations)
            if step % stride == 0:
                video.add(renderer.render())
    return args.film


if __name__ == "__main__":
    main()
