# SPDX-License-Identifier: Apache-2.0
"""Actuator networks, against torch running the same network; errors of files that are refused."""

from __future__ import annotations

import copy
import json
from pathlib import Path

import numpy as np
import onnx
import pytest
import torch
from onnx import TensorProto, helper

from stripe_newton.actuators import ActuatorNetLSTMCfg, ActuatorNetMLPCfg
from stripe_newton.actuators.network_files import prepare_lstm, prepare_mlp
from stripe_newton.configclass import ConfigError
from tests.helpers.actuator_world import Drill, actuator_scene, reset_mask
from tests.helpers.small_scenes import numpy

N = 3
LIMIT = 2.5


class Memory(torch.nn.Module):
    """As actuator networks for Isaac Lab are saved: effort, (h, c) = net(input, (h, c))."""

    def __init__(self, layers: int, batch_first: bool, hidden: int = 8):
        super().__init__()
        torch.manual_seed(layers)
        self.lstm = torch.nn.LSTM(2, hidden, layers, batch_first=batch_first)
        self.out = torch.nn.Linear(hidden, 1)
        torch.nn.init.normal_(self.out.weight, std=15.0)
        self.time = 1 if batch_first else 0

    def forward(self, x: torch.Tensor, state: tuple[torch.Tensor, torch.Tensor]):
        y, state = self.lstm(x, state)
        return self.out(y.select(self.time, -1)), state


class Bent(Memory):
    def forward(self, x: torch.Tensor, state: tuple[torch.Tensor, torch.Tensor]):
        y, state = self.lstm(x, state)
        return torch.tanh(self.out(y.select(self.time, -1))), state


def dense(inputs: int, outputs: int = 1) -> torch.nn.Module:
    torch.manual_seed(inputs)
    net = torch.nn.Sequential(
        torch.nn.Linear(inputs, 16), torch.nn.Softsign(), torch.nn.Linear(16, 16), torch.nn.ELU(),
        torch.nn.Linear(16, outputs),
    )  # fmt: skip
    torch.nn.init.normal_(net[0].weight, std=2.0)
    return net


def saved(net: torch.nn.Module, path) -> str:
    torch.jit.script(net).save(str(path))
    return str(path)


def drive(scene, substeps, law, reset):
    """Random states and targets; ``law(q, v, target)`` for each physics step, in float64, against what is given."""
    drill, robot = Drill(scene), scene["robot"]
    bound = 0
    for step, count in enumerate(substeps):
        if step == len(substeps) // 2:
            scene.sim.clear_solver(reset_mask(scene, [1]))
            reset(1)
        drill.targets()
        drill.state()
        target = numpy(robot.data.joint_pos_target)
        for index in range(count):  # as Simulation.launch does
            before = numpy(robot.data.joint_pos), numpy(robot.data.joint_vel)
            scene.sim.actuation.launch(index, last=index == count - 1)
            asked = law(*before, target)
            np.testing.assert_allclose(numpy(robot.data.computed_torque), asked, rtol=2e-4, atol=2e-4)
            scene.sim._physics.launch_after_actuators()
        np.testing.assert_allclose(
            numpy(robot.data.applied_torque), np.clip(asked, -LIMIT, LIMIT), rtol=2e-4, atol=2e-4
        )
        bound += int((np.abs(asked) > LIMIT).sum())
    assert bound


@pytest.mark.parametrize(
    ("layers", "batch_first", "substeps"), [(1, True, [1] * 8), (2, True, [1, 2, 3, 4, 1, 2]), (2, False, [3, 3])]
)
def test_lstm(tmp_path, layers, batch_first, substeps):
    """Two joints share the network, each with a memory of its own in each environment."""
    net = Memory(layers, batch_first)
    file = saved(net, tmp_path / "net.pt")
    cfg = ActuatorNetLSTMCfg(joint_names_expr=["a", "b"], network_file=file, effort_limit=LIMIT)
    scene = actuator_scene(tmp_path, {"net": cfg}, ["a", "b"], num_envs=N)
    exact = copy.deepcopy(net).double()
    state = [torch.zeros(layers, 2 * N, 8, dtype=torch.float64) for _ in range(2)]

    def law(q, v, target):
        rows = torch.from_numpy(np.stack([target - q, v], axis=-1).reshape(2 * N, 2))
        with torch.no_grad():
            effort, new = exact(rows.unsqueeze(1 if batch_first else 0), tuple(state))
        state[:] = new
        return effort.reshape(N, 2).numpy()

    def reset(env):
        for part in state:
            part[:, 2 * env : 2 * env + 2] = 0.0

    drive(scene, substeps, law, reset)
    assert scene["robot"].data.joint_stiffness.abs().max() == 0.0


