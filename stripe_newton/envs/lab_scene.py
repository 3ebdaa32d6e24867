# SPDX-License-Identifier: Apache-2.0
"""Lab scene: a scene with its managers, which are made from a config of terms, and a step that is one CUDA graph."""

from __future__ import annotations

from collections.abc import Iterator
from typing import ClassVar

import torch
import warp as wp

from stripe_newton.assets import ArticulationCfg, AssetBaseCfg, TerrainBaseCfg
from stripe_newton.configclass import ConfigError, configclass, is_config
from stripe_newton.fusion import (
    Plan,
    Stage,
    usage_of,
)
from stripe_newton.managers import (
    ActionManager,
    CommandManager,
    CurriculumManager,
    CustomManagerCfg,
    EventManager,
    ManagerBase,
    MetricsManager,
    ObjectManager,
    ObservationManager,
    RecorderManager,
    RewardManager,
    TerminationManager,
    prestartup_events,
    spawn_object_pools,
)
from stripe_newton.managers.custom_manager import make_custom_managers
from stripe_newton.managers.manager_base import terms_of
from stripe_newton.managers.outside_step import OutsideStep
from stripe_newton.scene import InteractiveSceneCfg, SceneBuilder, SceneController, SceneQuerier
from stripe_newton.sensors import SensorCfg
from stripe_newton.sim import SimulationCfg

from .built_scene import Extras, Observations
from .env_state import EnvState
from .manager_based_rl_env_cfg import MAX_STEPS, ManagerBasedRLEnvCfg
from .manager_stages import ManagerStages
from .name_checks import name_problems
from .stepped_scene import SteppedScene

__all__ = ["LabScene", "LabSceneCfg"]

_OBSERVABLES = {"body_acc": "body_qdd", "body_parent_wrench": "body_parent_f"}
"""Fields of articulations that the solver reports on request only, with Newton's name of the request."""
_FIELDS = "observations", "rewards", "terminations", "events", "curriculum", "metrics", "commands", "actions"


@configclass
class LabSceneCfg(InteractiveSceneCfg):
    """Config of a scene by what stands in it: terrain, robot, objects and sensors, in this order.

    A prim path that is not given is ``{ENV_REGEX_NS}/NAME``, with the name in camel case. Further assets and sensors
    may be fields of a subclass.
    """

    terrain: TerrainBaseCfg | AssetBaseCfg | None = None
    """The ground."""
    robot: ArticulationCfg | None = None
    """The robot."""
    objects: dict[str, AssetBaseCfg] = {}
    """Rigid objects, static assets and lights by name."""
    sensors: dict[str, SensorCfg] = {}
    """Sensors by name."""


