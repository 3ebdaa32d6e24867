# SPDX-License-Identifier: Apache-2.0
"""Diverged policies: said where they show, with the iteration and the last checkpoint that is sound."""

from __future__ import annotations

import pytest
import torch

from stripe_newton.rl import DivergedError, find_checkpoint, load_checkpoint
from tests.helpers.fake_runner import make_runner, rows


def spoil(runner, value: float) -> None:
    with torch.no_grad():
        next(runner.networks["actor"].mlp.parameters()).view(-1)[0] = value


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_training_that_diverges(tmp_path, value):
    runner = make_runner(tmp_path)
    runner.logger.iteration_hooks.append(lambda it: spoil(runner, value) if it == 3 else None)
    with pytest.raises(DivergedError) as caught:
        runner.learn()
    # rsl_rl saves every second iteration; that of iteration 5 is not written any more.
    sound = tmp_path / "checkpoints" / "model_2.pt"
    text = str(caught.value)
    assert text.startswith("iteration 5: ")
    assert f"the training has diverged; the last sound checkpoint is {sound}" in text
    assert find_checkpoint(tmp_path) == sound
    assert len(rows(tmp_path)) == 4


def test_a_checkpoint_with_weights_that_are_not_finite(tmp_path):
    runner = make_runner(tmp_path)
    runner.learn()
    file = find_checkpoint(tmp_path)
    data = load_checkpoint(file)
    data["actor_state_dict"]["mlp.0.weight"][0, 0] = float("nan")
    torch.save(data, file)
    for read in (runner.load, runner.resume):
        with pytest.raises(DivergedError) as caught:
            read(file)
        text = f"{file}: weights of the actor are not finite (mlp.0.weight): the training has diverged; "
        assert str(caught.value).startswith(f"{text}the last sound checkpoint is {tmp_path}/checkpoints/model_4.pt")
    with pytest.raises(DivergedError, match="weights of the actor"):
        runner.save(tmp_path / "model_9.pt")
    assert not (tmp_path / "checkpoints" / "model_9.pt").exists()


def test_without_a_run_there_is_no_sound_checkpoint():
    runner = make_runner(None)
    runner.logger.iteration_hooks.append(lambda it: spoil(runner, float("nan")))
    with pytest.raises(DivergedError, match="no checkpoint is from before"):
        runner.learn()
