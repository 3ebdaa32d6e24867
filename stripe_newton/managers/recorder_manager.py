# SPDX-License-Identifier: Apache-2.0
"""Recorder manager: records episodes on the device and writes them to files when they end."""

from __future__ import annotations

import enum
import importlib.util
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch

from stripe_newton.configclass import configclass
from stripe_newton.fusion import HostFunction, Item
from stripe_newton.value_types import WrittenPath

from .context import ManagerContext
from .episode_file import Episode, EpisodeFile
from .manager_base import ManagerBase, terms_of
from .recorder_term import RecorderTerm, RecorderTermCfg

__all__ = ["DatasetExportMode", "RecorderManager", "RecorderManagerBaseCfg"]

_CHOICES = {"dataset_file_mode": ("new", "append", "overwrite"), "quaternion_order": ("xyzw", "wxyz")}
_ENVS_AT_ONCE = 64
_GYM = 2  # robomimic's number for an environment of gymnasium
_UNKNOWN = -1
EnvIds = Sequence[int] | np.ndarray | torch.Tensor | None


class DatasetExportMode(enum.IntEnum):
    """Choice of the episodes that are written to files."""

    EXPORT_NONE = 0
    """No episode; ``get_episode`` can still read them."""
    EXPORT_ALL = 1
    """All episodes, to one file."""
    EXPORT_SUCCEEDED_FAILED_IN_SEPARATE_FILES = 2
    """All episodes; failed ones to ``FILENAME_failed.hdf5``."""
    EXPORT_SUCCEEDED_ONLY = 3
    """Successful episodes."""
    EXPORT_FAILED_ONLY = 4
    """Failed episodes."""


@configclass
class RecorderManagerBaseCfg:
    """Config of the recorder manager: the file to write to; the fields that a subclass adds are the terms."""

    dataset_export_dir_path: WrittenPath = "logs/recordings"
    """Folder of the file; it is created."""
    dataset_filename: WrittenPath = "dataset"
    """Name of the file, with or without ``.hdf5``."""
    dataset_export_mode: DatasetExportMode = DatasetExportMode.EXPORT_ALL
    """Episodes that are written."""
    dataset_file_mode: str = "new"
    """Treatment of an existing file: ``"new"`` is an error, ``"append"`` adds episodes, ``"overwrite"`` replaces it."""
    dataset_compression: bool = True
    """Compress datasets with gzip."""
    quaternion_order: str = "xyzw"
    """Order of the quaternions in every ``root_pose``: ``"xyzw"`` as in Isaac Lab 3, ``"wxyz"`` as in Isaac Lab 2. The
    file has it in ``data.attrs["quat_convention"]`` and, as in Isaac Lab, in its ``format_version``. Other quaternions,
    such as those in observations, are written unchanged."""
    export_in_record_pre_reset: bool = True
    """Write an episode when it ends. False drops it then, unless ``export_episodes`` has been called."""

    def paths(self) -> list[Path]:
        """Paths of the files to write; the file of failed episodes is the last."""
        mode, kinds = self.dataset_export_mode, DatasetExportMode
        if mode == kinds.EXPORT_NONE:
            return []
        stem = Path(self.dataset_export_dir_path) / self.dataset_filename.removesuffix(".hdf5")
        both = mode == kinds.EXPORT_SUCCEEDED_FAILED_IN_SEPARATE_FILES
        return [stem.with_name(f"{stem.name}{end}.hdf5") for end in (["", "_failed"] if both else [""])]

    OPEN: ClassVar[tuple[type, ...]] = (RecorderTermCfg,)

    def problems(self) -> Iterator[tuple[str, str]]:
        for name, known in _CHOICES.items():
            value = getattr(self, name)
            if value not in known:
                yield name, f"is {value!r}, must be one of {', '.join(known)}"
        mode: object = self.dataset_export_mode
        if not isinstance(mode, DatasetExportMode):
            names = ", ".join(m.name for m in DatasetExportMode)
            yield "dataset_export_mode", f"is {mode!r}, must be one of DatasetExportMode: {names}"
        if not self.dataset_filename.removesuffix(".hdf5") or Path(self.dataset_filename).name != self.dataset_filename:
            yield "dataset_filename", f"is '{self.dataset_filename}', must be a name; set dataset_export_dir_path too"


