# SPDX-License-Identifier: Apache-2.0
"""Observation processing between a term and the policy: noise, bias, modifiers, delay, running statistics."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import torch
import warp as wp
from scipy.integrate import cumulative_trapezoid
from scipy.signal import lfilter, lfiltic
from scipy.stats import chisquare, kstest, norm, uniform

from stripe_kernels import processing
from stripe_kernels.data import ArticulationData
from stripe_newton.configclass import ConfigError
from stripe_newton.envs import mdp
from stripe_newton.managers import (
    DigitalFilterCfg,
    IntegratorCfg,
    ModifierCfg,
    SceneEntityCfg,
    TermState,
)
from stripe_newton.managers import ObservationTermCfg as Term
from stripe_newton.noise import (
    ConstantNoiseCfg,
    GaussianNoiseCfg,
    NoiseModelCfg,
    NoiseModelWithAdditiveBiasCfg,
    UniformNoiseCfg,
)
from tests.helpers.manager_world import ObservationWorld
from tests.helpers.manager_world import observation_group as group
from tests.helpers.term_reference_random import Stream

N = 4
J = 8  # joints of the ant: legs and feet in turn
LEGS = [0, 2, 4, 6]
ALL_LEGS = {"asset_cfg": SceneEntityCfg("robot", joint_names=[".*_leg"])}
SLIDER = {"asset_cfg": SceneEntityCfg("robot", joint_ids=[0])}


@wp.func
def tiled(env: int, robot: ArticulationData, out: wp.array[float]):
    for i in range(out.shape[0]):
        out[i] = robot.joint_pos[env, 0] + 0.25 * float(i)


@wp.func
def first_joint(env: int, robot: ArticulationData, out: wp.array[float]):
    out[0] = robot.joint_pos[env, 0]


@wp.func
def level(env: int, height: float, out: wp.array[float]):
    for i in range(out.shape[0]):
        out[i] = height


@wp.func
def squared(env: int, value: float, offset: float) -> float:
    return value * value + offset


# -- noise


SIZE, STEPS = 300, 30
LEVEL = {"height": 2.0}
MEAN, STD = torch.linspace(-3.0, 3.0, SIZE), torch.linspace(0.0, 2.0, SIZE)
BIASES = {f"bias_{i}": NoiseModelCfg(noise_cfg=ConstantNoiseCfg(bias=0.5)) for i in range(1)}
NOISES: dict[str, Any] = {
    "constant": ConstantNoiseCfg(bias=0.25),
    "added": UniformNoiseCfg(n_min=-0.5, n_max=1.5),
    "factor": UniformNoiseCfg(n_min=0.9, n_max=1.2, operation="scale"),
    "instead": GaussianNoiseCfg(mean=-1.0, std=0.25, operation="abs"),
    "vector": GaussianNoiseCfg(mean=MEAN, std=STD),
    "model": NoiseModelCfg(noise_cfg=GaussianNoiseCfg(mean=0.1, std=0.5)),
}


@pytest.fixture(scope="module")
def noise_world() -> ObservationWorld:
    terms = {n: Term(level, LEVEL, size=SIZE, noise=c) for n, c in NOISES.items()}
    groups = {
        "policy": group(terms, enable_corruption=True, concatenate_terms=False),
        "clean": group(terms, concatenate_terms=False),
    }
    return ObservationWorld(groups)


@pytest.fixture(scope="module")
def noise_drawn(noise_world) -> dict[str, np.ndarray]:
    """Noise on the numbers: (step, environment, number) by term."""
    found: dict[str, list[np.ndarray]] = {name: [] for name in NOISES}
    for _ in range(STEPS):
        noise_world.step()
        for name, values in found.items():
            values.append(noise_world[f"policy.{name}"].astype(float))
    undo = {"factor": lambda v: v / 2.0, "instead": lambda v: v}
    return {n: undo.get(n, lambda v: v - 2.0)(np.stack(v)) for n, v in found.items()}


def test_noise_has_the_distribution_it_is_said_to_have(noise_drawn):
    drawn = noise_drawn
    np.testing.assert_array_equal(drawn["constant"], 0.25)
    vector = drawn["vector"][..., 1:]
    np.testing.assert_array_equal(drawn["vector"][..., 0], -3.0)  # no deviation there
    for values, law in (
        (drawn["added"], uniform(-0.5, 2.0)),
        (drawn["factor"], uniform(0.9, 0.3)),
        (drawn["instead"], norm(-1.0, 0.25)),
        ((vector - MEAN.numpy()[1:]) / STD.numpy()[1:], norm()),
        (drawn["model"], norm(0.1, 0.5)),
    ):
        flat = values.ravel()
        assert kstest(flat, law.cdf).pvalue > 1e-3
        for moment, expected in ((flat.mean(), law.mean()), (flat.std(), law.std())):
            assert abs(moment - expected) < 5.0 * law.std() / np.sqrt(len(flat))
        assert len(np.unique(flat)) > 0.95 * len(flat)


def test_draws_do_not_depend_on_each_other(noise_drawn):
    """Not between environments, numbers, steps or terms."""
    scores = {n: (v - v.mean()) / v.std() for n, v in noise_drawn.items() if n not in ("constant", "vector")}
    pairs = [(a, b) for i, a in enumerate(scores.values()) for b in list(scores.values())[i + 1 :]]
    for v in scores.values():
        pairs += [(v[:, i], v[:, j]) for i in range(N) for j in range(i)]
        pairs += [(v[1:], v[:-1]), (v[..., 1:], v[..., :-1]), (v[..., 2:], v[..., :-2])]
    for a, b in pairs:
        assert abs((a * b).mean()) < 5.0 / np.sqrt(a.size)


def test_noise_is_only_where_corruption_is_enabled(noise_world):
    noise_world.step()
    for name in NOISES:
        np.testing.assert_array_equal(noise_world[f"clean.{name}"], 2.0)
        assert (noise_world[f"policy.{name}"] != 2.0).mean() > 0.99


def test_noise_repeats_with_its_seed_and_leaves_the_main_stream_alone(noise_world):
    context, runs = noise_world.context, []
    before = context.rng.numpy().copy()
    for seed in (5, 5, 6):
        context.seed(seed)
        noise_world.step()
        noise_world.step()
        runs.append(np.concatenate([noise_world[f"policy.{n}"] for n in NOISES if n != "constant"], axis=1))
    np.testing.assert_array_equal(runs[0], runs[1])
    assert (runs[0] == runs[2]).mean() < 0.01
    context.seed(3)
    np.testing.assert_array_equal(context.rng.numpy(), before)
    noise_world.step()
    np.testing.assert_array_equal(context.rng.numpy(), before)


def test_noise_is_a_parameter_that_may_change(noise_world):
    parameters = noise_world.context.parameters
    parameters["observations.policy.constant.noise.bias"] = 4.0
    parameters["observations.policy.added.noise.n_max"] = -0.5
    parameters["observations.policy.model.noise.std"] = 0.0
    noise_world.step()
    for name, expected in (("constant", 6.0), ("added", 1.5), ("model", 2.1)):
        np.testing.assert_allclose(noise_world[f"policy.{name}"], expected, rtol=1e-6)
    for name, value in (("constant.noise.bias", 0.25), ("added.noise.n_max", 1.5), ("model.noise.std", 0.5)):
        parameters[f"observations.policy.{name}"] = value


@wp.kernel
def sample(
    rng: wp.array[wp.uint32], constants: wp.array[float], uniforms: wp.array2d[float], normals: wp.array2d[float]
):
    env = wp.tid()
    constants[env] = processing.sample_constant(env, rng, 0.75, 9.0)
    for i in range(uniforms.shape[1]):
        uniforms[env, i] = processing.sample_uniform(env, rng, -2.0, 0.5)
    for i in range(normals.shape[1]):
        normals[env, i] = processing.sample_gaussian(env, rng, 3.0, 0.1)


def test_samples_are_those_of_the_reference_stream():
    n, stream = 5, Stream(11, 5)
    rng = wp.array(stream.n, dtype=wp.uint32, device="cpu")
    constants = wp.zeros(n, dtype=float, device="cpu")
    uniforms, normals = (wp.zeros((n, 6), dtype=float, device="cpu") for _ in range(2))
    wp.launch(sample, n, [rng, constants, uniforms, normals], device="cpu")
    np.testing.assert_array_equal(constants.numpy(), 0.75)
    np.testing.assert_allclose(uniforms.numpy(), np.stack([stream.uniform(-2.0, 0.5) for _ in range(6)], 1), rtol=1e-5)
    np.testing.assert_allclose(normals.numpy(), np.stack([3.0 + 0.1 * stream.normal() for _ in range(6)], 1), rtol=1e-5)
    np.testing.assert_array_equal(rng.numpy(), stream.n)  # a constant takes no draw


# -- bias


def biased(bias: Any, **fields: Any) -> Term:
    model = NoiseModelWithAdditiveBiasCfg(noise_cfg=ConstantNoiseCfg(bias=0.5), bias_noise_cfg=bias, **fields)
    return Term(level, LEVEL, size=3, noise=model)


BIASED = {
    "each": biased(UniformNoiseCfg(n_min=-0.2, n_max=0.6)),
    "one": biased(GaussianNoiseCfg(mean=1.0, std=0.1), sample_bias_per_component=False),
    "vector": biased(ConstantNoiseCfg(bias=torch.tensor([1.0, 2.0, 3.0]))),
    "instead": biased(ConstantNoiseCfg(bias=4.0, operation="abs")),
    "factor": biased(ConstantNoiseCfg(bias=4.0, operation="scale")),
}


def test_bias_is_drawn_at_the_start_of_an_episode_and_held():
    n = 2000
    groups = {
        "policy": group(BIASED, enable_corruption=True, concatenate_terms=False),
        "clean": group(BIASED, concatenate_terms=False),
    }
    world = ObservationWorld(groups, n, robot="cartpole")

    def biases() -> dict[str, np.ndarray]:
        world.step()
        for name in BIASED:
            np.testing.assert_array_equal(world[f"clean.{name}"], 2.0)
        return {name: world[f"policy.{name}"].astype(float) - 2.5 for name in BIASED}

    world.reset(*range(n))
    first = biases()
    for _ in range(2):
        held = biases()
        assert all(np.array_equal(first[name], held[name]) for name in BIASED)
    assert kstest(first["each"].ravel(), uniform(-0.2, 0.8).cdf).pvalue > 1e-3
    assert np.abs(np.corrcoef(first["each"].T) - np.eye(3)).max() < 5.0 / np.sqrt(n)
    np.testing.assert_array_equal(first["one"], first["one"][:, :1].repeat(3, axis=1))
    assert kstest(first["one"][:, 0], norm(1.0, 0.1).cdf).pvalue > 1e-3
    for name, expected in (("vector", [[1.0, 2.0, 3.0]]), ("instead", 4.0), ("factor", 0.0)):
        np.testing.assert_allclose(first[name], np.broadcast_to(expected, (n, 3)))  # a bias is put on zero
    ended = np.arange(0, n, 3)
    world.reset(*ended)
    second = biases()
    for name in ("each", "one"):
        changed = (second[name] != first[name]).any(axis=1)
        np.testing.assert_array_equal(np.flatnonzero(changed), ended)
        both = np.corrcoef(first[name][ended, 0], second[name][ended, 0])[0, 1]
        assert abs(both) < 5.0 / np.sqrt(len(ended))
    assert kstest(second["each"][ended].ravel(), uniform(-0.2, 0.8).cdf).pvalue > 1e-3


# -- modifiers


@wp.func
def bent(env: int, value: float, robot: ArticulationData, gain: float) -> float:
    return wp.tanh(gain * value) + robot.joint_vel[env, 1]


def torch_legs(env: Any) -> torch.Tensor:
    return env.scene["robot"].data.joint_pos[:, LEGS]


A, B, SMOOTH, DT = (-0.9, 0.2), (0.3, 0.1, -0.05), (0.4, 0.3, 0.2, 0.1), 0.02
RECURSIVE, FINITE, INTEGRAL = DigitalFilterCfg(A=A, B=B), DigitalFilterCfg(B=SMOOTH), IntegratorCfg(dt=DT)
BENT = ModifierCfg(func=bent, params={"gain": 1.5})
MODIFIED = {
    "recursive": Term(mdp.joint_pos, ALL_LEGS, modifiers=[RECURSIVE]),
    "finite": Term(mdp.joint_pos, ALL_LEGS, modifiers=[FINITE]),
    "feedback": Term(mdp.joint_pos, ALL_LEGS, modifiers=[DigitalFilterCfg(A=(-0.5,))]),
    "integral": Term(mdp.joint_pos, ALL_LEGS, modifiers=[INTEGRAL]),
    "bent": Term(mdp.joint_pos, ALL_LEGS, modifiers=[BENT]),
    "all": Term(mdp.joint_pos, ALL_LEGS, modifiers=[INTEGRAL, RECURSIVE, BENT, FINITE], history_length=2, scale=2.0),
    "wide": Term(tiled, size=20, modifiers=[FINITE, INTEGRAL]),
    "torch": Term(torch_legs, size=4, modifiers=[RECURSIVE]),
}


def filtered(b: tuple[float, ...], a: tuple[float, ...], x: np.ndarray) -> np.ndarray:
    """Along time, from a past in which everything was the first value."""
    out = []
    for column in x.T:
        zi = lfiltic(b, (1.0, *a), y=[column[0]] * len(a), x=[column[0]] * (len(b) - 1))
        out.append(lfilter(b, (1.0, *a), column, zi=zi)[0])
    return np.stack(out, axis=1)


def integral(x: np.ndarray) -> np.ndarray:
    return cumulative_trapezoid(np.concatenate([np.zeros_like(x[:1]), x]), dx=DT, axis=0)


def test_modifiers_are_those_of_scipy_and_start_anew_with_their_episode():
    """Signals of each environment are cut at its resets; each piece is filtered by itself."""
    steps, resets = 16, {5: [1, 3], 6: [1], 11: [0, 1, 2, 3]}
    world = ObservationWorld({"policy": group(MODIFIED, concatenate_terms=False)})
    signal = np.random.default_rng(0).normal(size=(steps, N, J)).astype(np.float32)
    velocity = world.robot.joint_vel.numpy()[:, 1]
    world.context.torch(world.robot.joint_vel)[:, 1] = torch.tensor([0.0, 1.0, 2.0, 3.0])
    velocity = np.arange(4.0)
    found: dict[str, list[np.ndarray]] = {name: [] for name in MODIFIED}
    for step in range(steps):  # nobody says that the first episode starts
        world.reset(*resets.get(step, []))
        world.step(signal[step])
        for name, values in found.items():
            values.append(world[f"policy.{name}"])
    for env in range(N):
        cuts = [0, *(s for s, ended in resets.items() if env in ended), steps]
        for start, end in pairwise(cuts):
            x = signal[start:end, env][:, LEGS].astype(float)
            wide = signal[start:end, env, :1] + 0.25 * np.arange(20)

            def bend(v: np.ndarray, env: int = env) -> np.ndarray:
                return np.tanh(1.5 * v) + velocity[env]

            last = 2.0 * filtered(SMOOTH, (), bend(filtered(B, A, integral(x))))
            expected = {
                "recursive": filtered(B, A, x),
                "finite": filtered(SMOOTH, (), x),
                "feedback": filtered((1.0,), (-0.5,), x),
                "integral": integral(x),
                "bent": bend(x),
                "all": np.concatenate([np.concatenate([last[:1], last[:-1]]), last], axis=1),
                "wide": integral(filtered(SMOOTH, (), wide)),
                "torch": filtered(B, A, x),
            }
            for name, values in expected.items():
                np.testing.assert_allclose(np.stack(found[name])[start:end, env], values, rtol=1e-4, atol=1e-5,
                                           err_msg=f"{name} {env} {start}")  # fmt: skip


# -- delay, and the order of all


def test_delay_is_drawn_within_its_bounds_and_held_through_an_episode():
    """The signal is the number of the step, so what comes out says how old it is."""
    n, bounds = 300, {"some": (1, 3), "fixed": (2, 2), "wide": (0, 1), "none": (0, 0)}
    lags = {k: {"delay_min_lag": low, "delay_max_lag": high} for k, (low, high) in bounds.items()}
    slider = {"asset_cfg": SceneEntityCfg("robot", joint_ids=[0])}
    world = ObservationWorld(
        {
            "policy": group(
                {
                    "some": Term(mdp.joint_pos, {}, scale=2.0, **lags["some"]),
                    "fixed": Term(mdp.joint_pos, slider, **lags["fixed"]),
                    "wide": Term(tiled, size=20, **lags["wide"]),
                    "none": Term(mdp.joint_pos, slider, **lags["none"]),
                },
                concatenate_terms=False,
            )
        },
        num_envs=n,
        robot="cartpole",
    )
    draw, starts, episode = np.random.default_rng(0), np.zeros(n, dtype=int), np.zeros(n, dtype=int)
    drawn = {name: np.full((n, 7), -1) for name in bounds}  # by environment and episode
    world.reset(*range(n))
    for step in range(42):
        if step and step % 6 == 0:  # half of them, so that the others go on
            ended = np.flatnonzero(draw.uniform(size=n) < 0.5)
            world.reset(*ended)
            starts[ended], episode[ended] = step, episode[ended] + 1
        world.step(np.stack([np.full(n, step), np.full(n, step) + 0.5], axis=1))
        age = step - starts
        for name, factor in (("some", 2.0), ("fixed", 1.0), ("wide", 1.0), ("none", 1.0)):
            values = world[f"policy.{name}"] / factor
            past = step - values[:, 0]
            if name == "some":
                np.testing.assert_array_equal(values[:, 1], values[:, 0] + 0.5)
            if name == "wide":
                np.testing.assert_array_equal(values - values[:, :1], 0.25 * np.tile(np.arange(20), (n, 1)))
            known = drawn[name][np.arange(n), episode]
            settled = age >= bounds[name][1]
            first = settled & (known < 0)
            known = np.where(first, past, known)
            drawn[name][np.arange(n), episode] = known
            np.testing.assert_array_equal(past[settled], known[settled])  # held, whoever else starts anew
            low, high = bounds[name]
            assert (past <= np.minimum(age, high)).all()
            assert (past >= np.minimum(age, low)).all()  # the first value until there is one old enough
    for name, (low, high) in bounds.items():
        lags_seen = drawn[name][drawn[name] >= 0]
        counts = np.bincount(lags_seen, minlength=high + 1)
        assert counts[:low].sum() == 0
        assert len(counts) == high + 1
        assert low == high or chisquare(counts[low:]).pvalue > 1e-3


def test_order_is_modifiers_noise_clip_scale_delay_history():
    """A scale that changes from step to step tells a delay before it from one after it."""
    noise = ConstantNoiseCfg(bias=torch.tensor([0.3, -0.2, 0.1, 0.0]))
    term = Term(
        mdp.joint_pos,
        ALL_LEGS,
        modifiers=[ModifierCfg(func=squared, params={"offset": -0.1})],
        noise=NoiseModelWithAdditiveBiasCfg(noise_cfg=noise, bias_noise_cfg=ConstantNoiseCfg(bias=0.05)),
        clip=(0.0, 0.7),
        scale=1.0,
        delay_min_lag=2,
        delay_max_lag=2,
        history_length=3,
    )
    world = ObservationWorld(
        {"policy": group({"before": Term(first_joint, size=1), "t": term}, enable_corruption=True)}
    )
    world.reset(*range(N))
    draw = np.random.default_rng(0)
    signal, scale, found = draw.normal(size=(8, N, J)).astype(np.float32), draw.uniform(1.0, 3.0, size=8), []
    for x, s in zip(signal, scale, strict=True):
        world.context.parameters["observations.policy.t.scale"] = s
        world.step(x)
        found.append(world["policy"])
    np.testing.assert_array_equal(np.stack(found)[..., 0], signal[..., 0])
    late = [0, 0, *range(6)]
    functions = {
        "modifiers": lambda v: v**2 - 0.1,
        "noise": lambda v: v + np.array([0.35, -0.15, 0.15, 0.05]),
        "clip": lambda v: np.clip(v, 0.0, 0.7),
        "scale": lambda v: v * scale[:, None, None],
        "delay": lambda v: v[late],
    }

    def expected(order: list[str]) -> np.ndarray:
        v = signal[..., LEGS].astype(float)
        for name in order:
            v = functions[name](v)
        return np.concatenate([v[[max(0, t - k) for t in range(8)]] for k in (2, 1, 0)], axis=-1)

    order = list(functions)
    right = expected(order)
    np.testing.assert_allclose(np.stack(found)[..., 1:], right, rtol=1e-5, atol=1e-6)
    for i in range(4):  # each exchange of neighbours would have been seen
        other = [*order[:i], order[i + 1], order[i], *order[i + 2 :]]
        assert np.abs(expected(other) - right).max() > 0.05, other


# -- names, shapes, bad configs


@wp.func
def joint_pos(env: int, robot: ArticulationData, joint_ids: wp.array[int], out: wp.array[float]):
    """The positions from their mean: a term of one's own, named like one of the package."""
    total = wp.float32(0.0)
    for i in range(joint_ids.shape[0]):
        total += robot.joint_pos[env, joint_ids[i]]
    for i in range(joint_ids.shape[0]):
        out[i] = robot.joint_pos[env, joint_ids[i]] - total / float(joint_ids.shape[0])


