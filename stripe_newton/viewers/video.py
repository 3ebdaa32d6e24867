# SPDX-License-Identifier: Apache-2.0
"""Video and image files: MP4 videos that browsers play, and images. A file gets its name only when complete."""

from __future__ import annotations

import contextlib
import os
import queue
import threading
from fractions import Fraction
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from av import VideoStream
    from av.container import OutputContainer

__all__ = ["VideoWriter", "save_image"]

_MOST_WAITING = 8
"""Frames that wait for the encoder at most, before the caller waits."""

# libx264 is not in every build of FFmpeg, as it is under the GPL.
_CODECS = ("libx264", "libopenh264", "h264_videotoolbox")


class VideoWriter:
    """Writes an H.264 video (MP4, yuv420p, ready to stream) frame by frame. PyAV includes the encoder.

    ::

        with VideoWriter("run/videos/last.mp4", fps=30) as video:
            for _ in range(150):
                video.add(renderer.render())

    Frames are encoded by a thread, while the caller makes the next one. The first frame sets the size. H.264 needs even
    numbers: an odd width or height is made even by repeating the last column or row. The file is written under a
    temporary name beside the final one and renamed at the end. If the block is left by an exception, no file remains.

    Args:
        path: File to write. Its folder is created if necessary; a file of that name is replaced.
        fps: Frames a second.
        crf: Quality, 0 (lossless) to 51; lower is larger.

    Raises:
        ValueError: ``fps`` is not positive, or ``path`` does not end in ``.mp4``.
    """

    def __init__(self, path: str | os.PathLike[str], fps: float, crf: int = 20):
        self.path = Path(path)
        if not 0 < fps <= 1000:
            raise ValueError(f"VideoWriter: fps is {fps}, expected a number over 0 and up to 1000")
        if self.path.suffix.lower() != ".mp4":
            raise ValueError(f"VideoWriter: '{self.path}' must end in .mp4")
        self._fps, self._crf = Fraction(fps).limit_denominator(1001), crf
        self._partial = self.path.with_name(f".{self.path.name}.{os.getpid()}.part")
        self._container: OutputContainer | None = None
        self._stream: VideoStream  # exists with the container
        self._shape: tuple[int, ...] = ()
        self._waiting: queue.Queue[np.ndarray | None] = queue.Queue(_MOST_WAITING)
        self._thread: threading.Thread | None = None
        self._failed: Exception | None = None
        self._closed = False
        self.frame_count = 0

    def __enter__(self) -> VideoWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self.close()
        else:
            self.discard()

    def add(self, frame: np.ndarray) -> None:
        """Append a frame: RGB, uint8, shape (height, width, 3), the same for every frame.

        Raises:
            ValueError: Another type or shape.
            RuntimeError: The video is closed, or no H.264 encoder is installed.
            OSError: The file could not be written, with this frame or one before.
        """
        if self._closed:
            raise RuntimeError(f"VideoWriter: '{self.path}' is closed; no frame can be added")
        frame = _checked(frame)
        if self._container is None:
            self._open(frame.shape)
        if frame.shape != self._shape:
            raise ValueError(f"VideoWriter: frame has shape {frame.shape}, the first one had {self._shape}")
        if self._failed is not None:
            raise self._failed
        self._waiting.put(frame.copy())  # the caller may draw the next one into the same array
        self.frame_count += 1

    def _encode(self, container: OutputContainer) -> None:
        """Encode frames until there is a None among them: the thread. After an error it only empties the queue."""
        import av  # here and not at the top: saving an image needs no encoder

        count = 0
        while (frame := self._waiting.get()) is not None:
            if self._failed is not None:
                continue
            height, width = frame.shape[:2]
            if height % 2 or width % 2:
                frame = np.pad(frame, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            try:
                picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
                picture.pts = count
                container.mux(self._stream.encode(picture))
            except Exception as error:  # raised where the caller is, at the next frame or at the end
                self._failed = error
            count += 1

    def _end_thread(self) -> None:
        """Wait until all frames are encoded."""
        if self._thread is not None:
            self._waiting.put(None)
            self._thread.join()
            self._thread = None

    def close(self) -> None:
        """Finish the file and give it its final name. A second call does nothing.

        Raises:
            ValueError: No frame was added.
            OSError: The file could not be written.
        """
        if self._closed:
            return
        self._closed = True
        if self._container is None:
            raise ValueError(f"VideoWriter: '{self.path}' was closed without a frame; add at least one")
        self._end_thread()
        try:
            if self._failed is not None:
                with contextlib.suppress(OSError):
                    self._container.close()
                raise self._failed
            self._container.mux(self._stream.encode(None))  # None: flush the encoder
            self._container.close()
            os.replace(self._partial, self.path)
        finally:
            with contextlib.suppress(OSError):
                self._partial.unlink(missing_ok=True)

    def discard(self) -> None:
        """Discard what was written; no file remains."""
        self._closed = True
        self._end_thread()
        if self._container is not None:
            with contextlib.suppress(OSError):  # the disk may be full, which is why it is discarded
                self._container.close()
            with contextlib.suppress(OSError):
                self._partial.unlink(missing_ok=True)

    def _open(self, shape: tuple[int, ...]) -> None:
        """Open the file and start the stream and the thread, for frames of the given shape."""
        import av  # see _encode()

        self.path.parent.mkdir(parents=True, exist_ok=True)
        codec = next((c for c in _CODECS if c in av.codecs_available), None)
        if codec is None:
            raise RuntimeError(f"VideoWriter: PyAV {av.__version__} has no H.264 encoder; reinstall it: pip install av")
        self._shape = shape
        # faststart: the index comes first, so that a browser plays before it has the whole file.
        options = {"movflags": "+faststart"}
        self._container = container = av.open(str(self._partial), mode="w", format="mp4", options=options)
        # Both are options of libx264 alone.
        options = {"crf": str(self._crf), "preset": "veryfast"} if codec == "libx264" else {}
        self._stream = container.add_stream(codec, rate=self._fps, options=options)
        self._stream.height, self._stream.width = shape[0] + shape[0] % 2, shape[1] + shape[1] % 2
        self._stream.pix_fmt = "yuv420p"
        # A daemon: a program that ends without closing the video does not wait for it.
        self._thread = threading.Thread(target=self._encode, args=(container,), name="video", daemon=True)
        self._thread.start()


def save_image(path: str | os.PathLike[str], frame: np.ndarray) -> None:
    """Write an RGB image, uint8 (height, width, 3); the ending of ``path`` chooses the format (png, jpg, webp).

    Raises:
        ValueError: Another type or shape, or an unknown ending.
        OSError: It cannot be written.
    """
    from PIL import Image  # here and not at the top: writing a video needs no image formats

    path = Path(path)
    kinds = Image.registered_extensions()
    if path.suffix.lower() not in kinds:
        raise ValueError(f"save_image: '{path}' has no image ending; use .png, .jpg or .webp")
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        Image.fromarray(_checked(frame)).save(partial, format=kinds[path.suffix.lower()])
        os.replace(partial, path)
    except OSError as error:  # of libraries, which may not name the file
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None
    finally:
        partial.unlink(missing_ok=True)


def save_images(path: str | os.PathLike[str], frames: np.ndarray) -> None:
    """Write images side by side in rows, about as many rows as columns, with two black pixels around each.

    Args:
        path: File; its ending chooses the format.
        frames: Shape ``(n, height, width, channels)`` with 1, 3 or 4 channels: uint8, or floats from 0 to 1, beyond
            which they are cut off. A fourth channel is left out.

    Raises:
        ValueError: Another shape, or an unknown ending.
    """
    if frames.ndim != 4 or frames.shape[0] == 0 or frames.shape[3] not in (1, 3, 4):
        raise ValueError(f"save_images: frames have shape {frames.shape}, must be (n, height, width, 1, 3 or 4)")
    if frames.dtype != np.uint8:
        frames = (255.0 * np.nan_to_num(frames, posinf=1.0).clip(0.0, 1.0) + 0.5).astype(np.uint8)
    frames = np.repeat(frames, 3, axis=3) if frames.shape[3] == 1 else frames[..., :3]
    count, height, width, _ = frames.shape
    columns = max(1, round(count**0.5))
    rows = -(-count // columns)
    grid = np.zeros((rows * (height + 2) + 2, columns * (width + 2) + 2, 3), np.uint8)
    for i, frame in enumerate(frames):
        y, x = 2 + i // columns * (height + 2), 2 + i % columns * (width + 2)
        grid[y : y + height, x : x + width] = frame
    save_image(path, grid)


def _checked(frame: np.ndarray) -> np.ndarray:
    """``frame`` if it is a picture, or an error that says what it is."""
    if not isinstance(frame, np.ndarray) or frame.dtype != np.uint8 or frame.ndim != 3 or frame.shape[2] != 3:
        got = f"{frame.dtype} {frame.shape}" if isinstance(frame, np.ndarray) else type(frame).__name__
        raise ValueError(f"frame: got {got}, expected a NumPy array, uint8, shape (height, width, 3)")
    return frame
