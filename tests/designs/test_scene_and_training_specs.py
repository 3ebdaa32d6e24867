# SPDX-License-Identifier: Apache-2.0
"""Scene and training specifications, row by row: each test shows one promise of that design as a user writes it.

Scene and task are written as the template of ``stripe-newton new NAME --scene`` has them: in two modules that know
nothing of each other, which here are two functions.
"""

from __future__ import annotations

from dataclasses import fields, replace

import gymnasium
import numpy as np
import pytest
import torch
from pxr import Usd

from stripe_newton.cli import main
from stripe_newton.cli.tasks import load_cfg, task_ids
from stripe_newton.envs import LabScene, ManagerBasedRLEnvCfg, mdp
from stripe_newton.managers import (
    EventTermCfg,
    MetricTermCfg,
    ObjectManagerCfg,
    ObjectPoolCfg,
    ObservationGroupCfg,
    ObservationManagerCfg,
    ObservationTermCfg,
    RewardManagerCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.scene import InteractiveSceneCfg
from stripe_newton.sim import DistantLightCfg, DomeLightCfg, MuJoCoSolverCfg, Simulation, SimulationCfg, SphereCfg
from stripe_newton.specifications import BoxMesh, IdenticalAssetSpec, Places, SceneSpec, TerrainInstance, TrainingSpec
from stripe_newton.terrains import Ground
from stripe_tasks.energy import EnergyManagerCfg
from stripe_tasks.robots import ANT_CFG

from .walk_task import solid

# -- the scene module: knows no robot and no task


class Stones(IdenticalAssetSpec):
    """Five stones anywhere."""

    def find_positions(self, terrain, rng):
        return rng.uniform(-0.4, 0.4, (5, 2)) * terrain.size


class Field(SceneSpec):
    """Rolling ground with stones."""

    def __init__(self, size: tuple[float, float] = (12.0, 12.0), height: float = 0.3):
        super().__init__(
            size,
            palette=[Stones("stones", BoxMesh("stone", (0.3, 0.3, 0.2)))],
            distant_light=DistantLightCfg(),
            dome_light=DomeLightCfg(),
            places={"init_pos": Places(count=16, radius=0.4)},
        )
        self.height = height

    def generate(self, rng):
        x, y = np.meshgrid(np.linspace(0.0, 6.0, 25), np.linspace(0.0, 6.0, 25))
        heights = self.height * np.sin(x + rng.uniform(0.0, 6.0)) * np.sin(y)
        return TerrainInstance(Ground(heights, (-6.0, -6.0), (0.5, 0.5)))


# -- the task module: takes whichever scene it is given


def make_task(scene: SceneSpec, **changes: object) -> TrainingSpec:
    spec = TrainingSpec(
        scene=scene,
        robot=ANT_CFG,
        observations=ObservationManagerCfg(
            policy=ObservationGroupCfg(
                joint_pos=ObservationTermCfg(func=mdp.joint_pos), height=ObservationTermCfg(func=mdp.base_pos_z)
            )
        ),
        actions={"legs": mdp.JointEffortActionCfg(joint_names=[".*"], scale=2.0)},
        rewards=RewardManagerCfg(alive=RewardTermCfg(func=mdp.is_alive, weight=1.0)),
        terminations={"time_out": TerminationTermCfg(func=mdp.time_out, time_out=True)},
        events={
            "start": EventTermCfg(
                func=mdp.reset_root_state_from_terrain,
                mode="reset",
                params={"pose_range": {}, "velocity_range": {}},
            )
        },
        sim=SimulationCfg(dt=1 / 120, device="cpu", solver=MuJoCoSolverCfg(njmax=300, nconmax=60)),
        num_envs=2,
        env_spacing=1.0,
        decimation=2,
        episode_length_s=1.0,
    )
    return replace(spec, **changes)


@pytest.fixture(scope="module")
def task():
    return make_task(Field())


@pytest.fixture
def registered(task):
    name = task.register("Test-Field-Ant-v0", rsl_rl_cfg="stripe_newton.rl:RslRlOnPolicyRunnerCfg")
    yield name
    gymnasium.registry.pop(name, None)


# -- project elements


def test_a_task_is_a_training_specification(task):
    assert isinstance(task, TrainingSpec)
    assert isinstance(task.to_env_cfg(), ManagerBasedRLEnvCfg)


def test_a_scene_generation_module_is_a_scene_specification(task):
    assert isinstance(task.scene, SceneSpec)
    scene = Field().create(seed=1)
    assert len(scene.instances) == 5


def test_the_task_refers_to_its_scene_and_is_the_facade_to_it(task):
    cfg = task.to_env_cfg(seed=4)
    assert cfg.scene.scenery.spawn.spec is task.scene
    assert cfg.scene.scenery.spawn.seed == 4


def test_scenes_are_exchanged_without_touching_the_task(task):
    flat = replace(task, scene=Field(height=0.0))
    heights = [t.to_env_cfg().scene.scenery.spawn.made().terrain.ground.heights for t in (task, flat)]
    assert heights[0].std() > 0.0 == heights[1].std()
    assert flat.rewards is task.rewards


def test_tasks_are_exchanged_without_touching_the_scene(task):
    other = replace(task, rewards={"alive": RewardTermCfg(func=mdp.is_alive, weight=3.0)})
    assert other.scene is task.scene
    assert other.to_env_cfg().rewards["alive"].weight == 3.0


def test_scene_and_task_are_separate_modules(tmp_path, monkeypatch):
    assert main(["new", "meadow", "--scene", "--out", str(tmp_path)]) == 0
    package = tmp_path / "meadow" / "meadow"
    scene, task = ((package / f"{name}.py").read_text() for name in ("scene", "task"))
    assert "task" not in [word for line in scene.splitlines() if "import" in line for word in line.split()]
    assert ".scene" not in "".join(line for line in task.splitlines() if "import" in line)
    assert {file.name for file in package.glob("*.py")} >= {"scene.py", "task.py", "sim.py", "__init__.py"}


# -- task interface


def test_a_task_is_registered_and_bound_to_its_scene(registered):
    assert registered in task_ids()
    assert load_cfg(registered, "env").scene.scenery.spawn.spec is not None
    env = gymnasium.make_vec(registered, num_envs=2)
    observations, _ = env.reset(seed=0)
    for _ in range(10):
        observations, reward, *_ = env.step(torch.zeros(2, 8))
    assert torch.isfinite(observations["policy"]).all()
    assert (reward > 0.0).all()
    env.close()


def test_an_exported_task_is_trained_by_the_training_script(registered, tmp_path):
    done = main(
        ["train", registered, "--num-envs", "2", "--max-iterations", "2", "--device", "cpu", "--final-video", "False"]
        + ["--log-dir", str(tmp_path), "--agent.num-steps-per-env", "4", "--env.episode-length-s", "0.1"]
        + ["--video-interval", "1", "--env.viewer.resolution", "64", "48"]
    )
    assert done == 0
    assert list(tmp_path.rglob("model_*.pt"))
    assert list(tmp_path.rglob("*.mp4"))  # short films, every so many iterations


def test_a_training_specification_takes_all_that_an_environment_has():
    known = {f.name for f in fields(TrainingSpec)}
    missing = set(ManagerBasedRLEnvCfg.__dataclass_fields__) - known - {"IGNORED", "rerender_on_reset"}
    assert not missing


def test_objects_metrics_and_managers_of_ones_own_come_into_the_environment(task):
    balls = ObjectPoolCfg(objects=solid("Ball", SphereCfg, (0.0, 0.0, 1.0), radius=0.1), count=2)
    full = replace(
        task,
        objects=ObjectManagerCfg(balls=balls),
        metrics={"height": MetricTermCfg(func=mdp.is_alive)},
        managers={"energy": EnergyManagerCfg()},
    )
    with LabScene(full.to_env_cfg()) as lab:
        lab.reset()
        assert lab.object_manager["balls"].active.all()
        assert lab.metrics_manager.active_terms == ["height"]
        assert list(lab.custom_managers) == ["energy"]


# -- scene interface


def test_a_scene_is_expressed_by_terrain_palette_lights_and_places():
    spec = Field()
    assert list(spec.palette) == ["stones"]
    terrain = spec.create(seed=2).terrain
    assert terrain.size == (12.0, 12.0)
    assert len(terrain.placed["stones"]) == 5
    assert terrain.ground.patches["init_pos"].shape[-1] == 3


def test_a_seed_gives_the_same_scene(tmp_path):
    files = [Field().create(seed=3).export(tmp_path / f"{i}.usda").read_bytes() for i in range(2)]
    assert files[0] == files[1]
    assert files[0] != Field().create(seed=4).export(tmp_path / "other.usda").read_bytes()


def test_the_scene_interface_works_without_a_task():
    cfg = Field().create_instance(num_envs=2, env_spacing=1.0).get_scene(ANT_CFG)
    assert isinstance(cfg, InteractiveSceneCfg)
    with LabScene(cfg, sim=SimulationCfg(dt=1 / 120, device="cpu")) as lab:
        lab.reset()
        lab.step()
        assert lab.scene.terrain.ground is not None


def test_generating_needs_no_simulation(tmp_path, monkeypatch):
    monkeypatch.setattr(Simulation, "__init__", None)  # making one would be an error
    file = Field().create(seed=1).export(tmp_path / "field.usda")
    stage = Usd.Stage.Open(str(file))
    stones = [prim for prim in stage.Traverse() if prim.IsInstance()]
    assert len(stones) == 5


def test_both_interfaces_are_extended_by_subclasses():
    class Pebbles(Stones):
        def find_positions(self, terrain, rng):
            return super().find_positions(terrain, rng)[:2]

    class Beach(Field):
        def survey(self, terrain):
            terrain.maps["wet"] = (terrain.ground.heights < 0.0).astype(float)

    beach = Beach()
    beach.add_asset(Pebbles("pebbles", BoxMesh("pebble", (0.1, 0.1, 0.1))))
    scene = beach.create(seed=1)
    assert len(scene.terrain.placed["pebbles"]) == 2
    assert "wet" in scene.terrain.maps


# -- machine and pictures


def test_a_small_machine_without_a_display_is_enough(task):
    with LabScene(task.to_env_cfg(), render_mode="rgb_array") as lab:  # on the CPU, two environments
        lab.reset()
        assert lab.device == "cpu"
        assert lab.render().std() > 1.0


def test_a_live_view_streams_to_a_browser(capsys):  # tests/cli/test_run_commands.py and tests/viewers look at one
    assert main(["play", "--help"]) == 0
    assert "viser" in capsys.readouterr().out


# -- showcase: sim.py and task.py


def test_a_generated_scene_is_simulated_and_looked_at(tmp_path):
    spec = "tests.designs.test_scene_and_training_specs:Field"
    out = tmp_path / "walk.mp4"
    arguments = ["--drop", "3", "--seconds", "1", "--viewer", "video", "--out", str(out), "--resolution", "160", "96"]
    assert main(["scene", "simulate", spec, *arguments]) == 0
    assert out.stat().st_size > 1000


def test_the_forest_is_the_showcase():
    assert {"Stripe-Forest-Walk-Quadruped-v0", "Stripe-Forest-Reach-Quadruped-v0"} <= set(task_ids())
