# SPDX-License-Identifier: Apache-2.0
"""What projects on Isaac Lab import beside its tasks: the template's extension, buffers, types, files of robots."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

from stripe_newton import isaaclab
from stripe_newton.configclass import ConfigError
from stripe_newton.isaaclab.buffers import CircularBuffer, DelayBuffer
from stripe_newton.isaaclab.dictionaries import class_to_dict, update_class_from_dict
from stripe_newton.isaaclab.file_spawners import MjcfFileCfg, UrdfConverterCfg, UrdfFileCfg
from stripe_newton.isaaclab.manager_base import ManagerBase
from stripe_newton.isaaclab.mdp import UniformPoseCommandCfg
from stripe_newton.isaaclab.mdp.events import _randomize_prop_by_op as randomize
from stripe_newton.isaaclab.rl_configs import RslRlOnPolicyRunnerCfg
from stripe_newton.isaaclab.scene_entity import SceneEntityCfg
from stripe_newton.isaaclab.skrl_configs import runner_of_skrl
from stripe_newton.rl import RslRlMLPModelCfg, RslRlPpoAlgorithmCfg

DriveCfg = UrdfConverterCfg.JointDriveCfg


@pytest.fixture
def dialect():
    isaaclab.install()
    yield
    isaaclab.uninstall()


def test_the_extension_of_a_template_project_loads(dialect):
    import omni.ext

    class Extension(omni.ext.IExt):
        def on_startup(self, ext_id: str) -> None:
            self.window = omni.ui.Window("Title", width=300)

    Extension().on_startup("my.extension")


# -- buffers


def test_a_history_is_filled_by_the_first_entry_after_a_reset():
    buffer = CircularBuffer(3, 2, "cpu")
    for value in (1.0, 2.0):
        buffer.append(torch.full((2, 1), value))
    assert buffer.buffer[0, :, 0].tolist() == [1.0, 1.0, 2.0]  # the oldest first
    buffer.reset([1])
    assert buffer.buffer[1].abs().sum() == 0
    buffer.append(torch.full((2, 1), 3.0))
    assert buffer.buffer[..., 0].tolist() == [[1.0, 2.0, 3.0], [3.0, 3.0, 3.0]]
    assert buffer.current_length.tolist() == [3, 1]
    assert buffer[torch.tensor([1, 2])][:, 0].tolist() == [2.0, 3.0]  # no entry is older than the reset
    with pytest.raises(ValueError, match="1 rows, the buffer has 2"):
        buffer.append(torch.zeros(1, 1))


def test_a_stream_is_delayed_by_the_lag_of_each_row():
    delay = DelayBuffer(2, 3, "cpu")
    delay.set_time_lag(torch.tensor([0, 1, 2]))
    out = [delay.compute(torch.full((3,), float(i))).tolist() for i in range(4)]
    assert out == [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 1.0, 0.0], [3.0, 2.0, 1.0]]
    assert (delay.min_time_lag, delay.max_time_lag) == (0, 2)
    with pytest.raises(ValueError, match="must be from 0 to history_length, which is 2"):
        delay.set_time_lag(3, [0])


# -- dicts


def test_objects_become_dicts_and_are_changed_by_them():
    class Inner:
        def __init__(self) -> None:
            self.gain, self.limits = 1.0, (0.0, 1.0)

    class Outer:
        def __init__(self) -> None:
            self.inner, self.function, self.names = Inner(), math.cos, ["a"]

    outer = Outer()
    assert class_to_dict(outer) == {
        "inner": {"gain": 1.0, "limits": (0.0, 1.0)}, "function": "math:cos", "names": ["a"],
    }  # fmt: skip
    update_class_from_dict(outer, {"inner": {"gain": 2, "limits": [0.5, 0.6]}, "function": "math:sin"})
    assert (outer.inner.gain, outer.inner.limits, outer.function) == (2, (0.5, 0.6), math.sin)
    with pytest.raises(KeyError, match="/inner/gian"):
        update_class_from_dict(outer, {"inner": {"gian": 2}})


# -- files of robots


def urdf(folder: Path, **fields: object) -> UrdfFileCfg:
    (folder / "robot.urdf").write_text("<robot name='r'><link name='base'/></robot>")
    return UrdfFileCfg(asset_path=str(folder / "robot.urdf"), fix_base=True, **fields)


def test_a_urdf_file_is_read_with_isaac_labs_defaults_and_gains(tmp_path):
    options = urdf(tmp_path).importer_options()
    assert (options["collapse_fixed_joints"], options["enable_self_collisions"], options["scale"]) == (True, False, 1.0)
    gains = DriveCfg.PDGainsCfg(stiffness={".*": 5.0}, damping=0.1)
    options = urdf(tmp_path, scale=(2.0, 2.0, 2.0), joint_drive=DriveCfg(gains=gains)).importer_options()
    assert (options["scale"], options["joint_stiffness"], options["joint_damping"]) == (2.0, {".*": 5.0}, 0.1)
    options = urdf(tmp_path, joint_drive=DriveCfg(gains=gains, target_type="velocity")).importer_options()
    assert (options["joint_stiffness"], options["joint_damping"]) == (0.0, {".*": 5.0})


def test_drives_that_are_not_read_are_refused_by_name(tmp_path):
    frequency = DriveCfg.NaturalFrequencyGainsCfg(natural_frequency=3.0)
    with pytest.raises(ConfigError, match=r"joint_drive\.gains: is NaturalFrequencyGainsCfg"):
        urdf(tmp_path, joint_drive=DriveCfg(gains=frequency)).validate()
    with pytest.raises(ConfigError, match=r"drive_type: is 'acceleration', must be 'force'"):
        urdf(tmp_path, joint_drive=DriveCfg(drive_type="acceleration")).validate()
    with pytest.raises(ConfigError, match="the same number in x, y and z"):
        urdf(tmp_path, scale=(1.0, 2.0, 1.0)).validate()


def test_an_mjcf_file_is_read_with_isaac_labs_defaults(tmp_path):
    (tmp_path / "robot.xml").write_text("<mujoco/>")
    options = MjcfFileCfg(asset_path=str(tmp_path / "robot.xml"), fix_base=False).importer_options()
    assert (options["enable_self_collisions"], options["floating"], options["scale"]) == (False, True, 1.0)


# -- configs of terms and learners


def test_a_body_may_be_named_by_a_list():
    ranges = UniformPoseCommandCfg.Ranges(*[(0.0, 0.1)] * 6)
    cfg = UniformPoseCommandCfg(asset_name="robot", resampling_time_range=(1.0, 1.0), ranges=ranges, body_name=["hand"])
    cfg.validate()


SKRL_AGENT = {
    "class": "PPO", "rollouts": 8, "learning_epochs": 4, "mini_batches": 2, "discount_factor": 0.99, "lambda": 0.95,
    "learning_rate": 1e-3, "grad_norm_clip": 1.0, "ratio_clip": 0.2, "clip_predicted_values": True,
    "entropy_loss_scale": 0.0, "value_loss_scale": 1.0, "experiment": {"directory": "reach"},
}  # fmt: skip


def skrl_config(policy_input: str, value_input: str) -> dict[str, object]:
    def model(kind: str, text: str) -> dict[str, object]:
        return {"class": kind, "network": [{"name": "net", "input": text, "layers": [8], "activations": "elu"}]}

    models = {"policy": model("GaussianMixin", policy_input), "value": model("DeterministicMixin", value_input)}
    return {"models": models, "agent": SKRL_AGENT, "trainer": {"timesteps": 80}}


def test_skrl_1_calls_the_observations_states():
    old, new = (runner_of_skrl(skrl_config(text, text), "agent") for text in ("STATES", "OBSERVATIONS"))
    assert (old.actor.to_dict(), old.critic.to_dict()) == (new.actor.to_dict(), new.critic.to_dict())
    with pytest.raises(ConfigError, match="a network over STATES is not translated"):  # those of skrl 2
        runner_of_skrl(skrl_config("OBSERVATIONS", "STATES"), "agent")


def test_an_agent_may_have_an_actor_and_a_critic():
    network = RslRlMLPModelCfg(hidden_dims=(8,), activation="elu")
    run = {"num_steps_per_env": 8, "max_iterations": 3, "save_interval": 1, "experiment_name": "x"}
    groups = {"actor": ["policy"], "critic": ["state"]}
    cfg = RslRlOnPolicyRunnerCfg(
        **run, actor=network, critic=network, algorithm=RslRlPpoAlgorithmCfg(), obs_groups=groups
    ).to_native()
    assert (cfg.actor.hidden_dims, cfg.critic.hidden_dims, cfg.obs_groups) == ((8,), (8,), groups)
    with pytest.raises(ConfigError, match="actor: and critic must both be given"):
        RslRlOnPolicyRunnerCfg(**run, actor=network, algorithm=RslRlPpoAlgorithmCfg()).to_native()


# -- managers and events that a project writes itself


def test_rows_and_columns_are_randomised():
    data = torch.ones(3, 4)
    at = torch.tensor([0, 2]), torch.tensor([1, 3])
    randomize(data, (2.0, 2.0 + 1e-6), *at, operation="scale", distribution="uniform")
    expected = torch.ones(3, 4)
    expected[0, [1, 3]] = expected[2, [1, 3]] = 2.0
    torch.testing.assert_close(data, expected)
    randomize(data, (0.5, 0.5 + 1e-6), None, slice(None), operation="add", distribution="uniform")
    torch.testing.assert_close(data, expected + 0.5)
    with pytest.raises(NotImplementedError, match="operation: is 'set'"):
        randomize(data, (0.0, 1.0), None, slice(None), operation="set", distribution="uniform")


def test_a_manager_of_a_project_finds_its_terms():
    class Manager(ManagerBase):
        def _prepare_terms(self) -> None:
            self.terms = dict(self.cfg)
            for name, term in self.terms.items():
                self._resolve_common_term_cfg(name, term)

        @property
        def active_terms(self) -> list[str]:
            return list(self.terms)

    env = SimpleNamespace(num_envs=3, device="cpu", scene={})
    manager = Manager({"height": SimpleNamespace(func="math:cos", params={})}, env)
    assert (manager.terms["height"].func, manager.num_envs, manager.find_terms("h.*")) == (math.cos, 3, ["height"])
    term = SimpleNamespace(func=math.cos, params={"asset_cfg": SceneEntityCfg("robot")})
    with pytest.raises(ValueError, match=r"speed\.params\.asset_cfg: 'robot'"):
        Manager({"speed": term}, env)
