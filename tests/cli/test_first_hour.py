# SPDX-License-Identifier: Apache-2.0
"""The parts of the command line that a new user meets: descriptions, kernels that compile, loggers."""

from __future__ import annotations

import io

import pytest
import warp as wp

from stripe_newton.cli import kernel_warmup
from stripe_newton.cli.compile_log import CompileLog
from stripe_newton.cli.list_tasks import description
from stripe_newton.cli.task_descriptions import describe_entry
from stripe_newton.cli.tasks import task_ids
from stripe_newton.configclass import ConfigError
from stripe_newton.rl import RslRlOnPolicyRunnerCfg


def test_every_task_has_a_description():
    texts = {task: description(task) for task in task_ids() if task.startswith("Stripe-")}
    assert len(texts) >= 24
    assert all(" " in text for text in texts.values())
    assert len(set(texts.values())) == len(texts)


@pytest.mark.parametrize(
    ("entry", "text"),
    [
        ("stripe_tasks.cartpole:CartpoleEnvCfg", "Direct cart-pole"),  # which the package imports from its module
        ("stripe_tasks.forest.walk:walk_cfg", "Config of ``Stripe-Forest-Walk-Quadruped-v0``"),
        ("stripe_tasks.nowhere:Cfg", ""),
        ("no_such_package:Cfg", ""),
        (RslRlOnPolicyRunnerCfg, "A training run with PPO"),
    ],
    ids=str,
)
def test_a_description_is_read_from_the_source(entry, text):
    assert describe_entry(entry) == text


def test_the_log_counts_compiled_modules_and_drops_other_messages():
    out = io.StringIO()
    log = CompileLog(out)
    log.info("Module a.b 1234567 load on device 'cpu' took 250.00 ms  (compiled)")
    log.info("Module _create__locals__c_7654abcd 7654321 load on device 'cpu' took 6000.00 ms  (compiled)")
    log.info("Module d 7654321 load on device 'cpu' took 1.00 ms  (cached)")
    log.info("Kernel cache: somewhere")
    assert (log.count, log.seconds) == (2, 6.25)
    assert out.getvalue() == "compiled c in 6 s\n"


def test_the_log_knows_warps_messages(monkeypatch, tmp_path):
    """A kernel that is new, as its module is named by the time: Warp says so in the form that the log reads."""
    log, level, before = CompileLog(io.StringIO()), wp.config.log_level, wp.get_logger()
    source = tmp_path / "new_kernel.py"
    source.write_text("import warp as wp\n@wp.kernel\ndef own(x: wp.array[float]):\n    x[0] = 1.5\n")
    space = {"__name__": f"test_new_kernel_{tmp_path.name}"}
    exec(compile(source.read_text(), str(source), "exec"), space)
    monkeypatch.setattr(wp.config, "cache_kernels", False)
    try:
        wp.set_logger(log)
        wp.config.log_level = wp.LOG_INFO
        wp.launch(space["own"], dim=1, inputs=[wp.zeros(1, device="cpu")], device="cpu")
    finally:
        wp.config.log_level = level
        wp.set_logger(before)
    assert log.count == 1


def test_modules_are_shared_out_evenly_and_can_be_imported():
    shares = kernel_warmup._shares(3)
    assert sorted(name for share in shares for name in share) == sorted(kernel_warmup.MODULES)
    times = [sum(kernel_warmup.MODULES[name] for name in share) for share in shares]
    assert max(times) <= max(max(kernel_warmup.MODULES.values()), 1.4 * sum(times) / 3)
    kernel_warmup.compile_modules("cpu", [])
    for name in kernel_warmup.MODULES:
        __import__(name)
        assert wp.get_module(name).kernels


@pytest.mark.parametrize(
    ("logger", "problem"),
    [("wandb_", "must be tensorboard, wandb, neptune, or a dict"), ("neptune", "not installed: pip install neptune")],
)
def test_loggers_are_checked_before_anything_is_built(logger, problem):
    with pytest.raises(ConfigError, match=problem):
        RslRlOnPolicyRunnerCfg(logger=logger).validate()


def test_loggers_become_those_of_rsl_rl():
    cfg = RslRlOnPolicyRunnerCfg(logger="wandb", experiment_name="walk")
    assert cfg.to_rsl_rl()["logger"] == {"class_name": "WandbLogWriter", "project_name": "walk"}
    assert cfg.replace(log_project="mine").second_writer == {"class_name": "WandbLogWriter", "project_name": "mine"}
    assert RslRlOnPolicyRunnerCfg().to_rsl_rl()["logger"] == "tensorboard"
