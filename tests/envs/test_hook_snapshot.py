# SPDX-License-Identifier: Apache-2.0
"""Snapshots of what torch hooks can change: memory within memory, observations in dicts."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
import torch

from stripe_newton.envs import hook_parts
from stripe_newton.envs.hook_graphs.snapshot import Snapshot
from tests.helpers import recorded_cart


def test_a_block_is_restored_beyond_an_array_at_its_beginning():
    """Arrays of Warp are storages of their own, which begin where the block begins that they lie in."""
    block = torch.zeros(8)
    first = torch.from_numpy(block.numpy()[:2])
    assert first.untyped_storage().nbytes() < block.untyped_storage().nbytes()
    snapshot = Snapshot(SimpleNamespace(), (), {"first": first, "block": block}, "cpu")
    block += 1.0
    changed = snapshot.results()
    snapshot.restore()
    assert torch.equal(block, torch.zeros(8))
    assert torch.equal(snapshot.typed("first", changed["first"]), torch.ones(2))
    assert torch.equal(snapshot.typed("block", changed["block"]), torch.ones(8))


class NestedCart(recorded_cart.RecordedCart):
    """A cart whose group is a dict of tensors."""

    def _get_observations(self):
        whole = super()._get_observations()["policy"]
        return {"policy": {"state": whole[:, :4], "rest": whole[:, 4:]}}


def test_observations_in_dicts_are_recorded(monkeypatch: pytest.MonkeyPatch):
    space = {"policy": {"state": 4, "rest": 4}}
    eager = recorded_cart.make(NestedCart, observation_space=space)
    expected = [eager.step(torch.full((recorded_cart.N, 1), 0.1 * k))[0]["policy"] for k in range(20)]
    recorded_cart.record_on_cpu(monkeypatch)
    env = recorded_cart.make(NestedCart, observation_space=space)
    for k, group in enumerate(expected):
        found = env.step(torch.full((recorded_cart.N, 1), 0.1 * k))[0]["policy"]
        assert all(torch.equal(found[name], group[name]) for name in group), k
    names = hook_parts._arrays(env)
    assert {"observations 'policy'[0]", "observations 'policy'[1]"} < names.keys()
    hook = next(h for h in recorded_cart.recorder_of(env).hooks if h.name.startswith("_get_observations"))
    assert hook.recorded


def test_the_state_that_is_saved_is_that_of_hooks_that_run_as_they_are(monkeypatch: pytest.MonkeyPatch):
    """A checkpoint after replays has the bits of one without, so that resumed trainings go on with the same ones."""
    eager = recorded_cart.make(recorded_cart.WarpReset)
    recorded_cart.run(eager, 30)
    recorded_cart.record_on_cpu(monkeypatch)
    env = recorded_cart.make(recorded_cart.WarpReset)
    recorded_cart.run(env, 30)
    assert all(hook.recorded for hook in recorded_cart.recorder_of(env).hooks)
    expected, found = eager.get_state(), env.get_state()
    assert found["buffers"].keys() == expected["buffers"].keys()
    for part in ("arrays", "buffers"):
        for name, value in expected[part].items():
            assert torch.equal(found[part][name], value), name