class LabScene(SteppedScene):
    """The scene of a task with its managers: builds and steps both, and answers at any moment, without gymnasium.

    Terms are Warp functions. Each manager generates source code, neighbouring managers become one kernel, and a step is
    one CUDA graph. A torch term runs eagerly between graphs; :meth:`describe` lists which. A step runs in this order:
    actions, physics, terminations, rewards, metrics; for environments that ended curriculum, log and reset; then
    interval events, forward kinematics, commands, observations. :class:`ManagerBasedRLEnv` is a lab scene with the
    interface of gymnasium.

    A scene without a task has no terms; a step is then the physics, and a reset brings back the default state::

        with LabScene(LabSceneCfg(num_envs=4, env_spacing=3.0, robot=ANT_CFG), sim=SimulationCfg(dt=1 / 120)) as lab:
            lab.reset()
            lab.step()
            lab.querier.get_robot_state()

    Attributes:
        action_manager, observation_manager, reward_manager, termination_manager, event_manager, command_manager,
        curriculum_manager, object_manager, metrics_manager, recorder_manager: The managers.
        custom_managers: Managers of your own, by name.
    """

    cfg: ManagerBasedRLEnvCfg
    needs_policy: ClassVar[bool] = False
    """Whether there must be a group of observations for a policy."""

    def __init__(
        self,
        cfg: ManagerBasedRLEnvCfg | InteractiveSceneCfg,
        render_mode: str | None = None,
        *,
        sim: SimulationCfg | None = None,
        decimation: int = 1,
        **kwargs: object,
    ):
        """Build scene, simulation and managers.

        Args:
            cfg: Config of a task, which is copied, or of a scene without one.
            render_mode: ``"rgb_array"`` for :meth:`render` to return pictures.
            sim: Settings of the simulation, for a scene without a task.
            decimation: Physics steps in a step, for a scene without a task.
            kwargs: Not used; a subclass may have arguments of its own, and unknown ones are an error.

        Raises:
            ConfigError: all problems of the config at once.
            TypeError: for an unknown argument, or settings of the simulation beside the config of a task, which has its
                own.
        """
        if isinstance(cfg, InteractiveSceneCfg):
            cfg = _without_task(cfg, sim or SimulationCfg(), decimation)
        elif sim is not None or decimation != 1:
            raise TypeError(f"{type(cfg).__name__} has 'sim' and 'decimation' itself; set them there")
        super().__init__(cfg, render_mode, **kwargs)
        self._make_managers()
        stages = self._stages()
        problems = self.context.problems
        if self.needs_policy and "policy" not in self.observation_manager.buffers:
            problems.append("observations: has no group 'policy'; the learner needs it")
        if problems:
            raise ConfigError(problems)
        graph = self.cfg.sim.use_cuda_graph
        self._plan = Plan("step", stages, self.context.scope, self.num_envs, self.device, graph)
        self._action_input = wp.to_torch(self.action_manager.input)
        self._make_spaces()
        self._startup()

    # -- the scene

    @property
    def builder(self) -> SceneBuilder:
        """Builds the scene."""
        return self.scene.builder

    @property
    def controller(self) -> SceneController:
        """Changes the scene: actions, resets, dynamics."""
        return self.scene.controller

    @property
    def querier(self) -> SceneQuerier:
        """Reads the scene: states, sensors, contacts."""
        return self.scene.querier

    # -- construction

    def _make_managers(self) -> None:
        cfg, context = self.cfg, self.context
        if self._reads("external_wrench"):
            self.sim.enable_external_wrench()
        self._provide_structs()
        # First, as terms of the others may read structs that they offer.
        self.custom_managers = make_custom_managers(cfg.managers, context)
        self.event_manager = EventManager(cfg.events, context)
        self.object_manager = ObjectManager(cfg.objects, context)
        self.action_manager = ActionManager(cfg.actions, context)
        self.command_manager = CommandManager(cfg.commands, context)
        self.termination_manager = TerminationManager(cfg.terminations, context)
        self.reward_manager = RewardManager(cfg.rewards, context, cfg.scale_rewards_by_dt)
        self.metrics_manager = MetricsManager(cfg.metrics, context)
        self.observation_manager = ObservationManager(cfg.observations, context, self._reserve_observations)
        self.curriculum_manager = CurriculumManager(cfg.curriculum, context)
        self.recorder_manager = RecorderManager(cfg.recorders, context)
        self._outside = OutsideStep(context)
        if self.action_manager.total_action_dim:
            self.controller.process_actions = self.action_manager.process
        if self.event_manager.dynamics_terms:
            self.controller.randomize_by_events = self.event_manager.randomize_dynamics

    def _provide_structs(self) -> None:
        """Offer structs of a subclass to its terms, by ``self.context.provide(struct, name)``. The default offers none.

        A term then has an argument of the struct's type, and is given the struct of the name in its params.
        """

    def _terms(self) -> Iterator[wp.Function]:
        """Warp functions of all terms in the config."""
        todo: list[object] = [getattr(self.cfg, name) for name in (*_FIELDS, "managers")]
        while todo:
            cfg = todo.pop()
            for value in cfg.values() if isinstance(cfg, dict) else vars(cfg).values() if is_config(cfg) else ():
                if isinstance(value, wp.Function):
                    yield value
                elif isinstance(value, dict) or is_config(value):
                    todo.append(value)
                if isinstance(value, CustomManagerCfg):
                    yield from value.class_type.functions

    def _reads(self, field: str) -> bool:
        """Whether a Warp term reads or writes a field, or cannot be known not to."""
        return any(usage_of(function).may_use([field]) for function in self._terms())

    def _prepare_simulation(self) -> None:
        wanted = [observable for field, observable in _OBSERVABLES.items() if self._reads(field)]
        self.sim.cfg.observables = tuple(dict.fromkeys([*self.sim.cfg.observables, *wanted]))

    def _name_problems(self) -> Iterator[str]:
        return name_problems({name: getattr(self.cfg, name) for name in _FIELDS}, self.scene)

    def _setup_scene(self) -> None:
        spawn_object_pools(self.cfg.objects, self.scene)
        for item in prestartup_events(self.cfg.events, self):
            item.function()
        self.scene.clone_environments()

    def _num_terminations(self) -> int:
        return len(terms_of(self.cfg.terminations))

    def _reserve_observations(self, name: str, size: int) -> wp.array:
        shape = self.num_envs, size
        array = self.outputs.reserve(f"obs.{name}", wp.float32, shape)
        self.context.arrays[f"obs.{name}"] = array
        if self.cfg.compute_final_obs:
            self.outputs.reserve(f"final.{name}", wp.float32, shape)
        return array

    # -- answers between steps

    def compute_observations(self) -> Observations:
        """Observations of the present state by group; see :meth:`ObservationManager.compute`."""
        return self.observation_manager.compute()

    def compute_rewards(self) -> torch.Tensor:
        """Reward of the present state, and of the ends of episodes that it means, float, shape ``(num_envs,)``.

        Sums of the episode and states of terms stay as they are.
        """
        managers = self.termination_manager, self.reward_manager
        states = [state for manager in managers for state in manager.instance_states()]
        with self._outside.computed("rewards", lambda: [i for m in managers for i in m.compute_items()], states):
            return self.reward_buf.clone()

    def compute_terminations(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Terminated and truncated by the present state, bool, shape ``(num_envs,)`` each. Nothing is reset."""
        return self.termination_manager.compute()

    def _make_spaces(self) -> None:
        """Make spaces of observations and actions. A lab scene has none; startup events may ask for them."""

    def _startup(self) -> None:
        items = self.event_manager.startup_items()
        items += [item for manager in self.custom_managers.values() for item in manager.startup_items()]
        if items:
            context = self.context
            plan = Plan("startup", [Stage("startup", items)], context.scope, self.num_envs, self.device, False)
            if context.problems:
                raise ConfigError(context.problems)
            plan.run()
            self.sim.forward()

    # -- the step

    def step(
        self, action: torch.Tensor | None = None
    ) -> tuple[Observations, torch.Tensor, torch.Tensor, torch.Tensor, Extras]:
        """See :meth:`SteppedScene.step`. A scene without action terms takes no actions.

        Raises:
            ValueError: also if there are no actions for the action terms.
        """
        if action is None:
            action = torch.empty(self._action_shape, device=self.device)
            if action.numel():
                raise ValueError(f"step needs actions of shape {tuple(action.shape)}")
        return super().step(action)

    def _stages(self) -> list[Stage]:
        maker = ManagerStages(self, self._safety)
        stages = maker.make()
        self._defers_bodies = maker.defers_bodies
        return stages

    @property
    def _action_shape(self) -> tuple[int, ...]:
        return self.num_envs, self.action_manager.total_action_dim

    def begin_step(self) -> None:
        self.context.config_watch.take()
        super().begin_step()

    def _take_action(self, action: torch.Tensor) -> None:
        self._action_input.copy_(action)

    def _collect_observations(self, values: dict[str, torch.Tensor]) -> Observations:
        return self._groups(values, "obs")

    def _final_extras(self, values: dict[str, torch.Tensor]) -> Extras:
        if not self.cfg.compute_final_obs:
            return {}
        ended = values["terminated"] | values["truncated"]
        return {"final_obs": self._groups(values, "final"), "_final_obs": ended}

    def _groups(self, values: dict[str, torch.Tensor], prefix: str) -> Observations:
        groups: Observations = {}
        manager = self.observation_manager
        for name, buffer in manager.buffers.items():
            if isinstance(buffer, dict):
                groups[name] = {k: values[f"{prefix}.{name}.{k}"].view(-1, *manager.shape(name, k)) for k in buffer}
            else:
                groups[name] = values[f"{prefix}.{name}"].view(-1, *manager.shape(name))
        return groups

    # -- public properties

    @property
    def managers(self) -> list[ManagerBase]:
        """All managers that have terms."""
        every = [v for v in vars(self).values() if isinstance(v, ManagerBase)]
        return [m for m in every if m.active_terms] + list(self.custom_managers.values())

    @property
    def actions(self) -> torch.Tensor:
        """Actions of the last step, shape ``(num_envs, total_action_dim)``."""
        return self.action_manager.action

    @property
    def processed_actions(self) -> torch.Tensor:
        """Actions of the last step after the action terms' scale, offset and clip, shape ``(num_envs, n)``."""
        return self.action_manager.processed_actions

    def describe(self, kernels: bool = False) -> str:
        """The managers with their terms, the stages of a step, and what of it is one CUDA graph, in plain text.

        Args:
            kernels: Also the source of the generated kernels.
        """
        steps = super().describe(kernels)  # first, as it refuses a closed environment
        return "\n\n".join([*map(str, self.managers), steps])

    def set_state(self, state: EnvState) -> None:
        """See :meth:`SteppedScene.set_state`. Recordings of the episodes under way are dropped."""
        super().set_state(state)
        self.recorder_manager.clear()

    def state_parts(self) -> list[dict[str, torch.Tensor]]:
        """Tensors of class terms; see :meth:`SteppedScene.state_parts`."""
        every = [v for v in vars(self).values() if isinstance(v, ManagerBase)]
        every += self.custom_managers.values()
        return [part for manager in every for part in manager.instance_states()]

    def close_extras(self, **kwargs: object) -> None:
        """Release the recorder's file, renderer and simulation."""
        if "recorder_manager" in vars(self):  # the constructor may have failed before
            self.recorder_manager.close()
        super().close_extras(**kwargs)


def _without_task(scene: InteractiveSceneCfg, sim: SimulationCfg, decimation: int) -> ManagerBasedRLEnvCfg:
    """Config of a scene without a task: no terms, and episodes that only a reset ends."""
    return ManagerBasedRLEnvCfg(
        scene=scene,
        sim=sim,
        decimation=decimation,
        episode_length_s=MAX_STEPS * decimation * sim.dt,
        observations={},
        actions={},
        rewards={},
        terminations={},
        events={},
    )
