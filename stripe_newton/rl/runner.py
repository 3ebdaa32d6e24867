# SPDX-License-Identifier: Apache-2.0
"""rsl_rl's on-policy runner with a run folder, exact resume and a clean stop."""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import signal
import sys
import threading
import types
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import torch
from rsl_rl.runners import OnPolicyRunner as _RslRlOnPolicyRunner

from stripe_newton.configclass import ConfigError

from .checkpoint import get_rng_state, load_checkpoint, save_checkpoint, set_rng_state
from .config import RslRlOnPolicyRunnerCfg, RslRlRNNModelCfg
from .errors import CheckpointError
from .logger import RunLogger, StopTraining
from .run_folder import RunFolder
from .vec_env import RslRlVecEnvWrapper

__all__ = ["OnPolicyRunner"]


class OnPolicyRunner(_RslRlOnPolicyRunner):
    """Trains a policy. The loop, the algorithm and the networks are rsl_rl's.

    Files go to a run folder (see :class:`RunFolder`); checkpoints hold all that a run needs to go on as if it had
    never stopped, and are read without running code from them.
    """

    def __init__(self, env: RslRlVecEnvWrapper, cfg: RslRlOnPolicyRunnerCfg, log_dir: str | os.PathLike | None = None):
        """Build networks, algorithm and logger on the environment's device.

        Args:
            env: the wrapped environment.
            cfg: the run's config.
            log_dir: the run folder; ``None`` writes no files.

        Raises:
            ConfigError: all problems of ``cfg``, also those that only show beside this environment.
        """
        cfg.validate()
        problems = list(_misfits(cfg, env))
        if problems:
            raise ConfigError(problems)
        self.agent_cfg = cfg
        self.run_folder = None if log_dir is None else RunFolder(log_dir)
        with contextlib.redirect_stdout(io.StringIO()):  # it prints both networks and the observation sets
            super().__init__(env, cfg.to_rsl_rl(), None if log_dir is None else str(log_dir), str(env.device))
        self.logger: RunLogger = RunLogger(
            log_dir=self.logger.log_dir,
            cfg=self.cfg,
            env_cfg=env.cfg,
            num_envs=env.num_envs,
            is_distributed=self.is_distributed,
            gpu_world_size=self.gpu_world_size,
            gpu_global_rank=self.gpu_global_rank,
            device=self.device,
        )
        if cfg.regenerate_interval:
            self.logger.iteration_hooks.append(self._regenerate)  # before others, and before the checkpoint
        self.logger.git_status_repos = [inspect.getfile(type(env.unwrapped))]  # the state of the task's own code

    @property
    def iterations_done(self) -> int:
        """Iterations that are complete, those before a resume included."""
        return self.logger.iterations_done

    def learn(self, num_learning_iterations: int | None = None, init_at_random_ep_len: bool | None = None) -> bool:
        """Train for a number of iterations, by default up to ``cfg.max_iterations``.

        Ctrl-C ends the run after the iteration that is under way, with a checkpoint; a second Ctrl-C ends it at once.

        Args:
            num_learning_iterations: how many more iterations.
            init_at_random_ep_len: whether episodes start at random lengths; by default as ``cfg`` says, and never
                in a run that goes on.

        Returns:
            Whether all of them were done.
        """
        count = self.agent_cfg.max_iterations - self.iterations_done
        count = count if num_learning_iterations is None else num_learning_iterations
        if count <= 0:
            return True
        spread = self.agent_cfg.init_at_random_ep_len if init_at_random_ep_len is None else init_at_random_ep_len
        if self.run_folder is not None and not self.logger.disable_logs:
            self.run_folder.write_params(self.env.cfg, self.agent_cfg)
            later = self.run_folder.set_aside_after(self.iterations_done - 1)
            if later:
                print(f"{len(later)} later checkpoints were moved to {later[0].parent}")
        target = self.iterations_done + count
        self.current_learning_iteration = self.iterations_done
        self.logger.stop_requested = False
        with _on_interrupt(self._request_stop):
            try:
                super().learn(count, spread and self.iterations_done == 0)
            except StopTraining:
                self._save_final()
            finally:
                if self.logger.writer is not None:
                    self.logger.stop_logging_writer()
        return self.iterations_done == target

    def save(self, path: str | os.PathLike, infos: dict | None = None) -> None:
        """Write a checkpoint. rsl_rl's loop names files in the run folder; they go to its ``checkpoints``."""
        path = Path(path)
        if self.run_folder is not None and path.parent == self.run_folder.path:
            path = self.run_folder.checkpoints / path.name
        data = self.alg.save()
        data |= {"iter": self.current_learning_iteration, "infos": infos, "stripe_newton": self._training_state()}
        save_checkpoint(data, path)
        self.logger.save_model(str(path), self.current_learning_iteration)

    def load(
        self,
        path: str | os.PathLike,
        load_cfg: dict[str, bool] | None = None,
        strict: bool = True,
        map_location: str | None = None,
    ) -> dict | None:
        """Load networks and, unless ``load_cfg`` says otherwise, the optimizer and the number of iterations.

        Args:
            path: a checkpoint of this class or of rsl_rl 5.
            load_cfg: rsl_rl's choice of what to load, such as ``{"actor": True}``.
            strict: whether the networks' parameters must match by name.
            map_location: device to read to; the runner's own by default.

        Returns:
            What was passed to :meth:`save` as ``infos``.

        Raises:
            CheckpointError: if the file is missing, damaged, foreign, or of other networks.
        """
        return self._load(path, load_cfg, strict, map_location)["infos"]

    def resume(self, path: str | os.PathLike) -> None:
        """Load a checkpoint so that :meth:`learn` goes on exactly where it was written.

        Raises:
            CheckpointError: as :meth:`load`, and if the file lacks the state of the training, or if it is of another
                number of environments.
        """
        data = self._load(path, None, True, None)
        state = data.get("stripe_newton")
        if state is None:
            raise CheckpointError(
                f"{path}: holds networks but not the state of a training; it can be played, not resumed"
            )
        try:
            if state["env"] is not None:
                self.env.set_state(state["env"])
            self.logger.set_state(state["logger"], episodes_go_on=state["env"] is not None)
        except (ValueError, RuntimeError) as error:
            raise CheckpointError(f"{path}: does not fit this environment: {error}") from error
        if state["env"] is None:
            print("the environment keeps no state: its episodes start anew", file=sys.stderr)
        elif state["hidden"] is not None:
            self.alg.actor.reset(hidden_state=state["hidden"]["actor"])
            self.alg.critic.reset(hidden_state=state["hidden"]["critic"])
        self.alg.learning_rate = state["learning_rate"]
        if self.alg.rnd is not None:
            _set_rnd_state(self.alg.rnd, state["rnd"])
        set_rng_state(state["rng"], self.device)

    @torch.inference_mode()
    def _regenerate(self, iteration: int) -> None:
        """Go on in another scene after every ``regenerate_interval`` iterations."""
        number, rest = divmod(iteration + 1, self.agent_cfg.regenerate_interval)
        if rest:
            return
        env = self.env
        env.regenerate(env.unwrapped.scene.first_scenery_seed + number)
        if self.agent_cfg.init_at_random_ep_len:
            lengths = torch.randint_like(env.episode_length_buf, high=int(env.max_episode_length))
            env.episode_length_buf = lengths
        self.logger.forget_episodes()
        ended = torch.ones(env.num_envs, dtype=torch.long, device=self.device)
        self.alg.actor.reset(ended)
        self.alg.critic.reset(ended)

    def _request_stop(self) -> None:
        self.logger.stop_requested = True
        print("\nstopping after this iteration (Ctrl-C again: at once)", file=sys.stderr)

    def _save_final(self) -> None:
        if self.logger.writer is not None and self.run_folder is not None:
            self.save(self.run_folder.path / f"model_{self.current_learning_iteration}.pt")

    def _load(self, path: Any, load_cfg: dict[str, bool] | None, strict: bool, map_location: str | None) -> dict:
        data = load_checkpoint(path, map_location or self.device)
        try:
            if self.alg.load(data, load_cfg, strict):
                self.current_learning_iteration = data["iter"]
                self.logger.iterations_done = data["iter"] + 1
        except KeyError as error:
            raise CheckpointError(f"{path}: lacks {error}") from None
        except (RuntimeError, ValueError) as error:
            detail = "; ".join(line.strip() for line in str(error).splitlines()[1:4]) or str(error)
            raise CheckpointError(f"{path}: is of other networks or observations: {detail}") from None
        return {"infos": None} | data

    def _training_state(self) -> dict[str, Any]:
        """All that rsl_rl's checkpoint leaves out."""
        hidden = {"actor": self.alg.actor.get_hidden_state(), "critic": self.alg.critic.get_hidden_state()}
        return {
            "env": self.env.get_state(),
            "hidden": hidden if any(state is not None for state in hidden.values()) else None,
            "learning_rate": float(self.alg.learning_rate),
            "logger": self.logger.get_state(),
            "rnd": _get_rnd_state(self.alg.rnd),
            "rng": get_rng_state(self.device),
        }


