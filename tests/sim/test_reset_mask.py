# SPDX-License-Identifier: Apache-2.0
"""Lists of the environments in a reset mask, and copies of the rows of others, against NumPy."""

import queue
import threading
import time
from functools import partial

import numpy as np
import pytest
import torch
import warp as wp

from stripe_newton.envs.hook_graphs import EnvRows
from stripe_newton.sim import ResetMask, reset_mask


@pytest.mark.parametrize("num_envs", [1, 63, 64, 200])
@pytest.mark.parametrize("share", [0.0, 0.1, 1.0])
def test_environments_of_the_mask_come_first(num_envs, share):
    chosen = np.random.default_rng(num_envs).random(num_envs) < share
    mask = ResetMask(num_envs, "cpu")
    for listed_in_step in (False, True):
        mask.listed_in_step = listed_in_step
        mask.choose(torch.from_numpy(chosen))
        if listed_in_step:
            mask.launch_list()
        assert mask.number == chosen.sum()
        assert mask.indices().tolist() == np.flatnonzero(chosen).tolist() == mask.indices_on_host().tolist()
        assert mask.order.numpy().tolist() == [*np.flatnonzero(chosen), *np.flatnonzero(~chosen)]
        assert mask.count.numpy().tolist() == [chosen.sum()]


class LateDevice:
    """A device that runs what is launched some milliseconds later, in its order."""

    def __init__(self, monkeypatch):
        self.queue, self.waits = queue.Queue(), 0
        launch = wp.launch
        monkeypatch.setattr(wp, "launch", lambda *args, **kwargs: self.queue.put(partial(launch, *args, **kwargs)))
        monkeypatch.setattr(wp, "synchronize_device", self.synchronize)
        threading.Thread(target=self.run, daemon=True).start()

    def run(self):
        while (call := self.queue.get()) is not None:
            time.sleep(2e-3)
            call()
            self.queue.task_done()
        self.queue.task_done()

    def synchronize(self, device):
        self.waits += 1
        self.queue.join()


@pytest.fixture
def late(monkeypatch):
    monkeypatch.setattr(reset_mask, "_LOOKS", 10**8)  # a report that does not come is seen by the test's limit of time
    device = LateDevice(monkeypatch)
    yield device
    device.queue.put(None)


def graph_of(mask):
    """Launches of the list, as a graph replays them: the host's side does not see them."""

    def replay():
        listed, lists, awaited = mask._listed, mask._lists, mask._awaited
        mask.launch_list()
        mask._listed, mask._lists, mask._awaited = listed, lists, awaited

    return replay


def choose(mask, device, *envs):
    """Write the mask as kernels of a step do: behind what was launched before."""
    device.queue.join()
    mask.tensor[:] = False
    mask.tensor[list(envs)] = True


def test_numbers_are_those_of_the_step_on_a_device_that_is_late(late):
    mask = ResetMask(4, "cpu")
    mask.begin_step()  # of a reset, before the step with the list is made
    mask.listed_in_step = True
    choose(mask, late, 0, 1, 2, 3)
    mask.launch_list()
    assert mask.number == 4
    replay = graph_of(mask)
    for envs in ((0,), (), (1, 2), (0, 1, 2, 3), (3,)):
        mask.begin_step()
        choose(mask, late, *envs)
        replay()
        assert mask.number == len(envs)
        assert mask.indices().tolist() == list(envs)
    assert late.waits == 0


def test_a_list_that_nobody_waited_for_is_not_taken_for_the_next(late):
    mask = ResetMask(4, "cpu")
    mask.listed_in_step = True
    replay = graph_of(mask)
    mask.begin_step()
    choose(mask, late, 0, 1, 2)
    replay()  # an error ends the step here
    mask.begin_step()
    assert late.waits == 1
    choose(mask, late, 3)
    replay()
    assert mask.number == 1
    mask.begin_step()
    choose(mask, late)
    mask.launch_list()  # kernel by kernel
    assert mask.number == 0
    assert late.waits == 1


def test_indices_belong_to_whoever_asks():
    mask = ResetMask(4, "cpu")
    mask.choose(torch.tensor([True, False, True, False]))
    first = mask.indices()
    mask.choose(torch.tensor([False, True, False, False]))
    assert (first.tolist(), mask.indices().tolist()) == ([0, 2], [1])


def test_rows_of_others_are_brought_back():
    num_envs, places = 5, 4
    tensors = [
        torch.rand(num_envs, 3),
        torch.randint(0, 2, (num_envs,), dtype=torch.bool),
        torch.rand(num_envs * 6),  # flat, as arrays of Newton
        torch.randint(0, 99, (num_envs, 2), dtype=torch.int16),
        torch.rand(num_envs + 2),  # no rows
    ]
    before = [t.clone() for t in tensors]
    rows = EnvRows(tensors, num_envs, places, "cpu")
    order, count = wp.array([3, 1, 0, 2, 4], dtype=wp.int64), wp.array([2], dtype=int)
    rows.keep(order, count, places)
    for tensor in tensors:
        tensor.copy_(tensor + 1 if tensor.dtype != torch.bool else ~tensor)
    changed = [t.clone() for t in tensors]
    rows.restore(order, count, places)
    for tensor, old, new in zip(tensors[:-1], before[:-1], changed[:-1], strict=True):
        now, old, new = (t.reshape(num_envs, -1) for t in (tensor, old, new))
        assert torch.equal(now[[0, 2]], old[[0, 2]])  # kept: the third and fourth of the list
        assert torch.equal(now[[1, 3, 4]], new[[1, 3, 4]])  # reset, and beyond the places
    assert torch.equal(tensors[-1], changed[-1])
