# SPDX-License-Identifier: Apache-2.0
"""OnPolicyRunner: rsl_rl's runner with rollout and update as CUDA graphs, a run folder, exact resume and clean stop."""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import signal
import sys
from pathlib import Path

import torch
from rsl_rl.models import MLPModel
from rsl_rl.runners import OnPolicyRunner as _RslRlOnPolicyRunner

from stripe_newton.configclass import ConfigError

from .configs import RslRlBaseRunnerCfg, RslRlDistillationRunnerCfg
from .distributed import join, world
from .errors import CheckpointError, CheckpointWriteError, DivergedError
from .graphs.loop import learn_in_graphs
from .graphs.rollout import GraphRollout
from .report.run_facts import write_system
from .report.run_report import RunReport
from .runner_settings import env_mismatches, rsl_rl_settings, why_no_graphs
from .runs.checkpoint import CheckpointData, describe_checkpoint_size, load_checkpoint, save_checkpoint
from .runs.divergence import check_networks, is_of_environment
from .runs.interrupt import on_first_signal
from .runs.run_folder import RunFolder
from .runs.run_logger import RunLogger, StopTraining
from .runs.training_state import gather_state, restore_progress, restore_state
from .torch_vector_env import rl_env_of
from .wrappers.rsl_rl import RslRlVecEnvWrapper

__all__ = ["OnPolicyRunner"]