def _misfits(cfg: RslRlOnPolicyRunnerCfg, env: RslRlVecEnvWrapper) -> Iterator[str]:
    """Problems of a config that show only beside the environment."""
    if cfg.regenerate_interval:
        scene = getattr(env.unwrapped, "scene", None)
        check = getattr(scene, "obstacle_to_regenerating", None)
        problem = "the environment has no scene of a specification" if check is None else check()
        if problem:
            yield f"regenerate_interval: is {cfg.regenerate_interval}, but {problem}"
    groups = list(env.get_observations().keys())
    for name, wanted in cfg.obs_groups.items():
        for group in wanted:
            if group not in groups:
                yield f"obs_groups.{name}: '{group}' is no observation group, the environment has {', '.join(groups)}"
    recurrent = isinstance(cfg.actor, RslRlRNNModelCfg) or isinstance(cfg.critic, RslRlRNNModelCfg)
    samples = env.num_envs if recurrent else env.num_envs * cfg.num_steps_per_env
    if samples < cfg.algorithm.num_mini_batches:
        what = "environments (recurrent networks divide those)" if recurrent else "samples in an iteration"
        yield f"algorithm.num_mini_batches: is {cfg.algorithm.num_mini_batches}, but there are {samples} {what}"


def _get_rnd_state(rnd: Any) -> dict[str, Any] | None:
    """What random network distillation keeps outside its parameters."""
    if rnd is None:
        return None
    average = rnd.reward_normalizer.disc_avg.avg if rnd.reward_normalization else None
    return {"update_counter": rnd.update_counter, "discounted_average": average}


def _set_rnd_state(rnd: Any, state: dict[str, Any]) -> None:
    rnd.update_counter = state["update_counter"]
    if rnd.reward_normalization:
        rnd.reward_normalizer.disc_avg.avg = state["discounted_average"]


@contextlib.contextmanager
def _on_interrupt(request_stop: Callable[[], None]) -> Iterator[None]:
    """Let the first Ctrl-C ask for a stop; the next one interrupts as usual. Only the main thread can."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.getsignal(signal.SIGINT)

    def handle(number: int, frame: types.FrameType | None) -> None:
        signal.signal(signal.SIGINT, previous)
        request_stop()

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, previous)