@pytest.mark.parametrize(
    ("order", "idx", "substeps"), [("pos_vel", [0, 2, 4], [1, 3, 2, 1, 4, 2]), ("vel_pos", [0, 1], [2, 2, 1, 1])]
)
def test_mlp(tmp_path, order, idx, substeps):
    net = dense(2 * len(idx))
    scales = {"pos_scale": 4.0, "vel_scale": 0.3, "torque_scale": 40.0}
    cfg = ActuatorNetMLPCfg(
        joint_names_expr=[".*"], network_file=saved(net, tmp_path / "net.pt"), effort_limit=LIMIT, input_order=order,
        input_idx=idx, **scales,
    )  # fmt: skip
    scene = actuator_scene(tmp_path, {"net": cfg}, ["a", "b"], num_envs=N)
    exact, past = net.double(), [np.zeros((N, 2, 2)) for _ in range(max(idx))]

    def law(q, v, target):
        past.insert(0, np.stack([target - q, v], axis=-1))
        error, speed = (np.stack([past[i][..., k] for i in idx], axis=-1) for k in range(2))
        parts = [error * scales["pos_scale"], speed * scales["vel_scale"]]
        rows = np.concatenate(parts if order == "pos_vel" else parts[::-1], axis=-1)
        with torch.no_grad():
            return exact(torch.from_numpy(rows))[..., 0].numpy() * scales["torque_scale"]

    def reset(env):
        for row in past:
            row[env] = 0.0

    drive(scene, substeps, law, reset)


def test_the_torque_speed_curve_holds_for_networks_too(tmp_path):
    net = torch.nn.Linear(2, 1)
    torch.nn.init.constant_(net.weight, 1000.0)
    file = saved(net, tmp_path / "net.pt")
    kinds = {
        "a": ActuatorNetMLPCfg(
            joint_names_expr=["a"], network_file=file, effort_limit=6.0, saturation_effort=9.0, velocity_limit=2.0
        )
    }
    scene = actuator_scene(tmp_path, kinds, ["a"], num_envs=N)
    robot = scene["robot"]
    robot.write_joint_state_to_sim(torch.zeros(N, 1), torch.tensor([[0.0], [1.0], [2.0]]))
    robot.set_joint_position_target(torch.ones(N, 1))
    scene.sim.actuation.launch()
    assert robot.data.applied_torque[:, 0].tolist() == pytest.approx([6.0, 4.5, 0.0], abs=1e-5)
    assert (robot.data.computed_torque > 900.0).all()


def test_onnx_files_and_their_metadata(tmp_path):
    """A file of Newton's own kind goes in as it is; what the config says overrules its metadata."""
    made = prepare_mlp(saved(dense(4), tmp_path / "net.pt"), input_idx=[0, 3], pos_scale=2.0)
    assert made == prepare_mlp(str(tmp_path / "net.pt"), input_idx=[0, 3], pos_scale=2.0)
    again = prepare_mlp(str(made), vel_scale=7.0)
    said = json.loads({p.key: p.value for p in onnx.load(again).metadata_props}["metadata"])
    assert said == {
        "input_order": "pos_vel", "input_idx": [0, 3], "pos_scale": 2.0, "effort_scale": 1.0, "vel_scale": 7.0,
        "model_type": "mlp",
    }  # fmt: skip
    lstm = prepare_lstm(saved(Memory(2, True), tmp_path / "lstm.pt"))
    plain = onnx.load(lstm)
    del plain.metadata_props[:]
    onnx.save(plain, tmp_path / "plain.onnx")
    said = json.loads(
        {p.key: p.value for p in onnx.load(prepare_lstm(str(tmp_path / "plain.onnx"))).metadata_props}["metadata"]
    )
    assert said["num_layers"] == 1
    assert said["hidden_size"] == 16
    assert [said[k] for k in ("input_name", "hidden_in_name", "cell_out_name")] == ["input", "h", "c_out"]


