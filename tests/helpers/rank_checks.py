# SPDX-License-Identifier: Apache-2.0
"""Checks of two ranks together, with gloo on the CPU; test_distributed.py starts ``rank_checks.py FOLDER``."""

from __future__ import annotations

import copy
import sys
from pathlib import Path

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.storage import RolloutStorage

from stripe_newton.cli.device import set_seeds
from stripe_newton.rl import OnPolicyRunner, RslRlVecEnvWrapper, find_checkpoint, load_checkpoint, read_metrics
from stripe_newton.rl.distributed import as_rank, exchange, world
from tests.helpers.fake_env import FakeCartCfg, FakeCartEnv, FakeCartRunnerCfg

ENVS = 4


def make_runner(folder: Path | None, kind: str = "rsl_rl", seed: int = 5) -> OnPolicyRunner:
    agent = FakeCartRunnerCfg(runner=kind)
    agent.algorithm.num_mini_batches = 1  # so that one process's minibatch is the union of the ranks'
    cfg = FakeCartCfg()
    cfg.sim.device, cfg.scene.num_envs, cfg.seed = "cpu", ENVS, seed + world().rank
    set_seeds(seed + world().rank)
    return OnPolicyRunner(RslRlVecEnvWrapper(FakeCartEnv(cfg)), agent, folder)


def parameters(algorithm: PPO) -> torch.Tensor:
    models = (algorithm._raw_actor, algorithm._raw_critic)
    return torch.cat([p.detach().flatten().clone() for model in models for p in model.parameters()])


def gradients(algorithm: PPO) -> torch.Tensor:
    models = (algorithm._raw_actor, algorithm._raw_critic)
    return torch.cat([p.grad.flatten().clone() for model in models for p in model.parameters() if p.grad is not None])


def check_ranks_stay_equal_and_average(kind: str) -> None:
    runner = make_runner(None, kind)
    algorithm = runner.alg
    assert not torch.equal(*exchange(parameters(algorithm)))  # seeds of their own
    reduce, seen = algorithm.reduce_parameters, []

    def watched() -> None:
        mine = exchange(gradients(algorithm))
        reduce()
        torch.testing.assert_close(gradients(algorithm), (mine[0] + mine[1]) / 2.0, rtol=1e-6, atol=1e-9)
        seen.append(not torch.equal(*mine))

    algorithm.reduce_parameters = watched
    runner.learn(1)
    assert seen == [True] * 3  # one minibatch in three epochs, of data that differ
    one, other = exchange(parameters(algorithm))
    assert torch.equal(one, other)
    one, other = exchange(runner.env.get_observations()["policy"])
    assert not torch.equal(one, other)


def check_one_update_equals_that_of_one_process() -> None:
    """Ranks that update on their halves, against rsl_rl's PPO of one process on both halves joined."""
    runner = make_runner(None)
    algorithm, env = runner.alg, runner.env
    algorithm.broadcast_parameters()
    obs = env.get_observations()
    with torch.inference_mode():
        for _ in range(runner.agent_cfg.num_steps_per_env):
            obs, rewards, dones, extras = env.step(algorithm.act(obs))
            algorithm.process_env_step(obs, rewards, dones, extras)
        algorithm.compute_returns(obs)

    single = make_single(runner)
    names = ("rewards", "dones", "values", "returns", "advantages", "actions", "actions_log_prob")
    for name in names:
        halves = exchange(getattr(algorithm.storage, name))
        getattr(single.storage, name).copy_(torch.cat(halves, dim=1))
    for name, value in algorithm.storage.observations.items():
        single.storage.observations[name].copy_(torch.cat(exchange(value), dim=1))
    halves = exchange(list(algorithm.storage.distribution_params))
    single.storage.distribution_params = tuple(torch.cat(pair, dim=1) for pair in zip(*halves, strict=True))
    single.storage.step = algorithm.storage.step

    observed = single.storage.observations["policy"].flatten(0, 1).clone()
    before = parameters(algorithm)
    losses, expected = algorithm.update(), single.update()
    assert (parameters(algorithm) - before).abs().max() > 1e-3
    torch.testing.assert_close(parameters(algorithm), parameters(single), rtol=1e-4, atol=2e-6)
    assert abs(algorithm.learning_rate - single.learning_rate) < 1e-9
    mean = sum(each["value"] for each in exchange(losses)) / 2
    assert abs(mean - expected["value"]) < 1e-4 * abs(mean)
    normalizer = algorithm._raw_actor.obs_normalizer
    assert int(normalizer.count) == len(observed) == 2 * ENVS * runner.agent_cfg.num_steps_per_env
    torch.testing.assert_close(normalizer.mean, observed.mean(0), rtol=1e-5, atol=1e-6)
    torch.testing.assert_close(normalizer.std, observed.std(0, unbiased=False), rtol=1e-5, atol=1e-6)


