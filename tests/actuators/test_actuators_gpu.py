# SPDX-License-Identifier: Apache-2.0
"""Actuators on a GPU: a recorded and replayed graph gives the same as single kernels."""

from __future__ import annotations

import pytest
import torch
import warp as wp

from stripe_newton.actuators import ActuatorNetLSTMCfg, ActuatorNetMLPCfg
from stripe_newton.envs.call_counts import warp_calls
from stripe_newton.sim.capture import capture_graph
from tests.helpers.actuator_world import JOINTS, KINDS, Drill, actuator_scene, reset_mask
from tests.helpers.small_scenes import sim_cfg

pytestmark = pytest.mark.gpu

DEVICE = "cuda:0"


class Memory(torch.nn.Module):
    def __init__(self):
        super().__init__()
        torch.manual_seed(0)
        self.lstm, self.out = torch.nn.LSTM(2, 8, 2, batch_first=True), torch.nn.Linear(8, 1)

    def forward(self, x: torch.Tensor, state: tuple[torch.Tensor, torch.Tensor]):
        y, state = self.lstm(x, state)
        return self.out(y[:, -1]), state


@pytest.fixture(scope="module")
def kinds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("networks")
    torch.jit.script(Memory()).save(str(folder / "lstm.pt"))
    dense = torch.nn.Sequential(torch.nn.Linear(6, 32), torch.nn.Softsign(), torch.nn.Linear(32, 1))
    torch.jit.script(dense).save(str(folder / "mlp.pt"))
    limits = {"effort_limit": 4.0, "saturation_effort": 9.0, "velocity_limit": 5.0}
    return KINDS | {
        "lstm": ActuatorNetLSTMCfg(joint_names_expr=["lstm"], network_file=str(folder / "lstm.pt"), **limits),
        "mlp": ActuatorNetMLPCfg(
            joint_names_expr=["mlp"], network_file=str(folder / "mlp.pt"), input_idx=[0, 1, 2], **limits
        ),
    }


@pytest.mark.parametrize("substeps", [1, 4])
def test_replayed_actuators_equal_eager_ones(tmp_path, kinds, substeps):
    """All kinds with resets by mask in graphs of their own, some environments at a time."""
    results = []
    for graph in (True, False):
        cfg = sim_cfg(device=DEVICE, use_cuda_graph=graph)
        scene = actuator_scene(tmp_path, kinds, [*JOINTS, "lstm", "mlp"], num_envs=64, sim=cfg)
        sim, drill = scene.sim, Drill(scene)
        mask = reset_mask(scene, [1, 40])
        sim.step(substeps)
        sim.clear_solver(mask)
        reset = capture_graph(DEVICE, lambda s=sim, m=mask: s.clear_solver(m)) if graph else None
        for step in range(12):
            drill.targets()
            sim.step(substeps)
            if step % 5 == 3:
                if reset is None:
                    sim.clear_solver(mask)
                else:
                    wp.capture_launch(reset)
        with warp_calls() as counts:
            sim.step(substeps)
        assert counts["graph_launches"] == int(graph)
        if graph:
            assert counts["kernel_launches"] == 0
        data = scene["robot"].data
        results.append([data.joint_pos.clone(), data.computed_torque.clone(), data.applied_torque.clone()])
        results[-1] += [torch.from_numpy(a.numpy()) for a in sim.actuation.arrays.values()]
    for replayed, eager in zip(*results, strict=True):
        assert torch.equal(replayed, eager)
