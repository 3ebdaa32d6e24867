# SPDX-License-Identifier: Apache-2.0
"""Motion files: what readers make of CSV and NPZ, other rates, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stripe_newton.motions import Motion, MotionError, find_motions, read_motion
from tests.helpers.motion_files import smooth_motion, write_motion

STANCE = [0.1, -0.2, 0.3]
NAMES = ["hip", "knee", "ankle"]


def csv(tmp_path, text: str, name: str = "walk.csv") -> str:
    (tmp_path / name).write_text(text)
    return str(tmp_path / name)


def npz(tmp_path, **changes) -> str:
    times = np.arange(26) / 50.0
    pos, quat, joints = smooth_motion(times, STANCE, 0)
    bodies = np.stack((pos, pos + 0.1), axis=1), np.stack((quat, quat), axis=1)
    arrays = {
        "fps": np.array([50]),
        "joint_pos": joints,
        "joint_vel": np.gradient(joints, 0.02, axis=0),
        "body_pos_w": bodies[0],
        "body_quat_w": np.roll(bodies[1], 1, axis=2),  # (w, x, y, z)
        "body_lin_vel_w": np.zeros_like(bodies[0]),
        "body_ang_vel_w": np.zeros_like(bodies[0]),
    } | changes
    np.savez(tmp_path / "walk.npz", **{k: v for k, v in arrays.items() if v is not None})
    return str(tmp_path / "walk.npz")


def test_csv_is_root_and_joints_and_its_name_says_the_rate(tmp_path):
    path = tmp_path / "dance_60hz.csv"
    write_motion(path, STANCE, seconds=1.0, fps=60.0, seed=0)
    motion = read_motion(path)
    pos, quat, joints = smooth_motion(np.arange(61) / 60.0, STANCE, 0)
    for actual, expected in ((motion.root_pos, pos), (motion.root_quat, quat), (motion.joint_pos, joints)):
        np.testing.assert_allclose(actual, expected, atol=2e-9)
    assert (motion.fps, motion.duration, motion.joint_names) == (60.0, 1.0, None)
    assert read_motion(path, fps=120.0).duration == 0.5
    path.rename(tmp_path / "dance.csv")
    assert read_motion(tmp_path / "dance.csv").fps == 30.0


def test_first_row_of_names_names_the_joints(tmp_path):
    head = ",".join([*"xyz", *"abcd", *NAMES])
    motion = read_motion(csv(tmp_path, f"{head}\n0,0,1,0,0,0,1,1,2,3\n0,0,1,0,0,0,1,4,5,6\n"))
    assert motion.joint_names == tuple(NAMES)
    ordered = motion.in_order(["ankle", "hip"])
    np.testing.assert_array_equal(ordered.joint_pos, [[3, 1], [6, 4]])


def test_npz_has_its_root_as_first_body_and_scalar_first_quaternions(tmp_path):
    motion = read_motion(npz(tmp_path))
    pos, quat, joints = smooth_motion(np.arange(26) / 50.0, STANCE, 0)
    for actual, expected in ((motion.root_pos, pos), (motion.root_quat, quat), (motion.joint_pos, joints)):
        np.testing.assert_allclose(actual, expected, atol=1e-12)
    assert motion.fps == 50.0
    assert motion.body_pos.shape == (26, 2, 3)
    other = read_motion(npz(tmp_path, body_quat_w=np.stack((quat, quat), axis=1)), quaternions="xyzw")
    np.testing.assert_allclose(other.root_quat, quat, atol=1e-12)


@pytest.mark.parametrize(("fps", "other"), [(60.0, 50.0), (30.0, 50.0), (100.0, 25.0), (30.0, 30.0)])
def test_another_rate_is_the_same_motion(fps, other):
    """Smooth motions, which lines between frames follow to the second order: ``w^2 / (8 fps^2)``."""
    times = np.arange(int(2.0 * fps) + 1) / fps
    motion = Motion("smooth", fps, *smooth_motion(times, STANCE, 3)).resampled(other)
    assert motion.num_frames == int(2.0 * other + 1e-9) + 1
    pos, quat, joints = smooth_motion(np.arange(motion.num_frames) / other, STANCE, 3)
    bound = 4.0**2 / (8.0 * fps**2) * 1.1
    np.testing.assert_allclose(motion.root_pos, pos, atol=0.3 * bound + 1e-9)
    np.testing.assert_allclose(motion.joint_pos, joints, atol=0.25 * bound + 1e-9)
    angles = (Rotation.from_quat(motion.root_quat) * Rotation.from_quat(quat).inv()).magnitude()
    assert angles.max() < 3.0 * bound + 1e-9


def test_velocities_are_the_derivatives():
    """Of sines of up to 4 rad/s at 200 Hz: central differences are off by ``w^3 / (6 fps^2)`` of the amplitude."""
    fps, small = 200.0, 1e-5
    times = np.arange(401) / fps
    motion = Motion("smooth", fps, *smooth_motion(times, STANCE, 5))
    later, before = (smooth_motion(times + d, STANCE, 5) for d in (small, -small))
    lin, ang, joints = (v[1:-1] for v in motion.velocities())
    np.testing.assert_allclose(lin, ((later[0] - before[0]) / (2 * small))[1:-1], atol=1e-3)
    np.testing.assert_allclose(joints, ((later[2] - before[2]) / (2 * small))[1:-1], atol=1e-3)
    turns = (Rotation.from_quat(later[1]) * Rotation.from_quat(before[1]).inv()).as_rotvec() / (2 * small)
    np.testing.assert_allclose(ang, turns[1:-1], atol=2e-3)


def test_files_are_found_by_folder_and_pattern(tmp_path):
    for name in ("b.csv", "a.npz", "notes.txt"):
        (tmp_path / name).touch()
    assert [p.name for p in find_motions(str(tmp_path))] == ["a.npz", "b.csv"]
    assert [p.name for p in find_motions([str(tmp_path / "*.csv"), str(tmp_path / "a.npz")])] == ["b.csv", "a.npz"]
    (tmp_path / "empty").mkdir()
    for wrong, message in ((tmp_path / "empty", "is a folder without"), (tmp_path / "c*.csv", "is neither a file")):
        with pytest.raises(MotionError, match=message):
            find_motions(str(wrong))


ROW = "0,0,1,0,0,0,1,0.1,0.2"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"{ROW}\n{ROW},3\n", "row 2 has 10 numbers, row 1 has 9"),
        (f"{ROW}\n0,0,1,0,0,0,one,0.1,0.2\n", "row 2 has 'one', which is no number"),
        (f"{ROW}\n0,0,1,0,0,0,nan,0.1,0.2\n", "root_quat of frame 2 is not finite"),
        (f"{ROW}\n0,0,1,0,0,1,1,0.1,0.2\n", "quaternion of frame 2 has length 1.414, must be 1"),
        ("0,0,1,0,0,0,1\n", "a row has 7 numbers, must have 7 of the root and those of the joints"),
        ("", "a row has 0 numbers"),
        (f"{ROW}\n", "has 1 frames, must have two or more"),
    ],
)
def test_wrong_csv_is_refused(tmp_path, text, message):
    with pytest.raises(MotionError, match=f"walk.csv: {message}"):
        read_motion(csv(tmp_path, text))


def test_wrong_npz_is_refused(tmp_path):
    for changes, message in (
        ({"joint_pos": None}, "has no joint_pos; it has fps, joint_vel"),
        ({"joint_pos": np.zeros((20, 3))}, "joint_pos has 20 frames, body_pos_w 26"),
        ({"body_pos_w": np.zeros((26, 3))}, r"must be \(frames, joints\)"),
    ):
        with pytest.raises(MotionError, match=message):
            read_motion(npz(tmp_path, **changes))
    (tmp_path / "text.npz").write_text("no archive")
    with pytest.raises(MotionError, match="cannot be read as NPZ"):
        read_motion(tmp_path / "text.npz")
    with pytest.raises(MotionError, match=r"must end in \.csv or \.npz"):
        read_motion(csv(tmp_path, ROW, "walk.txt"))
    with pytest.raises(MotionError, match="does not exist"):
        read_motion(tmp_path / "none.csv")