def make_single(runner: OnPolicyRunner) -> PPO:
    """rsl_rl's PPO, in one process, with the parameters of the runner's and room for the data of both ranks."""
    mine, cfg = runner.alg, runner.agent_cfg
    obs = runner.env.get_observations()
    both = torch.cat([obs, obs])
    storage = RolloutStorage("rl", 2 * ENVS, cfg.num_steps_per_env, both, [1], "cpu")
    algorithm = cfg.algorithm
    names = ("num_learning_epochs", "num_mini_batches", "clip_param", "gamma", "lam", "value_loss_coef")
    names += ("entropy_coef", "learning_rate", "max_grad_norm", "schedule", "desired_kl")
    settings = {name: getattr(algorithm, name) for name in names}
    return PPO(copy.deepcopy(mine._raw_actor), copy.deepcopy(mine._raw_critic), storage, device="cpu", **settings)


def check_files_log_and_resume(folder: Path) -> None:
    whole, parts = folder / "whole", folder / "parts"
    uninterrupted = make_runner(whole)
    uninterrupted.learn(4)
    make_runner(parts).learn(2)
    exchange(None)  # rank 0 has written
    checkpoint = find_checkpoint(parts)
    state = load_checkpoint(checkpoint)["stripe_newton"]
    assert len(state["ranks"]) == 1
    assert checkpoint.name == "model_1.pt"
    exchange(None)  # rank 1 has read
    again = make_runner(parts, seed=77)
    again.resume(checkpoint)
    again.learn(2)
    for one, other in (
        (parameters(uninterrupted.alg), parameters(again.alg)),
        (uninterrupted.env.unwrapped.x, again.env.unwrapped.x),
        (uninterrupted.env.get_observations()["policy"], again.env.get_observations()["policy"]),
    ):
        assert torch.equal(one, other)

    assert exchange(uninterrupted.logger.tot_timesteps) == [4 * 16 * ENVS * 2] * 2
    rewards = exchange(sum(uninterrupted.logger.rewbuffer) / len(uninterrupted.logger.rewbuffer))
    if world().rank == 0:
        columns = read_metrics(whole / "metrics.csv")
        assert abs(columns["Train/mean_reward"][-1] - sum(rewards) / 2) < 1e-6
        assert columns["total_steps"] == [128.0 * n for n in range(1, 5)]
        assert len(list(whole.glob("events.out.tfevents.*"))) == 1
        assert read_metrics(parts / "metrics.csv")["Train/mean_reward"] == columns["Train/mean_reward"]


def main() -> int:
    torch.set_num_threads(1)
    for kind in ("rsl_rl", "graph"):
        check_ranks_stay_equal_and_average(kind)
    check_one_update_equals_that_of_one_process()
    check_files_log_and_resume(Path(sys.argv[1]))
    print("all checks passed")
    return 0


if __name__ == "__main__":
    sys.exit(as_rank(main))
