# SPDX-License-Identifier: Apache-2.0
"""Videos and images: written, read back, and what is left of them when that fails."""

from __future__ import annotations

import numpy as np
import pytest

from stripe_newton.viewers import VideoWriter, save_image


@pytest.mark.parametrize("size", [(64, 48), (65, 47)])
def test_a_video_reads_back_with_its_frames(tmp_path, size):
    av = pytest.importorskip("av")
    path = tmp_path / "new" / "clip.mp4"
    with VideoWriter(path, fps=25) as video:
        for i in range(12):
            video.add(np.full((size[1], size[0], 3), 20 * i, dtype=np.uint8))
        assert not path.exists()
    assert [p.name for p in path.parent.iterdir()] == ["clip.mp4"]
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [f.to_ndarray(format="rgb24") for f in container.decode(video=0)]
        assert stream.codec_context.name == "h264"
        assert stream.pix_fmt == "yuv420p"
        assert stream.average_rate == 25
    assert len(frames) == 12
    assert frames[0].shape == (size[1] + size[1] % 2, size[0] + size[0] % 2, 3)
    np.testing.assert_allclose([f.mean() for f in frames], [20 * i for i in range(12)], atol=6)


def write_video(path, *frames):
    with VideoWriter(path, fps=30) as video:
        for frame in frames:
            video.add(frame)


def test_an_interrupted_video_leaves_nothing_and_bad_frames_are_refused(tmp_path):
    frame = np.zeros((32, 32, 3), dtype=np.uint8)
    with pytest.raises(ValueError, match=r"shape \(16, 32, 3\), the first one had"):
        write_video(tmp_path / "a.mp4", frame, frame[:16])
    with pytest.raises(ValueError, match="float64"):
        write_video(tmp_path / "b.mp4", frame, np.zeros((32, 32, 3)))
    with pytest.raises(ValueError, match="without a frame"):
        write_video(tmp_path / "c.mp4")
    assert list(tmp_path.iterdir()) == []
    with pytest.raises(ValueError, match="fps"):
        VideoWriter(tmp_path / "e.mp4", fps=0)
    with pytest.raises(ValueError, match=r"\.mp4"):
        VideoWriter(tmp_path / "e.avi", fps=30)


@pytest.mark.parametrize("ends", [True, False], ids=["at the end", "at a frame"])
def test_a_video_that_cannot_be_written_says_so_and_leaves_nothing(tmp_path, ends):
    """The thread that encodes meets the error, the caller gets it."""

    class FullDisk:
        def encode(self, picture):
            raise OSError(28, "No space left on device")

    def write():
        frame = np.zeros((32, 32, 3), dtype=np.uint8)
        with VideoWriter(tmp_path / "a.mp4", fps=30) as video:
            video.add(frame)
            video._stream = FullDisk()
            for _ in range(1 if ends else 1000):
                video.add(frame)

    with pytest.raises(OSError, match="No space left"):
        write()
    assert list(tmp_path.iterdir()) == []


def test_an_array_that_is_drawn_into_again_is_another_frame(tmp_path):
    av = pytest.importorskip("av")
    frame = np.zeros((32, 32, 3), dtype=np.uint8)
    with VideoWriter(tmp_path / "a.mp4", fps=30) as video:
        for i in range(8):
            frame[:] = 30 * i
            video.add(frame)
    with av.open(str(tmp_path / "a.mp4")) as container:
        means = [f.to_ndarray(format="rgb24").mean() for f in container.decode(video=0)]
    np.testing.assert_allclose(means, [30 * i for i in range(8)], atol=6)


def test_an_image_reads_back(tmp_path):
    image = pytest.importorskip("PIL.Image")
    frame = np.arange(20 * 30 * 3, dtype=np.uint32).astype(np.uint8).reshape(20, 30, 3)
    save_image(tmp_path / "a" / "x.png", frame)
    np.testing.assert_array_equal(np.asarray(image.open(tmp_path / "a" / "x.png")), frame)
    with pytest.raises(ValueError, match="no image ending"):
        save_image(tmp_path / "x.txt", frame)