class OnPolicyRunner(_RslRlOnPolicyRunner):
    """Trains a policy with rsl_rl's algorithm and networks, with rollout and update as CUDA graphs where possible.

    Files go to a run folder (:class:`RunFolder`). Checkpoints contain all that a run needs to go on as if it had never
    stopped, and are read without running code from them.
    """

    env: RslRlVecEnvWrapper
    device: str
    logger: RunLogger
    parts_to_act = {"actor": True, "iteration": True}
    """Parts of a checkpoint that :meth:`load` needs where the policy only acts."""

    _unsaved: CheckpointWriteError | None = None
    """Reason why the last checkpoint is not on the disk; None if it is."""
    _has_reported_size = False
    _report: RunReport | None = None
    """Report in the run folder; None in ranks that write no files."""
    task: str | None = None
    """Name of the task, for a run folder that has to be made again. By default the one that the folder names."""

    def __init__(self, env: RslRlVecEnvWrapper, cfg: RslRlBaseRunnerCfg, log_dir: str | os.PathLike | None = None):
        """Build networks, algorithm and logger on the environment's device.

        Args:
            env: The wrapped environment.
            cfg: Config of the run.
            log_dir: The run folder; ``None`` writes no files.

        Raises:
            ConfigError: all problems of ``cfg``, also those that depend on this environment.
        """
        cfg.validate()
        problems = list(env_mismatches(cfg, env))
        if problems:
            raise ConfigError(problems)
        self.agent_cfg = cfg
        self.run_folder = None if log_dir is None else RunFolder(log_dir)
        # Of the whole process, and before networks are made or compiled.
        on_gpu = torch.device(env.device).type == "cuda"
        torch.set_float32_matmul_precision(cfg.matmul_precision if on_gpu else "highest")
        with contextlib.redirect_stdout(io.StringIO()):  # rsl_rl prints both networks and the observation sets
            super().__init__(env, rsl_rl_settings(cfg), None if log_dir is None else str(log_dir), str(env.device))
        # In place of rsl_rl's own, which its constructor has made; that one has opened no file yet.
        self.logger = RunLogger(
            log_dir=self.logger.log_dir,
            cfg=self.cfg,
            env_cfg=env.cfg,
            num_envs=env.num_envs,
            is_distributed=self.is_distributed,
            gpu_world_size=self.gpu_world_size,
            gpu_global_rank=self.gpu_global_rank,
            device=self.device,
        )
        self._rollout: GraphRollout | None = None
        inner = rl_env_of(env.unwrapped)
        if inner is not None and cfg.runner == "graph":
            inner.settle_hooks()  # whether the rollout can be a graph depends on which torch hooks are recorded
        self.no_graphs = why_no_graphs(cfg, env, self.alg)
        """Reason why ``"rollout"`` and ``"update"`` are rsl_rl's own rather than graphs; empty if both are graphs."""
        if cfg.regenerate_interval:
            # The first hook: hooks of others, and the checkpoint after them, belong to the new scene.
            self.logger.iteration_hooks.append(self._regenerate)
        self.logger.git_status_repos = [inspect.getfile(type(env.unwrapped))]  # the state of the task's own code

    @property
    def iterations_done(self) -> int:
        """Number of complete iterations, those before a resume included."""
        return self.logger.iterations_done

    @property
    def networks(self) -> dict[str, MLPModel]:
        """The networks of the algorithm by name; the first is the policy."""
        distills = isinstance(self.agent_cfg, RslRlDistillationRunnerCfg)
        names = ("student", "teacher") if distills else ("actor", "critic")
        return {name: getattr(self.alg, name) for name in names}

    def learn(self, num_learning_iterations: int | None = None, init_at_random_ep_len: bool | None = None) -> bool:
        """Train for a number of iterations, by default up to ``cfg.max_iterations``.

        Ctrl-C, SIGTERM or a closed terminal ends the run after the iteration that is under way, with a checkpoint; a
        second signal ends it at once.

        Args:
            num_learning_iterations: Number of further iterations.
            init_at_random_ep_len: Whether episodes start at random lengths; by default as ``cfg`` says. A resumed run
                never does.

        Returns:
            Whether all iterations were done.

        Raises:
            DivergedError: if the policy has diverged, with the iteration and the last sound checkpoint.
            CheckpointError: if another training runs in the run folder.
        """
        folder = None if self.logger.disable_logs else self.run_folder
        with contextlib.nullcontext() if folder is None else folder.hold():
            return self._learn_held(num_learning_iterations, init_at_random_ep_len)

    def _learn_held(self, num_learning_iterations: int | None, init_at_random_ep_len: bool | None) -> bool:
        count = self.agent_cfg.max_iterations - self.iterations_done
        count = count if num_learning_iterations is None else num_learning_iterations
        if count <= 0:
            return True
        spread = self.agent_cfg.init_at_random_ep_len if init_at_random_ep_len is None else init_at_random_ep_len
        self._prepare_run_folder()
        target = self.iterations_done + count
        # rsl_rl's number is that of the iteration under way, from 0.
        self.current_learning_iteration = self.iterations_done
        self.logger.stop_requested = False
        # torch's launcher ends ranks by SIGTERM after another one died, and such a rank must not wait for an iteration
        # that never ends. So ranks stop on Ctrl-C alone.
        ends = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        signals = (signal.SIGINT,) if self.is_distributed else ends
        with on_first_signal(signals, self._request_stop):
            try:
                self._learn(count, spread and self.iterations_done == 0)
            except StopTraining:
                # It leaves the loop from within the logger, before rsl_rl's loop would save.
                self._save_final()
            except (ValueError, RuntimeError) as error:
                # Weights that are not finite show in many places: in the sampling, in the environment, in the losses.
                if not isinstance(error, DivergedError):
                    self._check_weights(f"iteration {self.iterations_done + 1}", error)
                raise
            finally:
                if self.logger.writer is not None:
                    self.logger.stop_logging_writer()
                if self._report is not None:
                    self._report.finish()
        self._raise_if_unsaved()
        return self.iterations_done == target

    def _check_weights(self, where: str, error: Exception) -> None:
        """Raise the error about a diverged policy, if that is the cause of an error."""
        try:
            check_networks(self.networks, where, self.run_folder)
        except DivergedError as cause:
            if is_of_environment(error):  # whose NaN has gone into the weights, or the other way round
                raise ValueError(f"{error}; weights of the policy are not finite either") from error
            raise cause from error

    def _prepare_run_folder(self) -> None:
        """Write the configs, and move checkpoints aside that are later than the one that is resumed."""
        if self.run_folder is None or self.logger.disable_logs:
            return
        # Before the configs are written, which would make a folder that is gone without a word.
        self._remake_run_folder()
        self.run_folder.write_params(self.env.cfg, self.agent_cfg, self.env.num_envs * self.gpu_world_size)
        with contextlib.suppress(OSError):  # a report can do without; a full disk shows at the checkpoint
            write_system(self.run_folder, self.device)
        self._report = RunReport(self.run_folder)
        later = self.run_folder.set_aside_after(self.iterations_done - 1)
        if later:
            print(f"{len(later)} later checkpoints were moved to {later[0].parent}")

    def _remake_run_folder(self) -> None:
        """Make the run folder again if it was moved or deleted since the training began, with a warning."""
        run = self.run_folder
        if run is None:
            return
        try:
            is_gone = run.take_anew_if_gone()
        except CheckpointError as error:  # a full disk shows at the checkpoint, too
            print(f"\nwarning: {error}", file=sys.stderr)
            return
        if not is_gone and (self.logger.writer is None or run.params.is_dir()):
            self.task = self.task or run.read_task()
            return
        print(
            f"\nwarning: {run.path}: was moved or deleted while the training runs; it is made again, without what was "
            "in it",
            file=sys.stderr,
        )
        with contextlib.suppress(CheckpointError):
            run.write_params(self.env.cfg, self.agent_cfg, self.env.num_envs * self.gpu_world_size)
            if self.task is not None:
                run.write_task(self.task)

    def _learn(self, count: int, spread: bool) -> None:
        """The learning loop: of graphs, or rsl_rl's where the rollout cannot be one."""
        if "rollout" in self.no_graphs:
            if "update" not in self.no_graphs:
                # The replayed update leaves no distribution in the actor: what it has is of the last rollout step.
                self.logger.read_std = lambda: self.alg.std
            super().learn(count, spread)
            return
        # From here on in the order of rsl_rl's loop.
        if spread:
            self._randomize_episode_lengths()
        self.alg.train_mode()
        if self.is_distributed:
            self.alg.broadcast_parameters()
        self.logger.init_logging_writer()
        # Once, so that a second call of `learn` replays the graph that the first has recorded.
        if self._rollout is None:
            sums = self.logger.cur_reward_sum, self.logger.cur_episode_length
            self._rollout = GraphRollout(self.env, self.alg, *sums, check_for_nan=self.agent_cfg.check_for_nan)
        first = self.current_learning_iteration
        learn_in_graphs(self, self._rollout, first, first + count)
        self._save_final()

    def save(self, path: str | os.PathLike, infos: dict | None = None) -> None:
        """Write a checkpoint.

        rsl_rl's loop names files in the run folder itself; they go to its folder ``checkpoints``. All ranks call this
        together, and rank 0 writes. While :meth:`learn` runs, a full disk is a warning; it ends the run if the last
        checkpoint cannot be written either.

        Args:
            path: The file.
            infos: Further values to save, which :meth:`load` returns.

        Raises:
            CheckpointWriteError: outside :meth:`learn`, if the file cannot be written.
            DivergedError: if the weights are not finite; nothing is written then.
        """
        path = Path(path)
        if self.run_folder is not None and path.parent == self.run_folder.path:
            path = self.run_folder.checkpoints / path.name
        check_networks(self.networks, f"iteration {self.iterations_done}", self.run_folder)
        # Before the return of the other ranks: they send their states here.
        state = gather_state(self)
        if self.gpu_global_rank:
            return
        self._remake_run_folder()
        data = self.alg.save()
        data |= {"iter": self.current_learning_iteration, "infos": infos, "stripe_newton": state}
        try:
            save_checkpoint(data, path)
        except CheckpointWriteError as error:
            if self.logger.writer is None:  # outside `learn`
                raise
            print(f"\nwarning: {error}; the training goes on and tries again at the next checkpoint", file=sys.stderr)
            self._unsaved = error
        else:
            self._unsaved = None
            self.logger.save_model(str(path), self.current_learning_iteration)
            self._report_checkpoint_size(path, data)
            if self._report is not None and self.logger.writer is not None:
                self._report.update()

    def _report_checkpoint_size(self, path: Path, data: CheckpointData) -> None:
        """Say once what the checkpoints of the run will take, where that is much."""
        if self._has_reported_size or self.logger.writer is None:
            return
        self._has_reported_size = True
        more = (self.agent_cfg.max_iterations - self.iterations_done) // self.agent_cfg.save_interval
        if text := describe_checkpoint_size(path, data, more):
            print(f"\n{text}", file=sys.stderr)

    def load(
        self,
        path: str | os.PathLike,
        load_cfg: dict[str, bool] | None = None,
        strict: bool = True,
        map_location: str | None = None,
    ) -> dict | None:
        """Load networks and, unless ``load_cfg`` says otherwise, the optimiser and the number of iterations.

        Args:
            path: A checkpoint of this class or of rsl_rl 5.
            load_cfg: Parts to load, by rsl_rl's names, such as ``{"actor": True}``; ``None`` for all.
            strict: Whether the networks' parameters must match by name.
            map_location: Device to read to; the runner's own by default.

        Returns:
            The ``infos`` that were passed to :meth:`save`.

        Raises:
            CheckpointError: if the file is missing, damaged, of another program, or of other networks.
            DivergedError: if its weights are not finite.
        """
        return self._load(path, load_cfg, strict, map_location).get("infos")

    def resume(self, path: str | os.PathLike, episodes: bool = True, networks_alone: bool = False) -> None:
        """Load a checkpoint so that :meth:`learn` continues exactly from where it was written.

        Args:
            path: A checkpoint of this class. If it was written by another number of ranks, episodes start anew, and a
                message says so.
            episodes: Whether the environments go on in the middle of their episodes. If not, only their clock goes on.
            networks_alone: Whether a checkpoint without the state of a training, as rsl_rl writes it, is taken too:
                its networks, optimiser and iteration. Episodes start anew, curricula are those of its iteration.

        Raises:
            CheckpointError: as :meth:`load`, and if the file lacks the state of the training, or if it is of another
                number of environments.
        """
        data = self._load(path, None, True, None)
        state = data.get("stripe_newton")
        if state is not None:
            restore_state(self, state, path, episodes)
        elif networks_alone:
            restore_progress(self, self.iterations_done * self.agent_cfg.num_steps_per_env)
        else:
            raise CheckpointError(
                f"{path}: contains networks but no training state; it can be played, not resumed as it was "
                "(--allow-changes True continues from its networks)"
            )

    @torch.inference_mode()
    def _regenerate(self, iteration: int) -> None:
        """Generate the scene anew after every ``regenerate_interval`` iterations."""
        number, rest = divmod(iteration + 1, self.agent_cfg.regenerate_interval)
        if rest:
            return
        env, inner = self.env, rl_env_of(self.env.unwrapped)
        first_seed = None if inner is None else inner.scene.first_scenery_seed
        assert first_seed is not None  # `env_mismatches` has checked that the scene can be generated anew
        # The seed follows from the iteration, so that a resumed run meets the same scenes.
        env.regenerate(first_seed + number)
        if self.agent_cfg.init_at_random_ep_len:
            self._randomize_episode_lengths()
        self.logger.clear_episodes()
        # All episodes were cut, so recurrent networks forget them.
        ended = torch.ones(env.num_envs, dtype=torch.long, device=self.device)
        for network in self.networks.values():
            network.reset(ended)

    def _randomize_episode_lengths(self) -> None:
        lengths = torch.randint_like(self.env.episode_length_buf, high=int(self.env.max_episode_length))
        self.env.episode_length_buf = lengths

    def _request_stop(self, _: signal.Signals) -> None:
        self.logger.stop_requested = True
        print("\nstopping after this iteration (Ctrl-C again: at once)", file=sys.stderr)

    def _raise_if_unsaved(self) -> None:
        """End with an error if no checkpoint has the last iterations."""
        if self._unsaved is None or self.run_folder is None:
            return
        error, self._unsaved = self._unsaved, None
        newest = [str(file) for _, file in self.run_folder.list_checkpoints()[-1:]]
        raise CheckpointWriteError(f"{error}; the newest checkpoint is {newest[0] if newest else 'none'}") from error

    def _configure_multi_gpu(self) -> None:
        """Find out which rank this is, and join the others. rsl_rl's own method knows GPUs alone."""
        me = world()
        self.gpu_world_size, self.gpu_global_rank, self.gpu_local_rank = me.size, me.rank, me.local_rank
        self.is_distributed = me.size > 1
        numbers = {"global_rank": me.rank, "local_rank": me.local_rank, "world_size": me.size}
        self.cfg["multi_gpu"] = numbers if self.is_distributed else None
        if self.is_distributed:
            if self.device not in ("cpu", f"cuda:{me.local_rank}"):
                raise ValueError(
                    f"rank {me.rank} must be on 'cuda:{me.local_rank}' or on 'cpu', not on '{self.device}'"
                )
            join(self.device)

    def _save_final(self) -> None:
        if self.logger.writer is not None and self.run_folder is not None:
            self.save(self.run_folder.path / f"model_{self.current_learning_iteration}.pt")

    def _load(
        self, path: str | os.PathLike, load_cfg: dict[str, bool] | None, strict: bool, map_location: str | None
    ) -> CheckpointData:
        data = load_checkpoint(path, map_location or self.device)
        self._load_networks(data, load_cfg, strict, path)
        return data

    def _load_networks(
        self, data: CheckpointData, load_cfg: dict[str, bool] | None, strict: bool, path: str | os.PathLike
    ) -> None:
        try:
            if self.alg.load(data, load_cfg, strict):
                self.current_learning_iteration = data["iter"]
                self.logger.iterations_done = data["iter"] + 1
        except KeyError as error:
            raise CheckpointError(f"{path}: lacks {error}") from None
        except (RuntimeError, ValueError, TypeError, AttributeError, IndexError) as error:
            # torch's message has a headline and then a line for each parameter; three of them are enough.
            detail = "; ".join(line.strip() for line in str(error).splitlines()[1:4]) or str(error)
            raise CheckpointError(f"{path}: has other networks or observations: {detail}") from None
        check_networks(self.networks, str(path), RunFolder.of_checkpoint(Path(path)))
