# SPDX-License-Identifier: Apache-2.0
"""Output block: copies of all results of a step at once, tensors of the log among them."""

from __future__ import annotations

import torch
import warp as wp

from stripe_newton.envs.output_block import OutputBlock

wp.init()


def test_results_are_copies_that_share_one_block():
    block = OutputBlock(4, "cpu")
    reward, obs = block.reserve("reward", wp.float32, (4,)), block.reserve("obs", wp.float32, (4, 2, 3))
    ended = block.reserve("ended", wp.bool, (4,))
    wp.to_torch(reward)[:] = torch.arange(4.0)
    wp.to_torch(obs)[:] = torch.arange(24.0).reshape(4, 2, 3)
    wp.to_torch(ended)[2] = True
    found = block.take()
    for array in (reward, obs, ended):
        array.zero_()
    assert found["reward"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert torch.equal(found["obs"], torch.arange(24.0).reshape(4, 2, 3))
    assert found["obs"].is_contiguous()
    assert found["ended"].tolist() == [False, False, True, False]
    assert len({t.untyped_storage().data_ptr() for t in found.values()}) == 1
    assert block.take()["reward"].untyped_storage().data_ptr() != found["reward"].untyped_storage().data_ptr()
    assert block.views()["ended"].data_ptr() == ended.ptr
    assert block.arrays == {"reward": reward, "obs": obs, "ended": ended}


def test_an_array_larger_than_the_block_gets_another():
    block = OutputBlock(2, "cpu")
    block.reserve("small", wp.bool, (3,))
    large = block.reserve("large", wp.float32, (2, 50_001))
    wp.to_torch(large)[1, 50_000] = 7.0
    assert block.take()["large"][1, 50_000] == 7.0


def test_tensors_of_the_log_are_in_the_block():
    block = OutputBlock(4, "cpu")
    block.reserve("reward", wp.float32, (4,))
    block.prepare()  # before anything is logged
    mean, count = block.reserve_logged(torch.tensor(0.5)), block.reserve_logged(torch.tensor(3))
    large = block.reserve_logged(torch.zeros(5000)).zero_()
    other = torch.tensor([1.0, 2.0])
    mean.fill_(0.25)
    count.fill_(9)
    log = block.copies({"mean": mean, "count": count, "other": other, "large": large, "text": "a"}, block.take())
    for tensor in (mean, count, other, large):
        tensor.fill_(-1)
    assert (log["mean"], log["count"], log["text"]) == (torch.tensor(0.25), torch.tensor(9), "a")
    assert log["mean"].shape == log["count"].shape == ()
    assert log["count"].dtype == torch.int64
    assert log["other"].tolist() == [1.0, 2.0]
    assert float(log["large"].abs().max()) == 0.0
    assert set(block.arrays) == {"reward"}  # what only hooks write is compared with the hooks elsewhere
