# SPDX-License-Identifier: Apache-2.0
"""FlatAdam against torch's optimisers and its clipping of gradients."""

import copy

import pytest
import torch

from stripe_newton.rl.graphs.flat_adam import FlatAdam

RATE = 3.0e-3


def networks(shares: bool = False) -> torch.nn.ModuleList:
    torch.manual_seed(1)
    encoder = torch.nn.Linear(4, 3)
    heads = [torch.nn.Sequential(encoder if shares else torch.nn.Linear(4, 3), torch.nn.Linear(3, n)) for n in (2, 1)]
    heads[0][1].bias.requires_grad = False
    return torch.nn.ModuleList(heads)


def made(kind: type[torch.optim.Optimizer], nets: torch.nn.ModuleList) -> torch.optim.Optimizer:
    return kind(list(nets.parameters()), lr=RATE)


def flat(optimizer: torch.optim.Optimizer, nets: torch.nn.ModuleList) -> FlatAdam:
    return FlatAdam(optimizer, *nets, torch.tensor(RATE, dtype=torch.float64), max_norm=1.0)


def gradients(nets: torch.nn.ModuleList, index: int) -> list[torch.Tensor]:
    torch.manual_seed(index)
    # Some are clipped and some are not.
    return [torch.randn_like(p) * 0.2 * index for p in nets.parameters() if p.requires_grad]


def run(nets: torch.nn.ModuleList, optimizer: torch.optim.Optimizer, adam: FlatAdam | None, steps: range) -> None:
    for index in steps:
        for parameter, value in zip(
            [p for p in nets.parameters() if p.requires_grad], gradients(nets, index), strict=True
        ):
            if parameter.grad is None:
                parameter.grad = value
            else:
                parameter.grad.copy_(value)
        if adam is not None:
            adam.step()
            continue
        for net in nets:
            torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()


@pytest.mark.parametrize("kind", [torch.optim.Adam, torch.optim.AdamW])
@pytest.mark.parametrize("shares", [False, True])
def test_steps_are_those_of_torch(kind, shares):
    theirs, ours = networks(shares), networks(shares)
    their_optimizer, our_optimizer = made(kind, theirs), made(kind, ours)
    run(theirs, their_optimizer, None, range(1, 8))
    run(ours, our_optimizer, flat(our_optimizer, ours), range(1, 8))
    for one, two in zip(theirs.parameters(), ours.parameters(), strict=True):
        torch.testing.assert_close(two, one, rtol=1.0e-6, atol=1.0e-7)
    for one, two in zip(their_optimizer.state.values(), our_optimizer.state.values(), strict=True):
        torch.testing.assert_close(two, one, rtol=1.0e-6, atol=1.0e-7, check_device=False)


def test_a_saved_state_goes_on():
    whole, halves = networks(), networks()
    optimizer = made(torch.optim.Adam, whole)
    run(whole, optimizer, flat(optimizer, whole), range(1, 6))
    first = made(torch.optim.Adam, halves)
    run(halves, first, flat(first, halves), range(1, 4))
    saved = copy.deepcopy((halves.state_dict(), first.state_dict()))
    resumed = networks()
    second = made(torch.optim.Adam, resumed)
    adam = flat(second, resumed)
    run(resumed, second, adam, range(4, 6))  # of another run: everything of it is replaced
    resumed.load_state_dict(saved[0])
    second.load_state_dict(saved[1])
    adam.take_state()
    run(resumed, second, adam, range(4, 6))
    for one, two in zip(whole.parameters(), resumed.parameters(), strict=True):
        torch.testing.assert_close(two, one, rtol=0.0, atol=0.0)
