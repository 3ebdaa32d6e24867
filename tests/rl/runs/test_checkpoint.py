# SPDX-License-Identifier: Apache-2.0
"""Checkpoints: errors of those that are refused; a failed write leaves the old one; compressed states."""

from __future__ import annotations

import os
import zlib

import pytest
import torch

from stripe_newton.rl import (
    CheckpointError,
    find_checkpoint,
    load_checkpoint,
    save_checkpoint,
)
from stripe_newton.rl.runs.checkpoint import from_bytes, to_bytes
from stripe_newton.rl.runs.packed_tensors import pack_tensors
from stripe_newton.rl.runs.training_state import set_learning_rate
from tests.helpers.fake_env import FakeCartRunnerCfg
from tests.helpers.fake_runner import make_runner


def test_checkpoint_errors(tmp_path):
    runner = make_runner(tmp_path / "run")
    runner.learn(1)
    good = find_checkpoint(tmp_path / "run")
    cut = tmp_path / "cut.pt"
    cut.write_bytes(good.read_bytes()[:2000])
    text = tmp_path / "text.pt"
    text.write_text("hello")
    foreign = tmp_path / "foreign.pt"
    torch.save({"model": torch.zeros(3)}, foreign)
    (tmp_path / "empty").mkdir()
    for path, message in (
        (cut, "damaged or cut short"),
        (text, "was not written by torch.save"),
        (foreign, "expected a dict with 'actor_state_dict'"),
        (tmp_path / "none.pt", "does not exist"),
    ):
        with pytest.raises(CheckpointError, match=message):
            runner.load(path)
    with pytest.raises(CheckpointError, match="contains no checkpoint"):
        find_checkpoint(tmp_path / "empty")
    with pytest.raises(CheckpointError, match="does not exist"):
        find_checkpoint(tmp_path / "nowhere")
    for name in ("2026-01-31_12-00-00", "2026-01-30_23-59-59"):
        (tmp_path / "logs" / name / "checkpoints").mkdir(parents=True)
    newest = f"the newest run there is {tmp_path / 'logs' / '2026-01-31_12-00-00'}"
    for path in (tmp_path / "logs", tmp_path / "logs" / "DATE_TIME"):  # as the tutorial has it
        with pytest.raises(CheckpointError, match=newest):
            find_checkpoint(path)


def test_checkpoint_runs_no_code(tmp_path):
    marker = tmp_path / "ran"

    class Evil:
        def __reduce__(self):
            return os.system, (f"touch {marker}",)

    torch.save({"actor_state_dict": Evil()}, tmp_path / "evil.pt")
    with pytest.raises(CheckpointError, match="more than tensors and plain values"):
        load_checkpoint(tmp_path / "evil.pt")
    assert not marker.exists()


def test_checkpoint_of_other_networks_or_sizes(tmp_path):
    make_runner(tmp_path).learn(1)
    wide = FakeCartRunnerCfg()
    wide.actor.hidden_dims = (32, 16)
    with pytest.raises(CheckpointError, match="other networks"):
        make_runner(None, wide).load(find_checkpoint(tmp_path))
    with pytest.raises(CheckpointError, match="8 environments, there are 4"):
        make_runner(None, num_envs=4).resume(find_checkpoint(tmp_path))


def test_checkpoint_of_plain_rsl_rl_can_be_loaded_but_not_resumed(tmp_path):
    runner = make_runner(None)
    torch.save(runner.alg.save() | {"iter": 7, "infos": {"a": 1}}, tmp_path / "model_7.pt")
    other = make_runner(None)
    assert other.load(tmp_path / "model_7.pt") == {"a": 1}
    assert other.iterations_done == 8
    with pytest.raises(CheckpointError, match="no training state"):
        other.resume(tmp_path / "model_7.pt")


def test_training_goes_on_with_the_networks_of_a_checkpoint_without_state(tmp_path):
    runner = make_runner(None)
    set_learning_rate(runner.alg, 2.5e-4)
    torch.save(runner.alg.save() | {"iter": 7, "infos": None}, tmp_path / "model_7.pt")
    other = make_runner(None)
    other.resume(tmp_path / "model_7.pt", networks_alone=True)
    assert (other.iterations_done, other.alg.learning_rate) == (8, 2.5e-4)
    for one, two in zip(runner.alg.actor.parameters(), other.alg.actor.parameters(), strict=True):
        torch.testing.assert_close(one, two, rtol=0.0, atol=0.0)
    other.learn(1)
    assert other.iterations_done == 9


