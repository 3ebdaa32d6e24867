# SPDX-License-Identifier: Apache-2.0
"""Recorder manager: recorded files, read with plain h5py and compared with known values, and replayed."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from stripe_newton.configclass import ConfigError, configclass, to_dict
from stripe_newton.fusion import HostFunction
from stripe_newton.managers import DatasetExportMode, RecorderManagerBaseCfg, RecorderTermCfg
from stripe_newton.managers.episode_file import EpisodeFile
from stripe_newton.managers.recorder_manager import RecorderManager
from stripe_newton.managers.recorders import ActionStateRecorderManagerCfg, RecorderTerm
from tests.helpers.manager_world import manager_context, plan, set_reset
from tests.helpers.recorder_world import ACTIONS, ENVS, QUAT, World, number, read, settings

MODES = DatasetExportMode


def test_layout_and_values():
    world = World(settings())
    world.reset()
    world.step(3, lengths=[3, 99, 99])
    world.manager.close()
    episodes = read()
    assert episodes.keys() == {"demo_0"}
    found = episodes["demo_0"]
    root = {"root_pose", "root_velocity"}
    state = {f"articulation/robot/{k}" for k in (*root, "joint_position", "joint_velocity")}
    state |= {f"rigid_object/box/{k}" for k in root}
    expected = {"attrs", "actions", "processed_actions", "obs/policy"}
    assert found.keys() == expected | {f"{k}/{s}" for k in ("states", "initial_state") for s in state}
    assert found["attrs"] == {"num_samples": 3, "seed": 42, "success": False, "env_index": 0}
    # it was the first episode after a reset: episode 1 of environment 0; observations and actions are of steps 0 to 2,
    # states and what came of the actions of steps 1 to 3
    np.testing.assert_array_equal(found["actions"], [[10.25, 10.5], [11.25, 11.5], [12.25, 12.5]])
    np.testing.assert_array_equal(found["obs/policy"], [[10.125], [11.125], [12.125]])
    np.testing.assert_array_equal(found["processed_actions"], [[22.0], [24.0], [26.0]])
    np.testing.assert_array_equal(found["states/articulation/robot/joint_velocity"][:, 1], [-12.0, -13.0, -14.0])
    np.testing.assert_array_equal(found["states/rigid_object/box/root_velocity"], np.full((3, 6), [[11], [12], [13]]))
    np.testing.assert_array_equal(found["initial_state/articulation/robot/joint_position"], [[10, 11, 12, 13]])
    np.testing.assert_allclose(found["initial_state/rigid_object/box/root_pose"], [[10, 10, 10, *QUAT]], rtol=1e-6)
    assert found["actions"].dtype == np.float32


def test_what_robomimic_and_isaac_lab_read():
    h5py = pytest.importorskip("h5py")
    world = World(settings())
    world.reset()
    world.step(5, lengths=[2, 3, 5])
    world.manager.close()
    with h5py.File("out/toy.hdf5", "r", swmr=True, libver="latest") as file:  # as robomimic's SequenceDataset opens it
        assert file.attrs["format_version"] == 1
        data = file["data"]
        args = json.loads(data.attrs["env_args"])
        assert args["env_name"] == "Toy-v0"
        assert (args["type"], args["env_kwargs"]) == (2, {})
        sim = world.context.scene.sim
        assert args["sim_args"] == {"dt": sim.physics_dt, "decimation": 2, "render_interval": 1, "num_envs": ENVS}
        assert data.attrs["quat_convention"] == "xyzw"
        assert data.attrs["total"] == sum(g.attrs["num_samples"] for g in data.values()) == 2 + 2 + 3 + 5
        for name, group in data.items():
            assert int(name[5:]) in range(4)
            count = group.attrs["num_samples"]
            assert count >= 1
            assert group["actions"].ndim == 2
            assert [group[key].shape[0] for key in ("actions", "obs/policy", "processed_actions")] == [count] * 3
            assert isinstance(group["obs"], h5py.Group)


def test_episodes_of_different_length_interleaved():
    lengths, steps = [2, 3, 5], 31
    world = World(settings())
    world.reset()
    world.step(steps, lengths=lengths)
    world.manager.close()
    episodes = read()
    per_env: dict[int, list[Any]] = {e: [] for e in range(ENVS)}
    for k in range(len(episodes)):
        per_env[episodes[f"demo_{k}"]["attrs"]["env_index"]].append(episodes[f"demo_{k}"])
    for env, length in enumerate(lengths):
        assert len(per_env[env]) == steps // length
        for k, found in enumerate(per_env[env]):
            at = number(env, 1 + k, np.arange(length))
            np.testing.assert_array_equal(found["actions"], at[:, None] + [0.25, 0.5])
            np.testing.assert_array_equal(found["obs/policy"][:, 0], at + 0.125)
            np.testing.assert_array_equal(found["states/articulation/robot/root_pose"][:, 0], at + 1.0)
            np.testing.assert_array_equal(found["initial_state/articulation/robot/root_pose"][:, 0], at[:1])
    # demo numbers are in the order in which the episodes ended
    ends = [(e["attrs"]["env_index"], e["attrs"]["num_samples"]) for e in map(episodes.get, ("demo_0", "demo_1"))]
    assert ends == [(0, 2), (1, 3)]


def test_episodes_longer_than_expected_are_whole():
    world = World(settings())
    world.reset()
    steps = 2 * world.context.max_episode_length + 7
    world.step(steps, lengths=[steps, 99999, 1])
    world.manager.close()
    found = next(e for e in read().values() if e["attrs"]["env_index"] == 0)
    at = number(0, 1, np.arange(steps))
    np.testing.assert_array_equal(found["actions"][:, 0], at + 0.25)
    np.testing.assert_array_equal(found["states/rigid_object/box/root_pose"][:, 2], at + 1.0)


def test_a_reset_from_outside_ends_episodes_and_what_has_no_step_is_not_written():
    world = World(settings())
    world.reset()
    world.reset()
    world.step(2)
    world.reset([False, True, False])
    world.step(1, lengths=[3, 99, 99])
    world.manager.close()
    samples = {e["attrs"]["env_index"]: e["actions"][:, 0] for e in read().values()}
    assert samples.keys() == {0, 1}
    np.testing.assert_array_equal(samples[1], number(1, 2, np.arange(2)) + 0.25)
    np.testing.assert_array_equal(samples[0], number(0, 2, np.arange(3)) + 0.25)


def test_an_episode_whose_beginning_was_not_seen_is_not_written():
    world = World(settings())
    world.step(2, lengths=[2, 99, 99])
    world.step(2, lengths=[2, 99, 99])
    world.manager.clear([0])
    world.step(2, lengths=[2, 99, 99])
    world.step(2, lengths=[2, 99, 99])
    world.manager.close()
    firsts = [e["actions"][0, 0] - 0.25 for e in read().values()]
    assert firsts == [number(0, 1, 0), number(0, 3, 0)]


@pytest.mark.parametrize(
    ("mode", "written", "failed"),
    [
        (MODES.EXPORT_ALL, {0, 1, 2}, None),
        (MODES.EXPORT_SUCCEEDED_ONLY, {1}, None),
        (MODES.EXPORT_FAILED_ONLY, {0, 2}, None),
        (MODES.EXPORT_SUCCEEDED_FAILED_IN_SEPARATE_FILES, {1}, {0, 2}),
        (MODES.EXPORT_NONE, None, None),
    ],
)
def test_which_episodes_are_written(mode, written, failed):
    world = World(settings(dataset_export_mode=mode), success=[False, True, False])
    world.reset()
    world.step(2, lengths=[2, 2, 2])
    world.manager.close()
    for path, expected in (("out/toy.hdf5", written), ("out/toy_failed.hdf5", failed)):
        assert Path(path).exists() == (expected is not None)
        if expected is not None:
            success = {e["attrs"]["env_index"]: bool(e["attrs"]["success"]) for e in read(path).values()}
            assert success == {env: env == 1 for env in expected}
    assert world.manager.exported_successful_episode_count == 1
    assert world.manager.exported_failed_episode_count == 2


def test_nothing_is_recorded_once_it_is_closed():
    world = World(settings())
    world.reset()
    world.step(2, lengths=[2, 99, 99])
    world.manager.close()
    world.step(4, lengths=[2, 99, 99])
    world.reset()
    world.manager.close()
    assert read().keys() == {"demo_0"}


def test_success_may_be_said_and_episodes_written_by_hand():
    with pytest.warns(UserWarning, match="no termination term 'success'"):
        world = World(settings(dataset_export_mode=MODES.EXPORT_SUCCEEDED_ONLY, export_in_record_pre_reset=False))
    world.reset()
    world.step(3)
    world.manager.record_pre_reset([0, 1], force_export_or_skip=False)
    world.manager.set_success_to_episodes([1], torch.tensor([[True]]))
    assert world.manager.get_episode(1)["actions"].shape == (3, ACTIONS)
    world.manager.export_episodes([0, 1])
    assert world.manager.get_episode(1)["actions"].shape == (0, ACTIONS)
    world.step(2, lengths=[5, 5, 5])  # the rest of those episodes, and one that is dropped since nobody asked for it
    world.step(1, lengths=[1, 1, 1])
    world.manager.close()
    assert [(e["attrs"]["env_index"], e["attrs"]["num_samples"]) for e in read().values()] == [(1, 3)]


def test_success_that_nobody_looked_for_is_not_written():
    world = World(settings())
    world.reset()
    world.step(2)
    world.manager.export_episodes()
    world.manager.close()
    assert [set(e["attrs"]) for e in read().values()] == [{"num_samples", "seed", "env_index"}] * ENVS


class Corners(RecorderTerm):
    """Uses all four points, nested dicts, whole numbers and truth values, and sometimes has nothing to say."""

    def record_pre_step(self):
        even = int(self._env.step[0]) % 2 == 0
        return ("sparse", self._env.step.int()) if even else (None, None)

    def record_post_step(self):
        return "nested/a", {"b": {"odd": self._env.step % 2 == 1}}

    def record_pre_reset(self, env_ids):
        return "last", self._env.sample[env_ids]

    def record_post_reset(self, env_ids):
        assert env_ids.dtype is torch.int64
        return "first", self._env.sample[env_ids]


@configclass
class CornersCfg(RecorderManagerBaseCfg):
    dataset_export_dir_path = "out"
    dataset_filename = "toy.hdf5"
    corners: RecorderTermCfg = RecorderTermCfg(class_type=Corners)


def test_terms_of_ones_own():
    world = World(CornersCfg())
    world.reset()
    world.step(3, lengths=[3, 3, 3])
    world.manager.close()
    found = read()["demo_2"]
    assert found.pop("attrs")["num_samples"] == 3
    at = number(2, 1, 0)
    expected = {"sparse": [0, 2], "nested/a/b/odd": [True, False, True], "first": [at], "last": [at + 3]}
    assert {k: v.tolist() for k, v in found.items()} == expected
    assert found["sparse"].dtype == np.int32


def test_items_say_what_they_wait_for_and_are_only_there_where_needed():
    world = World(settings(record_initial_state=None))
    assert [[i.name for i in items] for items in world.items] == [
        ["recorders_pre_step"],
        ["recorders_post_step"],
        ["recorders_pre_reset"],
        [],
    ]
    assert all(isinstance(i, HostFunction) for items in world.items for i in items)
    assert "waits for the device to say which episodes ended" in world.items[2][0].reason
    assert world.items[0][0].terms == ["record_pre_step_actions", "record_pre_step_flat_policy_observations"]
    assert "out/toy.hdf5" in str(world.manager)
    assert not Path("out").exists()  # made when it runs, not when it is configured


@pytest.mark.parametrize("cfg", [None, {}, RecorderManagerBaseCfg()])
def test_without_terms_there_is_nothing_to_do(cfg):
    world = World(cfg)
    assert world.items == [[], [], [], []]
    world.reset()
    world.step()
    assert not list(Path().iterdir())


def test_observations_by_term():
    world = World(settings())
    world.reset()
    world.owner.obs_buf = {"policy": {"speed": torch.zeros(ENVS, 2), "height": torch.ones(ENVS, 1)}}
    world.step(1, lengths=[1, 1, 1])
    world.manager.close()
    found = read()["demo_0"]
    assert {k: v.shape for k, v in found.items() if k.startswith("obs")} == {"obs/speed": (1, 2), "obs/height": (1, 1)}


def test_rows_that_do_not_fit_are_refused_by_name():
    @configclass
    class WrongCfg(RecorderManagerBaseCfg):
        dataset_export_mode = MODES.EXPORT_NONE
        short: RecorderTermCfg = RecorderTermCfg(
            class_type=type("Short", (RecorderTerm,), {"record_pre_step": lambda self: ("x", torch.zeros(2, 5))})
        )

    world = World(WrongCfg())
    world.reset()
    with pytest.raises(ValueError, match=r"recorders.short: 'x' has shape \(2, 5\), must be \(3, 5\)"):
        world.step()


def test_problems_are_gathered():
    bad = settings(record_initial_state=RecorderTermCfg(class_type=dict), record_post_step_states=3)
    bad.dataset_file_mode, bad.quaternion_order, bad.dataset_export_mode = "a", "ijkr", 7
    bad.dataset_filename = "a/b"
    problems = World(bad).context.problems
    for said in (
        "recorders.record_initial_state.class_type: is <class 'dict'>, must be a subclass of RecorderTerm",
        "recorders.record_post_step_states: is int, must be RecorderTermCfg",
        "recorders.dataset_file_mode: is 'a', must be one of new, append, overwrite",
        "recorders.quaternion_order: is 'ijkr', must be one of xyzw, wxyz",
        "recorders.dataset_export_mode: is 7, must be one of DatasetExportMode: EXPORT_NONE, EXPORT_ALL",
        "recorders.dataset_filename: is 'a/b', must be a name",
    ):
        assert sum(said in p for p in problems) == 1, (said, problems)
    assert len(problems) == 6
    assert World(3.0).context.problems == [
        "recorders: is float, must be a RecorderManagerBaseCfg, a dict of terms or None"
    ]
    with pytest.raises(ConfigError, match="class_type: is missing"):
        ActionStateRecorderManagerCfg(record_initial_state=RecorderTermCfg()).validate()


def test_configs_survive_a_file():
    cfg = settings(dataset_export_mode=MODES.EXPORT_FAILED_ONLY)
    again = ActionStateRecorderManagerCfg()
    again.from_dict(json.loads(json.dumps(to_dict(cfg))))
    assert again == cfg


def test_without_h5py_there_is_one_clear_error(monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    problems = World(settings()).context.problems
    assert problems == ["recorders: needs h5py, which is not installed: pip install stripe-newton[record]"]
    assert World(settings(dataset_export_mode=MODES.EXPORT_NONE)).context.problems == []
    with pytest.raises(ImportError, match=r"pip install stripe-newton\[record\]"):
        EpisodeFile.open("x.hdf5")


class Robot:
    """An environment of real physics, as far as recorders need one."""

    def __init__(self, context: Any):
        self.context, self.scene, self.sim = context, context.scene, context.scene.sim
        self.robot = context.entity("robot")
        self.obs_buf = {"policy": self.robot.data.joint_pos}
        self.actions = torch.zeros(context.num_envs, self.robot.num_joints)

    @property
    def processed_actions(self) -> torch.Tensor:
        return 5.0 * self.actions

    def physics(self) -> None:
        self.robot.set_joint_effort_target(self.processed_actions)
        for _ in range(self.context.decimation):
            self.scene.write_data_to_sim()
            self.sim.step()
            self.scene.update(self.sim.physics_dt)


def test_what_was_recorded_can_be_replayed():
    count, lengths = 4, torch.tensor([6, 9, 12, 12])
    context = manager_context(count, "ant")
    env = context.owner = Robot(context)
    generator = torch.Generator().manual_seed(0)
    manager = RecorderManager(settings(), context)
    step = torch.zeros(count)

    def restart() -> None:
        mask = context.torch(context.reset)
        if mask.any():
            env.scene.reset(mask.nonzero().flatten())
            state = env.scene.get_state(is_relative=True)
            robot = state["articulation"]["robot"]
            robot["root_pose"][:, 2] = 0.9 + 0.1 * torch.rand(count, generator=generator)
            robot["joint_position"] += 0.1 * torch.randn(robot["joint_position"].shape, generator=generator)
            rows = {k: v[mask] for k, v in robot.items()}
            env.scene.reset_to({"articulation": {"robot": rows}}, mask.nonzero().flatten(), is_relative=True)
            step[mask] = 0.0

    def advance() -> None:
        env.physics()
        step.add_(1.0)
        set_reset(context, step >= lengths)

    pieces = [manager.pre_reset_items(), [HostFunction("reset", restart, "test")], manager.post_reset_items()]
    set_reset(context, [True] * count)
    plan(context, *pieces).run()
    run_step = plan(
        context,
        manager.pre_step_items(),
        [HostFunction("physics", advance, "test")],
        manager.post_step_items(),
        *pieces,
    )
    for _ in range(12):
        env.actions = torch.randn(env.actions.shape, generator=generator)
        run_step.run()
    manager.close()

    with EpisodeFile.open("out/toy.hdf5") as file:
        names = file.names
        assert sorted(file.attributes(n)["num_samples"] for n in names) == [6, 6, 9, 12, 12]
        for name in names:
            episode, index = file.read(name), file.attributes(name)["env_index"]
            other = torch.tensor([(index + 1) % count])  # in another environment: positions are relative to its origin
            env.scene.reset_to(episode["initial_state"], other, is_relative=True)
            for k, action in enumerate(episode["actions"]):
                env.actions = torch.zeros_like(env.actions)
                env.actions[other] = action
                env.physics()
                state = env.scene.get_state(is_relative=True)["articulation"]["robot"]
                recorded = episode["states"]["articulation"]["robot"]
                for key, value in state.items():
                    torch.testing.assert_close(value[other[0]], recorded[key][k], atol=2e-4, rtol=1e-3, msg=key)
            moved = episode["states"]["articulation"]["robot"]["joint_position"]
            assert (moved[-1] - moved[0]).abs().max() > 0.05