# -- files that are refused


def wrong_files(folder) -> dict[str, tuple[str, str]]:
    """By name: the file and what the error says."""
    (folder / "text.pt").write_text("no network")
    (folder / "text.onnx").write_text("no network")
    torch.save({"w": torch.zeros(2)}, folder / "dict.pt")
    value = helper.make_tensor_value_info
    node = helper.make_node("NonZero", ["x"], ["y"])
    graph = helper.make_graph(
        [node], "g", [value("x", TensorProto.FLOAT, (None, 2))], [value("y", TensorProto.FLOAT, (None, 1))]
    )
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)]), folder / "odd.onnx")
    return {
        "nowhere": (str(folder / "nowhere.pt"), "does not exist"),
        "suffix": (__file__, r"'.py' is no known format, there are ONNX"),
        "text.pt": (str(folder / "text.pt"), "it is no file of torch"),
        "text.onnx": (str(folder / "text.onnx"), "it is no ONNX model"),
        "dict": (str(folder / "dict.pt"), "it is no TorchScript; write it by torch.jit.save"),
        "odd": (str(folder / "odd.onnx"), r"(?s)Warp-NN cannot run it: .*NonZero"),
        "wide": (saved(dense(6), folder / "wide.pt"), r"does not take an input of shape \(1, 2\)"),
        "many": (saved(dense(2, 3), folder / "many.pt"), r"outputs have shapes \(n, 3\); input_idx .* needs \(n, 1\)"),
    }


@pytest.mark.parametrize("kind", ["nowhere", "suffix", "text.pt", "text.onnx", "dict", "odd", "wide", "many"])
def test_files_that_are_no_such_network(tmp_path, kind):
    file, message = wrong_files(tmp_path)[kind]
    with pytest.raises(ValueError, match=message):
        prepare_mlp(file)


def test_a_wrong_file_is_reported_with_its_group(tmp_path):
    cfg = ActuatorNetMLPCfg(joint_names_expr=["a"], network_file="nowhere.onnx")
    with pytest.raises(ConfigError, match=r"actuators.net: network_file 'nowhere.onnx': does not exist"):
        actuator_scene(tmp_path, {"net": cfg}, ["a"])


def test_recurrent_networks_that_are_no_lstm_and_linear_layer(tmp_path):
    with pytest.raises(ValueError, match=r"must be one LSTM .*it has 0.weight \(16, 2\), "):
        prepare_lstm(saved(dense(2), tmp_path / "dense.pt"))
    with pytest.raises(ValueError, match="linear layer alone, and is not: the converted network gives"):
        prepare_lstm(saved(Bent(1, True), tmp_path / "bent.pt"))
    with pytest.raises(ValueError, match=r"inputs have shapes \(n, 4\); an LSTM needs \(n, n, 2\)"):
        prepare_lstm(str(prepare_mlp(saved(dense(4), tmp_path / "net.pt"), input_idx=[0, 1])))


class WritesWhenCalled(torch.nn.Module):
    """Network that writes a file in each pass."""

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x[:, :1] + torch.from_file("written", shared=True, size=1, dtype=torch.float32).fill_(7.0)


class WritesWhenRead(torch.nn.Module):
    """Network that writes a file when it is read."""

    @torch.jit.export
    def __getstate__(self) -> tuple[torch.Tensor, bool]:
        return torch.zeros(1), self.training

    @torch.jit.export
    def __setstate__(self, state: tuple[torch.Tensor, bool]) -> None:
        torch.from_file("written", shared=True, size=1, dtype=torch.float32).fill_(7.0)
        self.training = state[1]

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return x[:, :1]


@pytest.mark.parametrize(
    ("network", "message"),
    [(WritesWhenCalled(), "operator 'aten::from_file'"), (WritesWhenRead(), "it runs code of its own when it is read")],
)
def test_a_network_that_writes_files_is_refused(network, message):
    torch.jit.script(network).save("network.pt")
    with pytest.raises(ValueError, match=message):
        prepare_mlp("network.pt")
    assert not Path("written").exists()
