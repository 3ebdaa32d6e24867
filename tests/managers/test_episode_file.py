# SPDX-License-Identifier: Apache-2.0
"""Episode files: written, appended to, cut off, and read from others."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from stripe_newton.managers.episode_file import EpisodeFile
from tests.helpers.manager_world import manager_context
from tests.helpers.recorder_world import ENVS, QUAT, World, read, settings


def test_an_existing_file_is_refused_appended_to_or_overwritten():
    context = manager_context(ENVS, "cartpole")

    def record(steps: int, **changes: Any) -> World:
        world = World(settings(**changes), context=context)
        if not context.problems:
            world.reset()
            world.step(steps, lengths=[steps, 99, 99])
            world.manager.close()
        return world

    record(2)
    record(3)
    assert len(context.problems) == 1
    assert "recorders.dataset_filename: out/toy.hdf5 exists" in context.problems[0]
    assert "'append'" in context.problems[0]
    context.problems.clear()
    record(3, dataset_file_mode="append")
    with EpisodeFile.open("out/toy.hdf5") as file:
        assert file.names == ["demo_0", "demo_1"]
        assert [file.attributes(n)["num_samples"] for n in file.names] == [2, 3]
        assert file.total == 5
    record(4, dataset_file_mode="overwrite")
    with EpisodeFile.open("out/toy.hdf5") as file:
        assert (file.names, file.total) == (["demo_0"], 4)
    with pytest.raises(ValueError, match="its quaternions are xyzw, not wxyz"):
        record(2, dataset_file_mode="append", quaternion_order="wxyz")
    with pytest.raises(FileExistsError, match=r"out/toy.hdf5: exists; set dataset_file_mode"):
        EpisodeFile.create("out/toy.hdf5", {})
    with pytest.raises(ValueError, match="its episodes are of 'Toy-v0', not 'Other-v0'"):
        EpisodeFile.create("out/toy.hdf5", {"env_name": "Other-v0"}, "append")


def test_quaternions_are_written_as_configured_and_read_as_xyzw():
    world = World(settings(quaternion_order="wxyz"))
    world.reset()
    world.step(2, lengths=[2, 99, 99])
    world.manager.close()
    pose = read()["demo_0"]["states/articulation/robot/root_pose"]
    np.testing.assert_allclose(pose[0, 3:], [QUAT[3], *QUAT[:3]], rtol=1e-6)
    with EpisodeFile.open("out/toy.hdf5") as file:
        assert "format_version" not in file._file.attrs  # what Isaac Lab 3 takes for wxyz
        assert file.quaternion_order == file._data.attrs["quat_convention"] == "wxyz"
        read_back = next(iter(file))["states"]["articulation"]["robot"]["root_pose"]
    torch.testing.assert_close(read_back[0], torch.tensor([11.0, 11.0, 11.0, *QUAT]))


@pytest.mark.parametrize(("version", "order"), [(1, "xyzw"), (None, "wxyz")])
def test_the_order_of_files_of_isaac_lab_follows_from_their_version(version, order):
    h5py = pytest.importorskip("h5py")
    with h5py.File("theirs.hdf5", "w") as file:
        if version:
            file.attrs["format_version"] = version
        file["data/demo_0/states/root_pose"] = np.arange(7.0)[None]
    with EpisodeFile.open("theirs.hdf5") as file:
        expected = {"xyzw": [0, 1, 2, 3, 4, 5, 6], "wxyz": [0, 1, 2, 4, 5, 6, 3]}[order]
        assert file.read("demo_0")["states"]["root_pose"].tolist() == [expected]


def test_reading_what_is_not_there():
    with pytest.raises(FileNotFoundError, match=r"none.hdf5: there is no such file"):
        EpisodeFile.open("none.hdf5")
    Path("text.hdf5").write_text("text")
    with pytest.raises(ValueError, match=r"text.hdf5: cannot be opened as an HDF5 file"):
        EpisodeFile.open("text.hdf5")
    with EpisodeFile.create("empty.hdf5", {}) as file, pytest.raises(KeyError, match="no episode 'demo_3'"):
        file.read("demo_3")


def test_numbers_of_other_files_are_refused():
    """Every way in which HDF5 refers to another file. All of them are read by h5py without a question."""
    h5py = pytest.importorskip("h5py")
    Path("raw").write_bytes(np.ones(4, "f4").tobytes())
    with h5py.File("other.hdf5", "w") as file:
        file["data/demo_0/x"] = np.ones((2, 2), "f4")

    def virtual(episode) -> None:
        layout = h5py.VirtualLayout((2, 2), "f4")
        layout[:] = h5py.VirtualSource("other.hdf5", "/data/demo_0/x", shape=(2, 2))
        episode.create_virtual_dataset("x", layout)

    ways = {
        "is a link": lambda episode: episode.__setitem__("x", h5py.ExternalLink("other.hdf5", "/data/demo_0/x")),
        "has its numbers in another file": lambda episode: episode.create_dataset(
            "x", (2, 2), "f4", external=[(str(Path("raw").absolute()), 0, 16)]
        ),
        "x has its numbers in another file": virtual,
    }
    for index, (message, write) in enumerate(ways.items()):
        with h5py.File(f"{index}.hdf5", "w") as file:
            episode = file.create_group("data/demo_0")
            episode.attrs["num_samples"] = 2
            write(episode)
            assert episode["x"][0, 0] == 1.0
        with EpisodeFile.open(f"{index}.hdf5") as file, pytest.raises(ValueError, match=message):
            file.read("demo_0")
    with h5py.File("root.hdf5", "w") as file:
        file["data"] = h5py.ExternalLink("other.hdf5", "/data")
    with pytest.raises(ValueError, match="has no group 'data'"):
        EpisodeFile.open("root.hdf5")


def test_many_episodes_keep_their_order():
    with EpisodeFile.create("many.hdf5", {}) as file:
        for k in range(12):
            assert file.write({"actions": np.full((1, 1), k)}, 1) == f"demo_{k}"
    with EpisodeFile.open("many.hdf5") as file:
        assert [int(e["actions"]) for e in file] == list(range(12))
        assert len(file) == file.total == 12


KILLED = """
import os, signal, sys
import numpy as np
from stripe_newton.managers.episode_file import EpisodeFile, import_h5py
file = EpisodeFile.create("killed.hdf5", {"env_name": "Toy-v0"}, compression=False)
data = {"actions": np.ones((2000, 64)), "states": {str(i): np.full((2000, 16), float(i)) for i in range(20)}}
for _ in range(30):
    file.write(data, 2000)
