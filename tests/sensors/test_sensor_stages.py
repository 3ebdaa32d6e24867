# SPDX-License-Identifier: Apache-2.0
"""Sensor stages: measurements after each physics step, before the outcome, at a reset, before the observations."""

from __future__ import annotations

from typing import Any

import pytest
import torch
import warp as wp

from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.envs import ManagerBasedRLEnv
from stripe_newton.managers import ObservationGroupCfg, ObservationTermCfg, RewardTermCfg, SceneEntityCfg
from stripe_newton.sensors import SensorBase, SensorBaseCfg
from stripe_tasks.cartpole.manager_based import CartpoleManagerEnvCfg
from tests.helpers.cart_env import CartCfg, CartEnv

N = 4


@wp.struct
class ProbeData:
    """Counts of what happened, and the position that was read."""

    count: wp.array2d[float]
    pole: wp.array2d[float]


@wp.kernel(enable_backward=False)
def count_all(column: int, count: wp.array2d[float]):
    env = wp.tid()
    count[env, column] = count[env, column] + 1.0


@wp.kernel(enable_backward=False)
def count_masked(mask: wp.array[wp.bool], count: wp.array2d[float]):
    env = wp.tid()
    if mask[env]:
        count[env, 2] = count[env, 2] + 1.0


@wp.kernel(enable_backward=False)
def read_pole(joint_q: wp.array2d[float], column: int, pole: wp.array2d[float]):
    env = wp.tid()
    pole[env, column] = joint_q[env, 1]


class Probe(SensorBase):
    every_substep = True

    def prepare(self, sim, template, static):
        assert template.body_count
        assert not hasattr(sim, "model")
        self.prepared = True

    def initialize(self, sim):
        assert self.prepared
        super().initialize(sim)
        self.struct = ProbeData()
        self.struct.count = wp.zeros((sim.num_envs, 4), dtype=float, device=sim.device)
        self.struct.pole = wp.zeros((sim.num_envs, 2), dtype=float, device=sim.device)
        self._joints = wp.from_torch(sim.per_env(sim.state.joint_q))

    @property
    def body_names(self):
        return ["left", "right"]

    @property
    def counts(self):
        return {"num_probes": 4}

    def _count(self, column: int) -> None:
        wp.launch(count_all, dim=self.num_envs, inputs=[column], outputs=[self.struct.count])

    def launch_substep(self):
        self._count(0)

    def launch_measured(self):
        self._count(1)
        wp.launch(read_pole, dim=self.num_envs, inputs=[self._joints, 0], outputs=[self.struct.pole])

    def launch_reset(self, env_mask):
        wp.launch(count_masked, dim=self.num_envs, inputs=[env_mask], outputs=[self.struct.count])

    def launch_observed(self):
        self._count(3)
        wp.launch(read_pole, dim=self.num_envs, inputs=[self._joints, 1], outputs=[self.struct.pole])


@configclass
class ProbeCfg(SensorBaseCfg):
    prim_path = "{ENV_REGEX_NS}/Robot/cart"
    class_type = Probe


@wp.func
def counts_of(env: int, sensor: ProbeData, out: wp.array[float]):
    for i in range(4):
        out[i] = sensor.count[env, i]


@wp.func
def measured_pole(env: int, sensor: ProbeData, body_ids: wp.array[int]) -> float:
    return sensor.pole[env, 0] * float(body_ids[0])


def manager_env(**params: Any) -> ManagerBasedRLEnv:
    cfg = CartpoleManagerEnvCfg(seed=1, scale_rewards_by_dt=False)
    cfg.sim.device, cfg.scene.num_envs = "cpu", N

    @configclass
    class Scene(type(cfg.scene)):
        probe = ProbeCfg()

    cfg.scene = Scene(**{k: getattr(cfg.scene, k) for k in cfg.scene.__dataclass_fields__})
    term = ObservationTermCfg(func=counts_of, size=lambda counts: counts["num_probes"])
    cfg.observations = {"policy": ObservationGroupCfg(), "probe": _group(counts=term)}
    cfg.observations["policy"] = _group(counts=term)
    params = params or {"sensor_cfg": SceneEntityCfg("probe", body_names="right")}
    cfg.rewards = {"pole": RewardTermCfg(func=measured_pole, weight=1.0, params=params)}
    return ManagerBasedRLEnv(cfg)


