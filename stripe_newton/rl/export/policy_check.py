# SPDX-License-Identifier: Apache-2.0
"""Check of exported networks: whether they act as the policy that they were made of."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Iterator, Sequence

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from .metadata_format import CheckResult, NetworkInfo

__all__ = ["TOLERANCE", "check_policy"]

TOLERANCE = 1e-4
"""Largest difference of an action that is allowed, relative to the largest action or to 1."""
BATCH = 16
"""Environments of the check."""
STEPS = 8
"""Steps of the check, one after the other."""

Arrays = dict[str, np.ndarray]
Run = Callable[[Arrays], Arrays]


class _CannotRunError(RuntimeError):
    """Nothing is installed that can run this model."""


def check_policy(
    policy: MLPModel, onnx_model: bytes, script: torch.jit.ScriptModule, network: NetworkInfo, device: str = "cpu"
) -> tuple[float, dict[str, CheckResult]]:
    """Run the policy and the exported networks on the same random observations.

    Observations are normal with the mean and deviation that the policy's normaliser has gathered, pictures are uniform
    in [0, 1): 16 environments, 8 steps in a row, so that the state of a recurrent network counts.

    Args:
        policy: rsl_rl's model.
        onnx_model: The ONNX model.
        script: The TorchScript module.
        network: Section ``network`` of the metadata.
        device: Device of the policy.

    Returns:
        The policy's largest action, and for ``"onnx"`` and ``"torchscript"`` the largest difference of an action and
        the program that ran the network. The difference is None if nothing here can run it.
    """
    observations = [_random_observations(policy, network, step) for step in range(STEPS)]
    expected = _run_policy(policy, observations, device)
    results = {"onnx": _check_onnx(onnx_model, observations, network, expected)}
    # A script that keeps a state acts for one environment: compare it with the first one.
    actions = _run_script(script, observations, network)
    difference = _difference(actions, expected[:, : actions.shape[1]])
    results["torchscript"] = {"largest_difference": difference, "by": f"torch {torch.__version__}"}
    return float(np.abs(expected).max()), results


def _check_onnx(
    model: bytes, observations: Sequence[Arrays], network: NetworkInfo, expected: np.ndarray
) -> CheckResult:
    try:
        run, by = _onnx_runner(model)
        actions = _run_onnx(run, observations, network)
    except _CannotRunError as error:
        return {"largest_difference": None, "by": str(error)}
    return {"largest_difference": _difference(actions, expected), "by": by}


def _difference(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference; infinite where either is not finite."""
    gap = float(np.abs(one.astype(np.float64) - other).max())
    return gap if np.isfinite(gap) else float("inf")


def _random_observations(policy: MLPModel, network: NetworkInfo, step: int) -> Arrays:
    """An array for each input, without the states."""
    rng = np.random.default_rng(step)  # the same in each check, so that its result can be repeated
    arrays: Arrays = {}
    for entry in network["inputs"]:
        shape = (BATCH, *map(int, entry["shape"][1:]))
        if len(shape) > 2:
            arrays[entry["name"]] = rng.random(shape, dtype=np.float32)
            continue
        noise = rng.standard_normal(shape, dtype=np.float32)
        norm = policy.obs_normalizer if policy.obs_normalization else None
        mean, std = (norm.mean.cpu().numpy(), norm.std.cpu().numpy()) if norm is not None else (0.0, 1.0)
        arrays[entry["name"]] = (mean + std * noise).astype(np.float32)
    return arrays


@torch.inference_mode()
def _run_policy(policy: MLPModel, observations: Sequence[Arrays], device: str) -> np.ndarray:
    """Actions ``(steps, batch, n)`` of the policy itself, whose mode and state are the same afterwards."""
    training, hidden = policy.training, policy.get_hidden_state()
    policy.eval()
    policy.reset()
    actions = []
    try:
        with _full_precision():
            for arrays in observations:
                groups = {name: torch.from_numpy(x).to(device) for name, x in arrays.items() if name != "obs"}
                if policy.obs_groups:
                    groups |= _split(policy, torch.from_numpy(arrays["obs"]).to(device))
                actions.append(policy(TensorDict(groups, batch_size=[BATCH])).cpu().numpy())
    finally:
        # A training may go on after this check.
        policy.train(training)
        policy.reset(hidden_state=hidden)
    return np.stack(actions)