group = import_h5py().Group
create, made = group.create_dataset, []
def create_dataset(self, *args, **kwargs):
    made.append(args)
    if len(made) == 15:
        if sys.argv[1] == "flushed":
            file._file.flush()
        os.kill(os.getpid(), signal.SIGKILL)
    return create(self, *args, **kwargs)
group.create_dataset = create_dataset
file.write(data, 2000)
"""


@pytest.mark.parametrize("when", [pytest.param("buffered", marks=pytest.mark.slow), "flushed"])
def test_a_kill_loses_only_the_episode_that_is_being_written(when):
    path = ":".join(p for p in sys.path if p)
    process = subprocess.run([sys.executable, "-c", KILLED, when], env={"PYTHONPATH": path}, capture_output=True)
    assert process.returncode == -signal.SIGKILL, process.stderr.decode()
    with EpisodeFile.open("killed.hdf5") as file:
        assert len(file) == 30
        assert file.total == 30 * 2000
        for episode in file:
            assert episode["states"].keys() == {str(i) for i in range(20)}
            assert float(episode["states"]["19"].mean()) == 19.0
    with EpisodeFile.create("killed.hdf5", {"env_name": "Toy-v0"}, "append") as file:
        assert file.write({"actions": np.zeros((5, 1))}, 5) == "demo_30"
    assert read("killed.hdf5")["demo_30"]["attrs"]["num_samples"] == 5
