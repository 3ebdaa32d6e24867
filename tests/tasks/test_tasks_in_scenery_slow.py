# SPDX-License-Identifier: Apache-2.0
"""Tasks of all kinds in an imported scenery, from Python and from the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from stripe_newton.cli import main
from stripe_newton.cli.tasks import load_cfg, make_env
from tools.authoring.author_flat import GALLERY, author_flat

pytestmark = pytest.mark.slow

WALK = "Stripe-Velocity-Flat-Quadruped-v0"


@pytest.mark.parametrize(
    ("task", "draws"),
    [
        ("Stripe-Ant-Direct-v0", True),  # torch hooks
        ("Stripe-Velocity-Flat-Quadruped-Direct-Warp-v0", True),  # Warp hooks
        ("Stripe-Reach-v0", False),  # an arm that is fixed to the world
        ("Stripe-Velocity-Rough-Quadruped-v0", True),  # a terrain and a scanner
    ],
)
def test_any_task_starts_at_places_of_the_flat(task, draws):
    cfg = load_cfg(task, "env")
    cfg.scene.num_envs, cfg.sim.device, cfg.seed = 8, "cpu", 1
    cfg.scene.scenery = str(author_flat("flat.usda"))
    env = make_env(task, cfg).unwrapped
    env.reset()
    first, spots = env.scene.env_origins.clone(), env.scene.terrain.spots
    assert all((spots == origin).all(dim=1).any() for origin in first)
    assert {0.0, round(GALLERY, 1)} <= {abs(round(z, 1)) for z in first[:, 2].tolist()}
    for _ in range(5):
        _, _, terminated, _, _ = env.step(torch.zeros(8, *env.single_action_space.shape))
        assert not terminated.any()
    env.reset()
    assert bool((env.scene.env_origins != first).any()) == draws
    env.close()


def test_a_run_keeps_its_scenery(capsys):
    flat = str(author_flat("flat.usda"))
    options = ["--num-envs", "8", "--max-iterations", "1", "--device", "cpu", "--final-video", "False"]
    assert main(["train", WALK, *options, "--agent.num-steps-per-env", "4", "--env.scene.scenery", flat]) == 0
    assert f"scenery {flat}: 81 shared colliders" in capsys.readouterr().err
    (run,) = Path("logs").glob("*/*")
    play = ["play", WALK, "--checkpoint", str(run), "--viewer", "none", "--num-envs", "2", "--steps", "2"]
    assert main([*play, "--device", "cpu"]) == 0
    text = capsys.readouterr().err
    assert f"scenery {flat}" in text
    assert "the task has changed" not in text


def test_inspect_shows_a_task_in_a_scenery(capsys):
    flat = str(author_flat("flat.usda", bodies=True))
    assert main(["inspect", WALK, "--json", "--env.scene.scenery", flat]) == 0
    found = json.loads(capsys.readouterr().out)
    assert "2 bodies in each environment; the task's ground is left out" in found["scenery"]
    assert [report["file"] for report in found["reports"]].count(flat) == 2
    assert Path(found["picture"]).is_file()