def test_a_failed_write_leaves_the_old_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "model_1.pt"
    save_checkpoint({"actor_state_dict": {}}, path)
    before = path.read_bytes()

    def fail(data, file):
        file.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(torch, "save", fail)
    with pytest.raises(OSError, match="disk full"):
        save_checkpoint({}, path)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["model_1.pt"]


def test_newest_checkpoint_is_by_number(tmp_path):
    for number in (9, 100, 20):
        save_checkpoint({}, tmp_path / "checkpoints" / f"model_{number}.pt")
    assert find_checkpoint(tmp_path).name == "model_100.pt"
    assert find_checkpoint(tmp_path / "checkpoints").name == "model_100.pt"


def state_of_environments() -> dict:
    """Tensors that shrink, and one of random numbers that does not."""
    generator = torch.Generator().manual_seed(0)
    return {
        "zeros": torch.zeros(100, 100, dtype=torch.float64),
        "counts": torch.arange(20_000).reshape(100, 200) % 7 == 3,
        "half": torch.arange(5000, dtype=torch.bfloat16),
        "noise": torch.randint(0, 2**31, (5000,), generator=generator),
        "few": [torch.tensor([-0.0, float("nan")]), 3, "text", None],
        "turned": torch.eye(80)[:, :70].T,
    }


def test_the_state_of_environments_is_compressed(tmp_path):
    state = state_of_environments()
    state["again"] = state["counts"]
    save_checkpoint({"actor_state_dict": {}, "iter": 1, "stripe_newton": state}, tmp_path / "small.pt")
    torch.save({"actor_state_dict": {}, "iter": 1, "stripe_newton": state}, tmp_path / "plain.pt")
    small, plain = ((tmp_path / name).stat().st_size for name in ("small.pt", "plain.pt"))
    assert small < 0.5 * plain
    for name in ("small.pt", "plain.pt"):  # as older versions wrote it
        found = load_checkpoint(tmp_path / name)["stripe_newton"]
        assert found.keys() == state.keys()
        for key in ("zeros", "counts", "half", "noise", "turned"):
            assert found[key].dtype == state[key].dtype
            assert torch.equal(found[key], state[key]), key
        assert found["again"].data_ptr() == found["counts"].data_ptr()
        assert found["few"][0].view(torch.int32).tolist() == state["few"][0].view(torch.int32).tolist()
        assert found["few"][1:] == state["few"][1:]
    assert torch.equal(from_bytes(to_bytes(state))["counts"], state["counts"])


@pytest.mark.parametrize(
    ("part", "value", "message"),
    [
        ("shape", [10**6, 10**6], "more than it could contain"),
        ("shape", [20_000, 2], "is of another size"),
        ("shape", [100, 100], "is of another size"),
        ("shape", [-100, -200], "wrong types"),
        ("shape", "100", "wrong types"),
        ("dtype", "float32", "wrong types"),
        ("dtype", torch.float32, "is of another size"),
        ("on_device", None, "wrong types"),
        ("zlib", torch.zeros(500, dtype=torch.uint8), "is damaged"),
        ("zlib", torch.zeros(500), "wrong types"),
        ("zlib", b"abc", "wrong types"),
        ("zlib", torch.frombuffer(bytearray(zlib.compress(bytes(10**7))), dtype=torch.uint8), "is of another size"),
    ],
)
def test_packed_tensors_that_are_wrong(part, value, message, tmp_path):
    state = pack_tensors(state_of_environments())
    state["counts"][part] = value
    torch.save({"actor_state_dict": {}, "iter": 1, "stripe_newton": state}, tmp_path / "model_1.pt")
    with pytest.raises(CheckpointError, match=f"model_1.pt: 'stripe_newton': .*{message}"):
        load_checkpoint(tmp_path / "model_1.pt")


def test_a_state_that_shrinks_too_much_is_not_compressed():
    zeros = {"a": torch.zeros(10**6)}
    assert pack_tensors(zeros) == zeros


def test_the_state_of_a_rank_that_is_damaged():
    content = to_bytes(state_of_environments())
    with pytest.raises(ValueError, match="the state of a rank is damaged"):
        from_bytes(content[: content.numel() // 2])
    content[content.numel() // 2] ^= 1
    with pytest.raises(ValueError, match=r"the state of a rank is damaged: the checksum of .* is wrong"):
        from_bytes(content)
