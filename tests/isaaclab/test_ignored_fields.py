# SPDX-License-Identifier: Apache-2.0
"""Fields of Isaac Lab's configs that have no effect: they are taken, and a warning names each that is set."""

import warnings

import pytest

from stripe_newton.configclass import ConfigError
from stripe_newton.isaaclab import direct_envs, sensors, simulation_cfg, spawners
from stripe_newton.isaaclab.stand_ins import stand_in


def test_defaults_are_silent_and_settings_of_physx_are_named_once():
    cfg = simulation_cfg.SimulationCfg()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        cfg.validate()
        cfg.copy().replace(dt=0.01).validate()
    cfg.physx.bounce_threshold_velocity = 0.2
    cfg.physx.gpu_max_rigid_contact_count = 2**20
    with pytest.warns(UserWarning, match="SimulationCfg.physx has no effect: physics is Newton's") as found:
        cfg.validate()
    assert len(found) == 1
    assert simulation_cfg.SimulationCfg().physx == simulation_cfg.PhysxCfg()  # the defaults are not shared


def test_settings_by_constructor():
    cfg = simulation_cfg.SimulationCfg(
        physx=simulation_cfg.PhysxCfg(solver_type=1), render=simulation_cfg.RenderCfg(enable_reflections=True)
    )
    assert cfg.physx.solver_type == 1
    with pytest.warns(UserWarning, match="has no effect") as found:
        cfg.validate()
    assert sorted(str(w.message).split(" has")[0] for w in found) == ["SimulationCfg.physx", "SimulationCfg.render"]


def test_the_settings_of_an_environment_are_those_with_physx():
    for cls in (direct_envs.DirectRLEnvCfg, direct_envs.DirectMARLEnvCfg):
        cfg = cls(decimation=1, episode_length_s=1.0)
        cfg.sim.physx.enable_stabilization = True
        cfg.viewer.eye = (3.0, 0.0, 1.0)  # without lookat, whose default then counts
        cfg.viewer.validate()
        assert cfg.viewer.lookat == (0.0, 0.0, 0.0)
        assert cls().sim.physx == simulation_cfg.PhysxCfg()


def test_markers_and_materials_are_named():
    marker = stand_in("VisualizationMarkersCfg", "inert", "none are drawn")
    with pytest.warns(UserWarning, match="visualizer_cfg has no effect: sensors draw no markers"):
        sensors.ImuCfg(prim_path="/World/x", visualizer_cfg=marker()).validate()
    with pytest.warns(UserWarning, match="mdl_path has no effect"):
        simulation_cfg.MdlFileCfg(mdl_path="x.mdl").validate()


def test_what_changes_the_physics_is_refused(tmp_path):
    file = tmp_path / "robot.usda"
    file.write_text("#usda 1.0\n")
    with pytest.raises(ConfigError, match="deformable bodies are not simulated"):
        spawners.UsdFileCfg(usd_path=str(file), deformable_props=object()).validate()
