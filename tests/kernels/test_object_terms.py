# SPDX-License-Identifier: Apache-2.0
"""Object terms, against float64 references on random states and known hard cases."""

from __future__ import annotations

import copy
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
import warp as wp

from stripe_kernels.mdp import objects
from stripe_kernels.term_info import observation_size
from stripe_newton.envs import mdp as public
from tests.helpers import term_kernels as tk
from tests.helpers import term_reference_objects as reference
from tests.helpers.term_launch import close, rounded
from tests.helpers.term_reference_random import Stream

NUM_ENVS, NUM_OBJECTS, SEED = 64, 5, 7
PARAMS: dict[str, Any] = {
    "body_ids": [0, 4, 2],
    "std": 1.5,
    "threshold": 0.9,
    "minimal_height": 0.1,
    "lower": (-2.0, -1.5, -1.0),
    "upper": (1.5, 2.0, 1.5),
    "num_range": (1.0, 4.0),
    "pose_range": [(-1.5, 2.0), (-1.0, 1.0), (0.0, 0.3), (-0.5, 0.5), (0.2, 0.2), (-3.0, 3.0)],
    "velocity_range": [(-0.5, 0.5), (0.1, 0.1), (-1.0, 0.0), (-0.2, 0.2), (0.0, 0.0), (-3.0, 3.0)],
    "min_distance": 0.6,
    "min_robot_distance": 0.7,
    "max_tries": 3,
}
KINDS = {"observation": objects.observations, "reward": objects.rewards,
         "termination": objects.terminations, "event": objects.events}  # fmt: skip
TABLES: dict[str, Any] = {"observation": reference.OBSERVATIONS, "reward": reference.REWARDS,
                          "termination": reference.TERMINATIONS, "event": reference.EVENTS}  # fmt: skip
CASES: dict[str, list[dict[str, Any]]] = {
    "spawn_objects": [{}, {"max_tries": 20, "num_range": (5.0, 5.0)}, {"max_tries": 0}, {"min_distance": 100.0}],
    "spawn_objects_at_home": [{}, {"num_range": (0.0, 0.0)}, {"num_range": (9.0, 9.0)}],
    "object_out_of_bounds": [{}, {"upper": (9.0, 9.0, 9.0)}, {"lower": (-9.0, -9.0, -9.0), "upper": (9.0, 9.0, 0.5)}],
    "reach_object": [{}, {"body_ids": [3]}, {"body_ids": []}],
}


def names(kind: str) -> list[str]:
    return [n for n in KINDS[kind].__all__ if isinstance(getattr(objects, n), wp.Function)]


ALL_CASES = [(kind, name, case) for kind in KINDS for name in names(kind) for case in CASES.get(name, [{}])]


