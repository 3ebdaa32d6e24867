# SPDX-License-Identifier: Apache-2.0
"""Quaternions of the Isaac Lab dialect: order, and tensors that refuse to be written."""

import pytest
import torch
from scipy.spatial.transform import Rotation

from stripe_newton.isaaclab.quaternions import ReadOnlyTensor, pose_to_wxyz, pose_to_xyzw, to_wxyz, to_xyzw


def test_orders_are_those_of_scipy():
    rotations = Rotation.random(5, random_state=0)
    xyzw = torch.from_numpy(rotations.as_quat())
    assert torch.equal(to_wxyz(xyzw), torch.from_numpy(rotations.as_quat(scalar_first=True)))
    assert torch.equal(to_xyzw(to_wxyz(xyzw)), xyzw)
    state = torch.cat((torch.rand(5, 3), xyzw, torch.rand(5, 6)), dim=-1)
    assert torch.equal(pose_to_wxyz(state)[:, 3:7], to_wxyz(xyzw))
    assert torch.equal(pose_to_xyzw(pose_to_wxyz(state)), state)


@pytest.mark.parametrize(
    "write",
    [
        lambda q: q.zero_(),
        lambda q: q.__setitem__((slice(None), 0), 1.0),
        lambda q: q[:, 0].fill_(1.0),
        lambda q: q[:, :2].add_(1.0),
        lambda q: q.view(-1).mul_(2.0),
        lambda q: q.__iadd__(1.0),
        lambda q: torch.add(q, 1.0, out=q),
        lambda q: [part.zero_() for part in q.unbind(0)],
    ],
    ids=["method", "item", "view of a column", "view of columns", "reshaped", "operator", "out", "unbound"],
)
def test_what_is_converted_refuses_to_be_written(write):
    quat = to_wxyz(torch.tensor([[0.0, 0.0, 0.0, 1.0]]))
    with pytest.raises(RuntimeError, match="clone"):
        write(quat)
    assert quat.tolist() == [[1.0, 0.0, 0.0, 0.0]]


def test_what_is_computed_from_it_is_plain():
    quat = to_wxyz(torch.tensor([[0.0, 0.0, 0.0, 1.0]]))
    for value in (quat.clone(), quat + 1.0, quat[torch.tensor([0])], torch.cat((quat, quat))):
        assert type(value) is torch.Tensor
        value.zero_()
    assert isinstance(quat[:, 1:], ReadOnlyTensor)