def test_own_term_may_be_named_like_one_of_the_package():
    world = ObservationWorld({"policy": group({"t": Term(joint_pos, size=J)})})
    x = np.random.default_rng(0).normal(size=(N, J)).astype(np.float32)
    world.step(x)
    np.testing.assert_allclose(world["policy"], x - x.mean(axis=1, keepdims=True), rtol=1e-4, atol=1e-6)


@wp.func
def remembered(env: int, memory: wp.array[float], out: wp.array[float]):
    out[0] = memory[env]


@pytest.mark.parametrize("name", ["part"])
def test_state_may_have_any_name(name):
    term = Term(remembered, {"memory": TermState(name)}, size=1)
    world = ObservationWorld({"policy": group({"t": term})})
    world.context.torch(world.context.arrays[f"state.{name}"])[:] = torch.arange(4.0)
    world.step()
    np.testing.assert_array_equal(world["policy"][:, 0], np.arange(4.0))


@pytest.mark.parametrize("shape", [(N, 1), (N,), (1, N)])
def test_torch_term_must_return_the_size_it_said(shape):
    world = ObservationWorld({"policy": group({"t": Term(lambda env: torch.ones(shape), size=N)})})
    with pytest.raises(ValueError, match=r"observations\.policy\.t"):
        world.step()


def test_filter_needs_a_coefficient_for_what_goes_in():
    with pytest.raises(ConfigError, match="B"):
        DigitalFilterCfg(A=(0.5,), B=()).validate()