_SETTINGS = set(RecorderManagerBaseCfg.__dataclass_fields__)


class RecorderManager(ManagerBase):
    """Copies the results of its terms into buffers on the device, and writes episodes to a file when they end.

    A key that is recorded in every step takes ``num_envs * max_episode_length`` rows of device memory. Episodes without
    a recorded beginning, or without a step, are not written. An episode that ``reset()`` cuts off is.
    :meth:`export_episodes` writes episodes that have not ended.

    ``success`` of an episode is the value given to :meth:`set_success_to_episodes`, else that of the termination term
    ``success`` at its end, else False, as in Isaac Lab.
    """

    name = "recorders"

    def __init__(self, cfg: object, context: ManagerContext):
        super().__init__(cfg, context)
        self.settings = cfg if isinstance(cfg, RecorderManagerBaseCfg) else RecorderManagerBaseCfg()
        self._terms = self._make_terms(cfg)
        self._buffers: dict[str, _Buffer] = {}
        self._files: list[EpisodeFile] | None = None
        self._closed = False
        count = context.num_envs
        self._started = np.zeros(count, dtype=bool)
        self._said, self._found = np.full(count, _UNKNOWN), np.full(count, _UNKNOWN)
        self._counts = {True: 0, False: 0}
        self._resetting = torch.empty(0, dtype=torch.int64)
        self._check()

    def _make_terms(self, cfg: object) -> dict[str, RecorderTerm]:
        if cfg is not None and not isinstance(cfg, (dict, RecorderManagerBaseCfg)):
            self.context.problems.append(
                f"recorders: is {type(cfg).__name__}, must be a RecorderManagerBaseCfg, a dict of terms or None"
            )
            return {}
        if isinstance(cfg, RecorderManagerBaseCfg):
            cfg = {name: term for name, term in terms_of(cfg).items() if name not in _SETTINGS}
        made = {}
        for name, term in self.terms(cfg, RecorderTermCfg).items():
            kind = term.class_type
            if isinstance(kind, type) and issubclass(kind, RecorderTerm):
                made[name] = kind(term, self.context.owner)
            else:
                self.context.problems.append(
                    f"recorders.{name}.class_type: is {kind!r}, must be a subclass of RecorderTerm"
                )
        return made

    def _check(self) -> None:
        if not self._terms:
            return
        problems, settings = self.context.problems, self.settings
        found = [f"recorders.{field}: {message}" for field, message in settings.problems()]
        problems += found
        paths = [] if found else settings.paths()
        if paths and importlib.util.find_spec("h5py") is None:
            problems.append("recorders: needs h5py, which is not installed: pip install stripe-newton[record]")
        if settings.dataset_file_mode == "new":
            problems += [
                f"recorders.dataset_filename: {path} exists, take another name or set dataset_file_mode to 'append' or "
                "'overwrite'"
                for path in paths
                if path.exists()
            ]
        only_succeeded = settings.dataset_export_mode == DatasetExportMode.EXPORT_SUCCEEDED_ONLY
        if only_succeeded and "success" not in self.context.termination_names:
            warnings.warn(
                "recorders: only episodes that succeeded are written and there is no termination term 'success'; "
                "nothing is written unless set_success_to_episodes is called",
                stacklevel=4,
            )

    @property
    def active_terms(self) -> list[str]:
        """Names of the terms."""
        return list(self._terms)

    # -- items

    def pre_step_items(self) -> list[Item]:
        """Items for after the actions are processed, before the physics."""
        return self._items("record_pre_step", self.record_pre_step)

    def post_step_items(self) -> list[Item]:
        """Items for after physics, terminations and rewards, before the reset."""
        return self._items("record_post_step", self.record_post_step)

    def pre_reset_items(self) -> list[Item]:
        """Items that conclude the episodes of ``context.reset``. They must run before anything of them is cleared."""
        if not self._terms:
            return []
        reason = "waits for the device to say which episodes ended, and writes those"
        return [HostFunction("recorders_pre_reset", self._conclude, reason, self.active_terms)]

    def post_reset_items(self) -> list[Item]:
        """Items that record the start of new episodes. They must run after forward kinematics."""
        return self._items("record_post_reset", lambda: self.record_post_reset(self._resetting))

    def _items(self, hook: str, function: Callable[[], None]) -> list[Item]:
        terms = [n for n, t in self._terms.items() if getattr(type(t), hook) is not getattr(RecorderTerm, hook)]
        name = hook.replace("record", "recorders", 1)
        return [HostFunction(name, function, "recorder terms are called on the host", terms)] if terms else []

    def _conclude(self) -> None:
        ended, self._resetting = self.context.reset_mask.indices_on_host(), self.context.reset_mask.indices()
        if len(ended):
            self.record_pre_reset(ended)
            self.clear(ended)
            self._started[ended.numpy()] = True

    # -- recording

    def record_pre_step(self) -> None:
        """Record the results of the terms before a step."""
        self._record("record_pre_step")

    def record_post_step(self) -> None:
        """Record the results of the terms after a step."""
        self._record("record_post_step")

    def record_pre_reset(self, env_ids: EnvIds = None, force_export_or_skip: bool | None = None) -> None:
        """Record the results of the terms at the end of episodes, look up success, and write the episodes.

        Args:
            env_ids: Environments, default all.
            force_export_or_skip: Whether to write them; by default ``export_in_record_pre_reset``.
        """
        ids = self._ids(env_ids)
        if not self._terms or not len(ids):
            return
        self._record("record_pre_reset", ids)
        self._found[ids] = 0
        terminations = getattr(self.context.owner, "termination_manager", None)
        if terminations is not None and "success" in terminations.active_terms:
            self._found[ids] = terminations.get_term("success").cpu().numpy()[ids]
        export = self.settings.export_in_record_pre_reset if force_export_or_skip is None else force_export_or_skip
        if export:
            self.export_episodes(ids)

    def record_post_reset(self, env_ids: EnvIds = None) -> None:
        """Record the results of the terms at the start of episodes."""
        ids = self._ids(env_ids)
        if len(ids):
            self._record("record_post_reset", ids)

    def _record(self, hook: str, ids: np.ndarray | None = None) -> None:
        if self._closed:
            return
        self._open()
        rows = [] if ids is None else [torch.as_tensor(ids, device=self.context.device)]
        for name, term in self._terms.items():
            key, value = getattr(term, hook)(*rows)
            if key is not None:
                for path, tensor in _flat(key, value):
                    self._append(name, path, tensor, ids)

    @torch.inference_mode(False)  # buffers made in an inference mode could not be written outside of it
    @torch.no_grad()
    def _append(self, term: str, path: str, value: torch.Tensor, ids: np.ndarray | None) -> None:
        count = self.context.num_envs if ids is None else len(ids)
        buffer = self._buffers.get(path)
        shape = (count, *(buffer.values.shape[2:] if buffer else value.shape[1:]))
        if tuple(value.shape) != shape:
            raise ValueError(f"recorders.{term}: '{path}' has shape {tuple(value.shape)}, must be {shape}")
        if buffer is None:
            capacity = self.context.max_episode_length if ids is None else 1
            buffer = self._buffers[path] = _Buffer(value, self.context.num_envs, capacity)
        buffer.append(value, ids)

    def add_to_episodes(self, key: str, value: object, env_ids: EnvIds = None) -> None:
        """Record a tensor, or nested dicts of tensors, with one row for each of ``env_ids``."""
        ids = None if env_ids is None else self._ids(env_ids)
        for path, tensor in _flat(key, value):
            self._append("add_to_episodes", path, tensor, ids)

    def set_success_to_episodes(self, env_ids: EnvIds, success_values: torch.Tensor) -> None:
        """Set whether running episodes succeeded; bool, one value for each of ``env_ids``."""
        ids = self._ids(env_ids)
        self._said[ids] = torch.as_tensor(success_values).reshape(len(ids)).bool().cpu().numpy()

    def clear(self, env_ids: EnvIds = None) -> None:
        """Drop the running episodes. Their environments are recorded again from the next reset on."""
        ids = self._ids(env_ids)
        for buffer in self._buffers.values():
            buffer.clear(ids)
        for values, value in ((self._said, _UNKNOWN), (self._found, _UNKNOWN), (self._started, False)):
            values[ids] = value

    def get_episode(self, env_id: int) -> Episode:
        """The running episode of an environment, as nested dicts of tensors whose first dimension is time."""
        return _nested({path: b.values[env_id, : b.lengths[env_id]].clone() for path, b in self._buffers.items()})

    # -- writing

    @property
    def exported_successful_episode_count(self) -> int:
        """Number of concluded episodes that succeeded, whether or not they were written."""
        return self._counts[True]

    @property
    def exported_failed_episode_count(self) -> int:
        """Number of concluded episodes that failed, whether or not they were written."""
        return self._counts[False]

    def export_episodes(self, env_ids: EnvIds = None) -> None:
        """Conclude running episodes: write those that ``dataset_export_mode`` chooses, and drop all of them."""
        ids, lengths = self._ids(env_ids), self._lengths()
        success = np.where(self._said != _UNKNOWN, self._said, self._found)
        done = ids[self._started[ids] & (lengths[ids] > 0)]
        for succeeded in (True, False):
            those = done[(success[done] == 1) == succeeded]
            self._counts[succeeded] += len(those)
            file = self._target(succeeded)
            if file is not None:
                for start in range(0, len(those), _ENVS_AT_ONCE):
                    self._write(file, those[start : start + _ENVS_AT_ONCE], lengths, success)
        self.clear(ids)

    def _lengths(self) -> np.ndarray:
        """Steps recorded of the running episodes."""
        found = [b.lengths for b in self._buffers.values() if b.every_step]
        return np.max(found, axis=0) if found else np.zeros(self.context.num_envs, dtype=np.int64)

    def _write(self, file: EpisodeFile, ids: np.ndarray, lengths: np.ndarray, success: np.ndarray) -> None:
        parts = {path: buffer.fetch(ids) for path, buffer in self._buffers.items()}
        actions = self._buffers.get("actions")
        for k, env in enumerate(ids):
            data = {p: rows[k, : self._buffers[p].lengths[env]] for p, rows in parts.items()}
            file.write(
                _nested({path: rows for path, rows in data.items() if len(rows)}),
                int(actions.lengths[env] if actions else lengths[env]),
                seed=getattr(self.context.owner, "_np_random_seed", None),  # the public name would draw a seed
                success=None if success[env] == _UNKNOWN else bool(success[env]),
                env_index=int(env),
            )

    def _target(self, success: bool) -> EpisodeFile | None:
        if self._closed:
            return None
        mode, kinds, files = self.settings.dataset_export_mode, DatasetExportMode, self._open()
        if mode == kinds.EXPORT_SUCCEEDED_FAILED_IN_SEPARATE_FILES:
            return files[0 if success else 1]
        wanted = {kinds.EXPORT_ALL: True, kinds.EXPORT_SUCCEEDED_ONLY: success, kinds.EXPORT_FAILED_ONLY: not success}
        return files[0] if wanted.get(mode, False) else None

    def _open(self) -> list[EpisodeFile]:
        if self._files is None:
            settings, made = self.settings, list[EpisodeFile]()
            more = settings.dataset_file_mode, settings.quaternion_order, settings.dataset_compression
            try:
                for path in settings.paths() if self._terms else ():
                    made.append(EpisodeFile.create(path, self._env_args(), *more))
            except Exception:
                for file in made:
                    file.close()
                raise
            self._files = made
        return self._files

    def _env_args(self) -> dict[str, object]:
        owner, context = self.context.owner, self.context
        cfg: Any = getattr(owner, "cfg", None)
        name = getattr(cfg, "env_name", None) or getattr(getattr(owner, "spec", None), "id", None) or ""
        args: dict[str, Any] = {"env_name": name, "type": _GYM, "env_kwargs": {}}
        if hasattr(cfg, "get_ep_meta"):
            return args | cfg.get_ep_meta()
        sim = context.scene.sim
        args["sim_args"] = {"dt": sim.physics_dt, "decimation": context.decimation, "num_envs": context.num_envs}
        args["sim_args"]["render_interval"] = sim.cfg.render_interval
        return args

    def close(self) -> None:
        """Close the files. Episodes that have not ended are not written, and nothing is recorded any more."""
        self._closed = True
        for file in self._files or ():
            file.close()

    def _ids(self, env_ids: EnvIds) -> np.ndarray:
        if env_ids is None:
            return np.arange(self.context.num_envs)
        return np.asarray(env_ids.cpu() if isinstance(env_ids, torch.Tensor) else env_ids, dtype=np.int64).reshape(-1)

    def __str__(self) -> str:
        rows = [(i, n, type(t).__name__) for i, (n, t) in enumerate(self._terms.items())]
        where = ", ".join(map(str, self.settings.paths())) or "no file"
        return self.table(f"Recorder terms, to {where}", ("Index", "Name", "Class"), rows)