def _split(policy: MLPModel, obs: torch.Tensor) -> dict[str, torch.Tensor]:
    """The joined observations as groups; how they are cut makes no difference, since the policy joins them again."""
    first, *others = policy.obs_groups
    return {first: obs} | dict.fromkeys(others, obs[:, :0])


def _run_onnx(run: Run, observations: Sequence[Arrays], network: NetworkInfo) -> np.ndarray:
    """Actions ``(steps, batch, n)`` of the ONNX model."""
    state = {
        s["input"]: np.zeros([BATCH if n == "batch" else int(n) for n in s["shape"]], np.float32)
        for s in network["states"]
    }
    actions = []
    for arrays in observations:
        out = run(arrays | state)
        state = {s["input"]: out[s["output"]] for s in network["states"]}
        actions.append(out["actions"])
    return np.stack(actions)


@torch.inference_mode()
def _run_script(script: torch.jit.ScriptModule, observations: Sequence[Arrays], network: NetworkInfo) -> np.ndarray:
    """Actions of the module after it was written and read; of one environment if it keeps a state."""
    # Errors of writing and reading count too.
    buffer = io.BytesIO()
    torch.jit.save(script, buffer)
    buffer.seek(0)
    module = torch.jit.load(buffer)
    count = 1 if network["states"] else BATCH
    pictures = [entry["name"] for entry in network["inputs"] if entry["name"] != "obs"]
    actions = []
    for arrays in observations:
        tensors = {name: torch.from_numpy(x[:count]) for name, x in arrays.items()}
        flat = tensors["obs"]
        actions.append(module(flat, [tensors[n] for n in pictures]) if pictures else module(flat))
    return np.stack([a.numpy() for a in actions])


def _onnx_runner(model: bytes) -> tuple[Run, str]:
    """A function that runs an ONNX model, by onnxruntime or by the slow evaluator of the package onnx; and its name.

    Raises:
        _CannotRunError: if neither can.
    """
    try:
        import onnxruntime
    except ImportError:
        return _reference_runner(model)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # by default one for each core, which wait for each other by spinning
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    names = [output.name for output in session.get_outputs()]

    def run(arrays: Arrays) -> Arrays:
        return dict(zip(names, session.run(names, arrays), strict=True))

    return run, f"onnxruntime {onnxruntime.__version__}"


def _reference_runner(model: bytes) -> tuple[Run, str]:
    import onnx
    from onnx.reference import ReferenceEvaluator

    try:
        evaluator = ReferenceEvaluator(onnx.load_from_string(model))
    except Exception as error:
        raise _CannotRunError("install onnxruntime to check it: pip install stripe-newton[export]") from error
    names = list(evaluator.output_names)

    def run(arrays: Arrays) -> Arrays:
        try:
            return dict(zip(names, evaluator.run(None, arrays), strict=True))
        except Exception as error:  # an operator that it does not have
            raise _CannotRunError("install onnxruntime to check it: pip install stripe-newton[export]") from error

    return run, f"the reference evaluator of onnx {onnx.__version__}"


@contextlib.contextmanager
def _full_precision() -> Iterator[None]:
    """Switch TF32 off, whose rounding is above the tolerance.

    By torch's older switches, which the runner uses too: on a GPU torch refuses a mixture of these and the newer ones.
    """
    products, convolutions = torch.get_float32_matmul_precision(), torch.backends.cudnn.allow_tf32
    try:
        if products != "highest":
            torch.set_float32_matmul_precision("highest")
        if convolutions:
            torch.backends.cudnn.allow_tf32 = False
        yield
    finally:
        if products != "highest":
            torch.set_float32_matmul_precision(products)
        if convolutions:
            torch.backends.cudnn.allow_tf32 = convolutions