def _group(**terms: Any) -> Any:
    made = configclass(type("Group", (ObservationGroupCfg,), {"__annotations__": dict.fromkeys(terms, Any), **terms}))
    return made()


def test_managers_read_sensors_at_their_times():
    env = manager_env()
    env.reset(seed=0)
    obs, reward, terminated, truncated, _ = env.step(torch.zeros(N, 1))
    count = obs["policy"]
    assert (count[:, 0] == env.cfg.decimation).all()  # each physics step
    assert (count[:, 1] == 1.0).all()  # a reset measures nothing
    assert (count[:, 2] == 1.0).all()  # the reset from outside
    assert (count[:, 3] == 2.0).all()  # at the reset, and in the step
    pole = env.scene["robot"].data.joint_pos[:, 1]
    assert torch.equal(reward, pole)
    assert not (terminated | truncated).any()

    env.scene["robot"].data.joint_pos[1, 0] = 100.0  # off the track
    before = env.scene.sensors["probe"].struct
    obs, reward, terminated, _, _ = env.step(torch.zeros(N, 1))
    assert terminated.tolist() == [False, True, False, False]
    assert obs["policy"][:, 2].tolist() == [1.0, 2.0, 1.0, 1.0]
    seen = wp.to_torch(before.pole)
    assert seen[1, 0] != seen[1, 1]  # before the reset, and after it
    assert torch.equal(seen[:, 1], env.scene["robot"].data.joint_pos[:, 1])
    assert torch.equal(reward, seen[:, 0])
    assert "probe" in env.describe()
    assert "measurements" in env.describe()
    env.close()


@pytest.mark.parametrize(
    ("cfg", "message"),
    [
        (SceneEntityCfg("robot"), "must name a ProbeData: probe"),
        (SceneEntityCfg("probe", body_names="middle"), "middle"),
        (SceneEntityCfg("nothing"), "there is no asset or sensor 'nothing'; there is: robot, probe"),
    ],
)
def test_wrong_sensors_are_named(cfg, message):
    with pytest.raises(ConfigError, match=r"rewards\.pole\.params") as error:
        manager_env(sensor_cfg=cfg)
    assert message in str(error.value)


class ProbedCart(CartEnv):
    def _setup_scene(self):
        self.scene.builder.build_sensors({"probe": ProbeCfg()})
        super()._setup_scene()

    def _get_dones(self):
        self.seen = wp.to_torch(self.scene.sensors["probe"].struct.count).clone()
        return super()._get_dones()


def test_torch_hooks_see_what_was_measured_in_this_step():
    env = ProbedCart(CartCfg(seed=0))
    env.reset()
    env.fail[2] = True
    env.step(torch.zeros(N, 1))
    assert env.seen[:, :2].tolist() == [[2.0, 1.0]] * N
    count = wp.to_torch(env.scene.sensors["probe"].struct.count)
    assert count[:, 2].tolist() == [1.0, 1.0, 2.0, 1.0]
    assert count[:, 3].tolist() == [2.0] * N
    assert not any(row[1] == "probe" and "eager" in row[2] for row in env.plan.rows())
    env.scene.update(0.02)  # a script asks for it
    assert count[:, 1].tolist() == [2.0] * N
    assert count[:, 3].tolist() == [3.0] * N
    env.close()


def test_a_bad_period_is_refused():
    with pytest.raises(ConfigError, match=r"update_period: is -1"):
        ProbeCfg(update_period=-1.0).validate()