class _Buffer:
    """Values of one key for the running episodes, on the device.

    Lengths are kept on the host and on the device, so that appending needs no synchronisation.
    """

    def __init__(self, value: torch.Tensor, num_envs: int, capacity: int):
        shape = num_envs, capacity, *value.shape[1:]
        self.values = torch.empty(shape, dtype=value.dtype, device=value.device)
        self.lengths = np.zeros(num_envs, dtype=np.int64)
        self.every_step = False
        self._lengths = torch.zeros(num_envs, dtype=torch.int64, device=value.device)
        self._all = torch.arange(num_envs, device=value.device)

    def append(self, value: torch.Tensor, ids: np.ndarray | None) -> None:
        where: slice | np.ndarray = slice(None) if ids is None else ids
        self.every_step |= ids is None
        if len(self.lengths[where]) and self.lengths[where].max() >= self.values.shape[1]:
            self.values = torch.cat((self.values, torch.empty_like(self.values)), dim=1)
        rows = self._all if ids is None else torch.as_tensor(ids, device=self._all.device)
        self.values[rows, self._lengths[rows]] = value
        self._lengths.index_add_(0, rows, torch.ones_like(rows))
        self.lengths[where] += 1

    def clear(self, ids: np.ndarray) -> None:
        self._lengths.index_fill_(0, torch.as_tensor(ids, device=self._all.device), 0)
        self.lengths[ids] = 0

    def fetch(self, ids: np.ndarray) -> np.ndarray:
        """Rows of some environments up to the length of the longest episode among them, on the host."""
        rows = torch.as_tensor(ids, device=self._all.device)
        return self.values[:, : self.lengths[ids].max()][rows].cpu().numpy()


def _flat(key: str, value: object) -> list[tuple[str, torch.Tensor]]:
    if isinstance(value, dict):
        return [pair for k, v in value.items() for pair in _flat(f"{key}/{k}", v)]
    return [(key, torch.as_tensor(value))]


def _nested(flat: Mapping[str, torch.Tensor | np.ndarray]) -> Episode:
    out: Episode = {}
    for path, value in flat.items():
        *above, last = path.split("/")
        group = out
        for part in above:
            group = group.setdefault(part, {})
        group[last] = value
    return out