def poses(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return tk.random_poses(rng, *shape)


def values() -> dict[str, dict[str, Any]]:
    """Random states; the first environments have none, all and one active, and objects at their targets."""
    v = tk.random_values(NUM_ENVS)
    rng, shape = np.random.default_rng(3), (NUM_ENVS, NUM_OBJECTS)
    origin = 2.0 * np.round(rng.normal(size=(NUM_ENVS, 3)))
    v["ArticulationData"]["env_origin"] = origin
    for field in ("root_pose", "body_pose"):
        v["ArticulationData"][field][..., :3] += origin if field == "root_pose" else origin[:, None]
    pool = {
        "pose": poses(rng, *shape),
        "vel": rng.normal(size=(*shape, 6)),
        "active": rng.random(shape) < 0.5,
        "age": rng.integers(0, 50, shape),
        "written": rng.random(shape) < 0.3,
        "home_pose": poses(rng, *shape),
        "home_vel": rng.normal(size=(*shape, 6)),
        "target_pose": poses(rng, *shape),
        "parking_pose": poses(rng, NUM_OBJECTS),
        "env_origin": origin,
    }
    pool["active"][:3] = False
    pool["active"][1], pool["active"][2, 3], pool["active"][3:5] = True, True, True
    pool["pose"][..., :3] += origin[:, None]
    pool = rounded(pool)
    pool["target_pose"][3, :, :3] = pool["pose"][3, :, :3] - origin[3]
    pool["target_pose"][4, 1, :3] = pool["pose"][4, 1, :3] - origin[4]
    return rounded(v) | {"ObjectPoolData": rounded(pool)}


def source(name: str) -> str:
    """A kernel of one term: its arguments after the environment, then ``result`` where it returns one."""
    types = dict(getattr(objects, name).func.__annotations__)
    returns = types.pop("return", None)
    types.pop("env")

    def kind(annotation: Any) -> str:
        return "objects.ObjectPoolData" if annotation is objects.ObjectPoolData else tk.type_name(annotation)

    parameters = [f"{a}: {'wp.array2d[float]' if a == 'out' else kind(t)}" for a, t in types.items()]
    call = f"objects.{name}({', '.join(['env', *('out[env]' if a == 'out' else a for a in types)])})"
    if returns is not None:
        parameters.append(f"result: wp.array[{'wp.bool' if returns is bool else 'float'}]")
        call = f"result[env] = {call}"
    body = f"    env = wp.tid()\n    {call}\n\n\n"
    return f"@wp.kernel(enable_backward=False)\ndef {name}({', '.join(parameters)}):\n{body}"


@cache
def kernels() -> Any:
    head = "import warp as wp\nfrom stripe_kernels import data\nfrom stripe_kernels.mdp import objects\n\n\n"
    text = "".join(source(n) for kind in KINDS for n in names(kind))
    return tk.import_source("term_kernels_objects", head + text, Path(mkdtemp()))


def pool_struct(fields: dict[str, Any], device: str) -> Any:
    pool = objects.ObjectPoolData()
    for name, value in fields.items():
        dtype = objects.ObjectPoolData.vars[name].type.dtype
        setattr(pool, name, wp.array(np.ascontiguousarray(value), dtype=dtype, device=device))
    return pool


def launch(name: str, v: dict[str, Any], p: dict[str, Any], n: np.ndarray, device: str) -> dict[str, Any]:
    """Run a term; its structs and arrays by argument, and what it returned as ``result``."""
    types = dict(getattr(objects, name).func.__annotations__)
    returns = types.pop("return", None)
    types.pop("env")
    given: dict[str, Any] = {}
    for arg, kind in types.items():
        if kind is objects.ObjectPoolData:
            given[arg] = pool_struct(v["ObjectPoolData"], device)
        elif getattr(kind, "cls", None) is not None:
            given[arg] = tk.build_struct("ArticulationData", v["ArticulationData"], device)
        elif arg == "rng":
            given[arg] = wp.array(n, dtype=wp.uint32, device=device)
        elif hasattr(kind, "ndim"):
            value = np.asarray(p[arg], dtype=np.int32 if arg == "body_ids" else np.float32)
            given[arg] = wp.array(value, dtype=kind.dtype if arg != "out" else float, device=device)
        else:
            given[arg] = kind(*p[arg]) if isinstance(p[arg], tuple) else kind(p[arg])
    if returns is not None:
        given["result"] = wp.zeros(NUM_ENVS, dtype=wp.bool if returns is bool else returns, device=device)
    wp.launch(getattr(kernels(), name), dim=NUM_ENVS, inputs=list(given.values()), device=device)
    return given


def same(field: str, actual: np.ndarray, expected: np.ndarray) -> None:
    if field.endswith("pose"):  # both signs of a quaternion are one orientation
        sign = np.sign((actual[..., 3:] * expected[..., 3:]).sum(axis=-1, keepdims=True))
        expected = np.concatenate((expected[..., :3], sign * expected[..., 3:]), axis=-1)
    close(actual, np.asarray(expected), field)


@pytest.mark.parametrize(("kind", "name", "case"), ALL_CASES, ids=[f"{n}-{list(c)}" for _, n, c in ALL_CASES])
def test_term(kind, name, case, device):
    v, p = values(), {k: rounded(x) for k, x in (PARAMS | case).items()}
    p |= {k: rounded(np.array(p[k])) for k in ("pose_range", "velocity_range")}
    p |= {k: tuple(rounded(np.array(p[k]))) for k in ("lower", "upper")}
    stream = Stream(SEED, NUM_ENVS)
    if kind == "observation":
        size = tk.size_of(getattr(objects, name), {"num_objects": NUM_OBJECTS})
        p["out"] = np.full((NUM_ENVS, size), np.nan)
    if kind != "event":
        expected = np.asarray(TABLES[kind][name](v, p))
        given = launch(name, v, p, stream.n, device)
        result = given["out" if kind == "observation" else "result"].numpy()
        assert result.shape == expected.shape
        close(result, expected if expected.dtype == bool else expected.astype(float), name)
        if kind == "termination" and not case:
            assert 0 < result.sum() < NUM_ENVS
        written: dict[str, np.ndarray] = {}
    else:
        written = TABLES[kind][name](copy.deepcopy(v), p, stream)["ObjectPoolData"]
        given = launch(name, v, p, Stream(SEED, NUM_ENVS).n, device)
        if "rng" in given:
            np.testing.assert_array_equal(given["rng"].numpy(), stream.n, err_msg="numbers drawn")
    for field, before in v["ObjectPoolData"].items():
        same(field, getattr(given["pool"], field).numpy(), written.get(field, before))


def test_every_term_has_a_reference_and_every_observation_a_size():
    for kind, table in TABLES.items():
        assert set(table) == set(names(kind))
    assert all(observation_size(getattr(objects, name)) is not None for name in names("observation"))


def test_users_find_the_terms_beside_the_others():
    for kind, module in KINDS.items():
        for name in names(kind):
            assert getattr(public, name) is getattr(objects, name)
            assert name in public.__all__
        assert not hasattr(public, module.__name__.rpartition(".")[2]), "a module of terms shows through"
    assert len(set(public.__all__)) == len(public.__all__), "two terms share a name"


def test_objects_that_are_nowhere_are_retired(device):
    v = values()
    v["ObjectPoolData"]["pose"][1, 2] = np.nan
    v["ObjectPoolData"]["vel"][1, 2] = np.inf
    wide = {"lower": (-1e6, -1e6, -1e6), "upper": (1e6, 1e6, 1e6)}
    pool = launch("retire_objects_out_of_bounds", v, PARAMS | wide, Stream(0, NUM_ENVS).n, device)["pool"]
    assert not pool.active.numpy()[1, 2]
    assert np.isfinite(pool.pose.numpy()).all()
    assert np.isfinite(pool.vel.numpy()).all()
    assert pool.active.numpy().sum() == v["ObjectPoolData"]["active"].sum() - 1


def test_objects_are_chosen_with_equal_chances(device):
    v = values()
    v["ObjectPoolData"]["active"][:] = False
    chosen = np.zeros(NUM_OBJECTS)
    for seed in range(20):
        given = launch("spawn_objects_at_home", v, PARAMS | {"num_range": (1.0, 2.0)}, Stream(seed, NUM_ENVS).n, device)
        active = given["pool"].active.numpy()
        assert set(active.sum(axis=1)) == {1, 2}
        chosen += active.sum(axis=0)
    total = 20 * NUM_ENVS * 1.5
    assert np.abs(chosen / total - 0.2).max() < 4.0 * np.sqrt(0.2 * 0.8 / total)


SLOTS = """import warp as wp
from stripe_kernels.mdp import objects


@wp.kernel(enable_backward=False)
def touch(pool: objects.ObjectPoolData, slot: int, retire: bool, seen: wp.array[wp.bool]):
    env = wp.tid()
    seen[env] = objects.object_is_active(env, pool, slot)
    if retire:
        objects.retire_object(env, pool, slot)
    else:
        objects.spawn_object(env, pool, slot, wp.transform_identity(), wp.spatial_vector())


@wp.kernel(enable_backward=False)
def update(pool: objects.ObjectPoolData, moved: wp.array[wp.bool]):
    objects.update_objects(wp.tid(), pool, moved)
"""


@cache
def slot_kernels() -> Any:
    return tk.import_source("term_kernels_slots", SLOTS, Path(mkdtemp()))


@pytest.mark.parametrize("retire", [True, False])
@pytest.mark.parametrize("slot", [-1, NUM_OBJECTS, 2])
def test_a_slot_that_does_not_exist_changes_nothing(slot, retire, device):
    v = values()["ObjectPoolData"]
    pool, seen = pool_struct(v, device), wp.zeros(NUM_ENVS, dtype=wp.bool, device=device)
    wp.launch(slot_kernels().touch, dim=NUM_ENVS, inputs=[pool, slot, retire, seen], device=device)
    before = pool_struct(v, device)
    changed = [f for f in v if not np.array_equal(getattr(pool, f).numpy(), getattr(before, f).numpy())]
    assert changed == (["pose", "vel", "active", "age", "written"] if slot == 2 else [])
    np.testing.assert_array_equal(seen.numpy(), v["active"][:, 2] if slot == 2 else np.zeros(NUM_ENVS, dtype=bool))


def test_update_counts_ages_and_marks_where_something_was_written(device):
    v = values()["ObjectPoolData"]
    pool, moved = pool_struct(v, device), wp.zeros(NUM_ENVS, dtype=wp.bool, device=device)
    wp.launch(slot_kernels().update, dim=NUM_ENVS, inputs=[pool, moved], device=device)
    np.testing.assert_array_equal(moved.numpy(), v["written"].any(axis=1))
    np.testing.assert_array_equal(pool.age.numpy(), v["age"] + (v["active"] & ~v["written"]))
    assert not pool.written.numpy().any()
    parked = np.broadcast_to(v["parking_pose"], v["pose"].shape).copy()
    parked[..., :3] += v["env_origin"][:, None]
    expected = np.where(v["active"][..., None], v["pose"], parked)
    np.testing.assert_allclose(pool.pose.numpy(), expected, rtol=1e-6, atol=1e-6)
    np.testing.assert_array_equal(pool.vel.numpy(), np.where(v["active"][..., None], v["vel"], 0.0).astype(np.float32))
