# SPDX-License-Identifier: Apache-2.0
"""Robot with events that randomise its model, and the same model in MuJoCo on the CPU."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import warp as wp

from stripe_kernels import mdp
from stripe_kernels.model_data import EncoderData
from stripe_newton.assets import ArticulationCfg
from stripe_newton.managers import EventManager, EventTermCfg, ManagerContext, SceneEntityCfg
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import GroundPlaneCfg, MuJoCoSolverCfg, Simulation, SimulationCfg
from tests.helpers.manager_world import plan, set_reset

SOLVER_FIELDS = (
    "body_mass", "body_ipos", "body_inertia", "body_iquat", "body_subtreemass", "body_invweight0", "dof_invweight0",
    "dof_armature", "dof_frictionloss", "dof_damping", "jnt_stiffness", "jnt_range", "jnt_solref", "jnt_actfrcrange",
    "actuator_gainprm", "actuator_biasprm", "geom_friction", "geom_gap", "geom_margin", "geom_pos", "geom_quat",
    "geom_size", "geom_rbound", "geom_aabb", "site_pos", "site_quat",
)  # fmt: skip
"""Arrays of MuJoCo Warp's model, one row a world."""


class RandomizedWorld:
    """A scene of one robot on a plane, whose event manager is at work."""

    def __init__(
        self,
        robot: ArticulationCfg,
        events: dict[str, EventTermCfg],
        num_envs: int = 4,
        seed: int = 0,
        solver: Any = None,
        mjcf: Path | None = None,
        ground: bool = True,
        device: str = "cpu",
    ):
        solver = solver or MuJoCoSolverCfg(
            save_to_mjcf=str(mjcf) if mjcf else None, iterations=100, ls_iterations=50, tolerance=1e-10
        )
        self.sim = sim = Simulation(SimulationCfg(device=device, dt=0.005, solver=solver))
        scene = InteractiveScene(InteractiveSceneCfg(num_envs=num_envs, env_spacing=4.0), sim)
        with scene.construction():
            if ground:
                cfg = GroundPlaneCfg()
                cfg.func("/World/ground", cfg)
            scene.builder.build_robot("robot", robot.replace(prim_path="{ENV_REGEX_NS}/Robot"))
        scene.clone_environments()
        scene.build()
        self.scene = scene
        self.context = context = ManagerContext(
            scene, step_dt=0.02, decimation=4, max_episode_length_s=1.0, max_episode_length=50
        )
        context.seed(seed)
        self.robot = scene.articulations["robot"]
        self.manager = EventManager(events, context)
        self._reset = self.manager.reset_items()
        self._startup, self._interval, self._step = (
            getattr(self.manager, f"{n}_items")() for n in ("startup", "interval", "step")
        )
        self._plans: dict[str, Any] = {}

    def run(self, mode: str) -> None:
        """Run the events of a mode."""
        if mode not in self._plans:
            self._plans[mode] = plan(self.context, self.items(mode))
        self._plans[mode].run()

    def items(self, mode: str) -> list[Any]:
        """The items of a mode."""
        found: list[Any] = getattr(self, f"_{mode}")
        return found

    def reset(self, *envs: int) -> None:
        """Run the reset events in some environments, by default in all."""
        there = range(self.context.num_envs)
        set_reset(self.context, [i in (envs or there) for i in there])
        self.run("reset")

    def model(self, name: str) -> np.ndarray:
        """A copy of an array of Newton's model, one row an environment."""
        values: np.ndarray = self.scene.controller.field(name)[0].cpu().numpy().copy()
        return values

    def default(self, name: str) -> np.ndarray:
        """A copy of what it was as the model was built."""
        values: np.ndarray = self.scene.controller.field(name)[1].cpu().numpy().copy()
        return values

    def solver_model(self) -> dict[str, np.ndarray]:
        """A copy of the solver's arrays."""
        found = {n: getattr(self.sim.solver.mjw_model, n).numpy().copy() for n in SOLVER_FIELDS}
        return found | {"gravity": self.sim.solver.mjw_model.opt.gravity.numpy().copy()}

    def reference(self, mjcf: Path, env: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """A model of MuJoCo's, compiled from ``mjcf``, with the quantities of an environment, constants set anew."""
        model, newton_model, solver = mujoco.MjModel.from_xml_path(str(mjcf)), self.sim.model, self.sim.solver
        for i, body in enumerate(solver.mjc_body_to_newton.numpy()[env]):
            if body >= 0:
                model.body_mass[i] = newton_model.body_mass.numpy()[body]
                model.body_ipos[i] = newton_model.body_com.numpy()[body]
                moments, axes = np.linalg.eigh(newton_model.body_inertia.numpy()[body].astype(np.float64))
                moments, axes = moments[::-1], axes[:, ::-1]
                axes = axes * np.sign(np.linalg.det(axes))
                model.body_inertia[i] = moments
                mujoco.mju_mat2Quat(model.body_iquat[i], np.ascontiguousarray(axes).ravel())
        for i, dof in enumerate(solver.mjc_dof_to_newton_dof.numpy()[env]):
            model.dof_armature[i] = newton_model.joint_armature.numpy()[dof]
            model.dof_frictionloss[i] = newton_model.joint_friction.numpy()[dof]
            model.dof_damping[i] = newton_model.joint_damping.numpy()[dof]
        for i, dof in enumerate(solver.mjc_jnt_to_newton_dof.numpy()[env]):
            if model.jnt_type[i] >= int(mujoco.mjtJoint.mjJNT_SLIDE):
                lower, upper = (getattr(newton_model, f"joint_limit_{e}").numpy()[dof] for e in ("lower", "upper"))
                model.jnt_range[i] = np.array([lower, upper]) + model.qpos0[model.jnt_qposadr[i]]
                model.jnt_stiffness[i] = newton_model.joint_stiffness.numpy()[dof]
                model.jnt_actfrcrange[i] = newton_model.joint_effort_limit.numpy()[dof] * np.array([-1.0, 1.0])
        for i in range(model.nu):
            dof = solver.mjc_dof_to_newton_dof.numpy()[env][model.jnt_dofadr[model.actuator_trnid[i, 0]]]
            kp, kd = (getattr(newton_model, f"joint_target_{g}").numpy()[dof] for g in ("ke", "kd"))
            if model.actuator_biasprm[i, 1] != 0.0:
                model.actuator_gainprm[i, 0], model.actuator_biasprm[i, 1:3] = kp, (-kp, -kd)
            else:
                model.actuator_gainprm[i, 0], model.actuator_biasprm[i, 2] = kd, -kd
        for i, shape in enumerate(solver.mjc_geom_to_newton_shape.numpy()[env]):
            names = ("mu", "mu_torsional", "mu_rolling")
            model.geom_friction[i] = [getattr(newton_model, f"shape_material_{n}").numpy()[shape] for n in names]
            model.geom_gap[i] = newton_model.shape_gap.numpy()[shape]
            if model.geom_bodyid[i] > 0:
                x, y, z, w = newton_model.shape_transform.numpy()[shape][3:]
                model.geom_pos[i], model.geom_quat[i] = newton_model.shape_transform.numpy()[shape][:3], (w, x, y, z)
                model.geom_size[i] = newton_model.shape_scale.numpy()[shape]
        model.opt.gravity[:] = newton_model.gravity.numpy()[env]
        data = mujoco.MjData(model)
        mujoco.mj_setConst(model, data)
        solver_limits = solver.mjw_model.jnt_solref.numpy()[env]
        model.jnt_solref[:] = solver_limits
        return model, data


def all_arrays(world: RandomizedWorld) -> dict[str, np.ndarray]:
    """Everything that an event may have changed: Newton's arrays and the solver's, one row a world."""
    mine = {n: world.model(n) for n in world.scene.controller.randomized}
    return mine | world.solver_model() | {"encoder": _bias(world).numpy().copy()}


def _bias(world: RandomizedWorld) -> wp.array:
    return world.context.structs.provided[EncoderData]["robot"].bias


def event(func: Any, mode: str = "reset", cfg: Any = None, **params: Any) -> EventTermCfg:
    fields = {"interval_range_s": (0.02, 0.02)} if mode == "interval" else {}
    return EventTermCfg(func=func, mode=mode, params={"asset_cfg": cfg or SceneEntityCfg("robot"), **params}, **fields)


def events(mode: str) -> dict[str, EventTermCfg]:
    joints = {"operation": "add", "friction_distribution_params": (0.1, 0.5),
              "armature_distribution_params": (0.0, 0.02),
              "lower_limit_distribution_params": (0.0, 0.4), "upper_limit_distribution_params": (-0.4, 0.0),
              "stiffness_distribution_params": (0.0, 3.0), "damping_distribution_params": (0.0, 0.2)}  # fmt: skip
    return {
        "mass": event(mdp.randomize_rigid_body_mass, mode, mass_distribution_params=(0.5, 2.0), operation="scale"),
        "inertia": event(mdp.randomize_rigid_body_inertia, mode, SceneEntityCfg("robot", body_names="base"),
                         inertia_distribution_params=(0.01, 0.02), operation="add", diagonal_only=False),
        "com": event(mdp.randomize_rigid_body_com, mode, com_range={"x": (-0.03, 0.03), "y": (-0.03, 0.03)}),
        "gains": event(mdp.randomize_actuator_gains, mode, stiffness_distribution_params=(10.0, 60.0),
                       damping_distribution_params=(0.3, 2.0), operation="abs"),
        "effort": event(mdp.randomize_effort_limits, mode, effort_limit_range=(0.2, 0.5)),
        "joints": event(mdp.randomize_joint_parameters, mode, **joints),
        "material": event(mdp.randomize_rigid_body_material, mode, static_friction_range=(0.3, 1.2)),
        "offsets": event(mdp.randomize_rigid_body_collider_offsets, mode,
                         contact_offset_distribution_params=(0.0, 0.01)),
        "pose": event(mdp.randomize_geom_pose, mode, pose_range={"z": (-0.01, 0.01), "roll": (-0.2, 0.2)}),
        "size": event(mdp.randomize_geom_size, mode, ranges=(0.8, 1.2)),
        "gravity": event(mdp.randomize_physics_scene_gravity, mode, operation="add",
                         gravity_distribution_params=([-1.0, -1.0, -1.0], [1.0, 1.0, 1.0])),
    }  # fmt: skip
