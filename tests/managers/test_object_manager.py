# SPDX-License-Identifier: Apache-2.0
"""Object manager: pools of objects in a real scene, which appear, touch things and retire without side effects."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
import warp as wp

from stripe_kernels.mdp import objects as mdp
from stripe_newton.assets import AssetBaseCfg, RigidObjectCfg
from stripe_newton.configclass import ConfigError, configclass
from stripe_newton.fusion import Section, bind_term, block, code
from stripe_newton.managers import ManagerContext, ObjectPoolCfg, spawn_object_pools
from stripe_newton.managers.object_manager import ObjectManager
from stripe_newton.scene import InteractiveScene, InteractiveSceneCfg
from stripe_newton.sim import (
    CollisionPropertiesCfg,
    CuboidCfg,
    GroundPlaneCfg,
    MassPropertiesCfg,
    MuJoCoSolverCfg,
    RigidBodyPropertiesCfg,
    Simulation,
    SimulationCfg,
    SphereCfg,
    XPBDSolverCfg,
)
from stripe_newton.sim.overflow import SolverOverflow
from stripe_tasks.robots import ANT_CFG
from tests.helpers.manager_world import manager_context, plan, run, set_reset
from tests.helpers.solver_contacts import contact_count, touching_geoms, watch_contacts

N, DT, SUBSTEPS, RADIUS = 4, 1.0 / 120.0, 2, 0.1
REGION = {"x": (-1.5, 1.5), "y": (-1.0, 1.0), "z": (0.0, 0.2), "yaw": (-3.0, 3.0)}
FALL = 9.81 * (SUBSTEPS * DT) ** 2
"""More than a body falls in one environment step [m]."""


def body(shape: Any, name: str, pos: tuple[float, float, float]) -> RigidObjectCfg:
    props = {"rigid_props": RigidBodyPropertiesCfg(), "collision_props": CollisionPropertiesCfg()}
    spawn = shape.replace(mass_props=MassPropertiesCfg(mass=0.5), **props)
    state = RigidObjectCfg.InitialStateCfg(pos=pos)
    return RigidObjectCfg(prim_path=f"{{ENV_REGEX_NS}}/{name}", spawn=spawn, init_state=state)


def balls(count: int = 4, **changes: Any) -> ObjectPoolCfg:
    one = body(SphereCfg(radius=RADIUS), "Ball", (0.0, 0.0, RADIUS))
    return ObjectPoolCfg(objects=one, count=count).replace(**changes)


def boxes(**changes: Any) -> ObjectPoolCfg:
    size = CuboidCfg(size=(0.2, 0.2, 0.2))
    named = {n: body(size, n.title(), (x, 1.5, 0.1)) for n, x in (("red", -0.5), ("green", 0.5))}
    return ObjectPoolCfg(objects=named).replace(**changes)


def cfg(solver: Any = None) -> SimulationCfg:
    return SimulationCfg(device="cpu", dt=DT, solver=solver or MuJoCoSolverCfg(nconmax=64, njmax=256))


class World:
    """Pools, a ground and perhaps a robot, stepped as an environment would."""

    def __init__(self, pools: dict[str, ObjectPoolCfg], robot: bool = False, solver: Any = None, num_envs: int = N):
        self.scene = scene = InteractiveScene(
            InteractiveSceneCfg(num_envs=num_envs, env_spacing=5.0), Simulation(cfg(solver))
        )
        scene.builder.build_objects({"ground": AssetBaseCfg(prim_path="/World/ground", spawn=GroundPlaneCfg())})
        if robot:
            scene.builder.build_robot("robot", ANT_CFG.replace(prim_path="{ENV_REGEX_NS}/Robot"))
        spawn_object_pools(pools, scene)
        scene.clone_environments()
        scene.build()
        self.sim = scene.sim
        if hasattr(self.sim.solver, "mjw_data"):
            watch_contacts(self.sim.solver)
        self.context = ManagerContext(scene, SUBSTEPS * DT, SUBSTEPS, 1.0, 60)
        self.manager = ObjectManager(pools, self.context)
        assert not self.context.problems, self.context.problems
        self.plan = plan(self.context, self.manager.reset_items(), self.manager.update_items())
        self.moved = wp.to_torch(self.context.moved)

    def after_physics(self, reset: list[int] | slice = slice(0, 0)) -> None:
        mask = torch.zeros(self.scene.num_envs, dtype=torch.bool)
        mask[reset] = True
        set_reset(self.context, mask)
        self.moved[:] = mask
        self.plan.run()
        self.sim.forward(self.moved.clone())

    def step(self, reset: list[int] | slice = slice(0, 0)) -> None:
        self.sim.step(SUBSTEPS)
        self.after_physics(reset)

    def touching(self) -> set[tuple[int, int]]:
        """World and body of all contacts of the last physics step."""
        worlds, geoms = touching_geoms(self.sim.solver)
        of_geom, of_body = self.sim.solver.mjw_model.geom_bodyid.numpy(), self.sim.solver.mjc_body_to_newton.numpy()
        found = {(int(w), int(of_body[w, of_geom[g]])) for w, pair in zip(worlds, geoms, strict=True) for g in pair}
        per_env = self.sim.model.body_count // self.scene.num_envs
        return {(w, b % per_env) for w, b in found if b >= 0}

    def active_bodies(self) -> set[tuple[int, int]]:
        return {
            (env, pool.objects[slot].layout.bodies[0])
            for pool in self.manager.pools.values()
            for env, slot in pool.active.nonzero().tolist()
        }

    def state(self) -> dict[str, np.ndarray]:
        """Everything that lasts, one row an environment."""
        arrays = {k: a.numpy() for k, a in self.context.arrays.items() if a.shape[0] == self.scene.num_envs}
        state, count = self.sim.state, self.scene.num_envs
        for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
            arrays[name] = getattr(state, name).numpy().reshape(count, -1)
        return {k: a.copy() for k, a in arrays.items()}


@pytest.fixture
def world() -> World:
    return World({"balls": balls(), "boxes": boxes()})


def parked(world: World, name: str) -> torch.Tensor:
    pool = world.manager[name]
    return pool.parking[:, :3] + world.scene.env_origins.unsqueeze(1)


# -- layout


def test_all_bodies_are_there_from_the_start_each_with_a_parking_place_of_its_own(world):
    assert list(world.scene.rigid_objects) == ["balls_0", "balls_1", "balls_2", "balls_3", "red", "green"]
    places = torch.cat([parked(world, n)[0] for n in ("balls", "boxes")])
    assert torch.pdist(places).min() > 2.0 * np.sqrt(3) * 0.1 + 0.4
    assert (places[:, 2] == 100.0).all()
    homes = world.manager["balls"].home[0, :, :3]
    assert torch.pdist(homes).min() == pytest.approx(1.0)
    assert homes.mean(dim=0).tolist() == pytest.approx([0.0, 0.0, RADIUS])


def test_pose_and_velocity_are_the_state_of_the_simulation(world):
    pool = world.manager["balls"]
    pool.pose[2, 1] = torch.tensor([1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0])
    world.scene.rigid_objects["balls_3"].data.root_vel_w[1] = 7.0
    ball = world.scene.rigid_objects["balls_1"].data
    assert ball.root_pose_w[2].tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0]
    assert pool.data.pose.numpy()[2, 1].tolist() == [1.0, 2.0, 3.0, 0.0, 0.0, 1.0, 0.0]
    assert (pool.data.vel.numpy()[1, 3] == 7.0).all()
    assert (pool.vel[1, 3] == 7.0).all()


# -- reset


def test_a_reset_spawns_all_at_home_and_they_come_to_rest_there(world):
    world.after_physics(slice(None))
    pool = world.manager["balls"]
    home = pool.home[..., :3] + world.scene.env_origins.unsqueeze(1)
    assert pool.active.all()
    torch.testing.assert_close(pool.positions, home)
    assert (pool.age == 0).all()
    for _ in range(60):
        world.step()
    assert (pool.age == 60).all()
    torch.testing.assert_close(pool.positions, home, atol=0.01, rtol=0.0)
    assert pool.vel.abs().max() < 0.05
    assert world.touching() == world.active_bodies()


def test_a_reset_leaves_other_environments_as_they_are_bit_for_bit():
    def run_until_reset(reset: list[int]) -> World:
        made = World({"balls": balls(num_active=(1, 4), pose_range=REGION, min_distance=0.3), "boxes": boxes()})
        made.after_physics(slice(None))
        for _ in range(10):
            made.step()
        made.step(reset)
        for _ in range(10):
            made.step()
        return made

    with_reset, without = run_until_reset([1]).state(), run_until_reset([]).state()
    others = [0, 2, 3]
    for name, array in with_reset.items():
        np.testing.assert_array_equal(array[others], without[name][others], err_msg=name)
    assert not np.array_equal(with_reset["joint_q"][1], without["joint_q"][1])


def test_a_random_number_of_random_objects_apart_from_each_other_and_from_the_robot():
    pools = {
        "balls": balls(6, num_active=(1, 4), pose_range=REGION, min_distance=0.4, min_robot_distance=0.8, max_tries=200)
    }
    world = World(pools, robot=True, num_envs=32)
    robot, pool = world.scene.articulations["robot"], world.manager["balls"]
    robot.data.root_pos_w[:, :2] += 0.5 * torch.randn(32, 2, generator=torch.Generator().manual_seed(0))
    numbers, sets = set(), set()
    for _ in range(8):
        world.after_physics(slice(None))
        numbers |= set(pool.active.sum(dim=1).tolist())
        sets |= {tuple(row) for row in pool.active.tolist()}
        for env, active in enumerate(pool.active):
            place = pool.positions[env, active]
            assert torch.pdist(place).min() >= 0.4 if len(place) > 1 else True
            assert (place - robot.data.root_pos_w[env])[:, :2].norm(dim=1).min() >= 0.8
            local = place - world.scene.env_origins[env]
            assert (local[:, 0].abs() <= 1.5).all()
            assert (local[:, 1].abs() <= 1.0).all()
            assert ((local[:, 2] >= RADIUS - 1e-6) & (local[:, 2] <= RADIUS + 0.2 + 1e-6)).all()
    assert numbers == {1, 2, 3, 4}
    assert len(sets) > 40  # of 56


def test_an_object_without_a_place_stays_retired():
    world = World({"balls": balls(pose_range={"x": (-0.1, 0.1)}, min_distance=1.0)})
    world.after_physics(slice(None))
    pool = world.manager["balls"]
    assert (pool.active.sum(dim=1) == 1).all()
    torch.testing.assert_close(pool.positions[~pool.active], parked(world, "balls")[~pool.active])


def test_targets_are_drawn_at_a_reset_and_else_stay():
    world = World({"balls": balls(target_range={"x": (1.0, 2.0), "z": (0.5, 0.5)}), "boxes": boxes()})
    world.after_physics([0, 1])
    pool, other = world.manager["balls"], world.manager["boxes"]
    drawn = pool.target[:2]
    assert ((drawn[..., 0] >= 1.0) & (drawn[..., 0] <= 2.0)).all()
    assert drawn[..., 0].unique().numel() == 8
    torch.testing.assert_close(drawn[..., 2], torch.full((2, 4), RADIUS + 0.5))
    torch.testing.assert_close(pool.target[2:], pool.home[2:])
    torch.testing.assert_close(other.target, other.home)


def test_the_number_to_spawn_is_a_parameter_that_may_change_while_running():
    world = World({"balls": balls(num_active=1)})
    world.after_physics(slice(None))
    assert (world.manager["balls"].active.sum(dim=1) == 1).all()
    world.context.parameters["objects.balls.num_range"] = (3.0, 3.0)
    world.after_physics(slice(None))
    assert (world.manager["balls"].active.sum(dim=1) == 3).all()


def test_without_respawn_a_reset_leaves_the_pool_to_events():
    world = World({"balls": balls(respawn=False)})
    world.manager["balls"].spawn([0, 1], [0, 2])
    world.after_physics(slice(None))
    assert world.manager["balls"].active.sum(dim=1).tolist() == [2, 2, 0, 0]
    assert "by events" in str(world.manager)


# -- running


def test_active_objects_alone_have_contacts_and_retired_ones_wait_for_300_steps():
    world = World({"balls": balls(num_active=(0, 4), pose_range=REGION, min_distance=0.25), "boxes": boxes()}, True)
    generator = torch.Generator().manual_seed(1)
    world.after_physics(slice(None))
    drift, contacts, retired = 0.0, 0, 0
    for step in range(300):
        expected = world.active_bodies()
        world.sim.step(SUBSTEPS)
        robot = {b for _, b in world.touching()} - {p.layout.bodies[0] for p in world.scene.rigid_objects.values()}
        found = {(w, b) for w, b in world.touching() if b not in robot}
        assert found <= expected
        contacts += len(found)
        for name, pool in world.manager.pools.items():
            away = (pool.positions - parked(world, name))[~pool.active].abs()
            retired += len(away)
            drift = max(drift, float(away.max())) if len(away) else drift
        reset = (torch.rand(N, generator=generator) < 0.03).nonzero().squeeze(-1).tolist()
        world.after_physics(reset)
        if step % 20 == 7:
            env, slot = int(step / 20) % N, int(step / 40) % 4
            world.manager["balls"].retire([env], [slot])
            world.manager["boxes"].spawn([env], slot % 2)
        state = world.state()
        assert all(np.isfinite(state[k]).all() for k in ("joint_q", "joint_qd", "body_q", "body_qd")), step
    assert contacts > 1000
    assert retired > 500
    assert 0.0 < drift < FALL
    (overflow,) = (hook for hook in world.sim.hooks if isinstance(hook, SolverOverflow))
    assert int(overflow.seen.numpy()[0]) == 0


def test_retired_objects_do_not_leave_their_place_over_500_steps():
    world = World({"balls": balls(num_active=0)})
    world.after_physics(slice(None))
    for _ in range(500):
        world.sim.step(SUBSTEPS)
        assert contact_count(world.sim.solver) == 0
        assert (world.manager["balls"].positions - parked(world, "balls")).abs().max() < FALL
        world.after_physics()
    pool = world.manager["balls"]
    assert torch.equal(pool.positions, parked(world, "balls"))
    assert (pool.vel == 0.0).all()
    assert (pool.age == 0).all()


def test_an_object_that_waited_falls_like_one_that_did_not(world):
    pool = world.manager["balls"]
    world.after_physics(slice(None))
    for _ in range(20):
        world.step()
    pool.retire([0], [1])
    for _ in range(20):
        world.step()
    pose = pool.home[:, 1:2].clone()
    pose[..., :3] += world.scene.env_origins.unsqueeze(1)
    pose[..., 2] += 0.3
    pool.spawn([0, 1], 1, pose[:2])
    for _ in range(60):
        world.step()
    height = pool.positions[:2, 1, 2]
    assert height[0] == pytest.approx(float(height[1]), abs=1e-5)
    assert height[0] == pytest.approx(RADIUS, abs=0.01)


def test_only_environments_with_something_new_are_marked_as_moved(world):
    world.after_physics(slice(None))
    world.step()
    assert not world.moved.any()
    retire = world.context.scope.call(mdp.retire_object, "env", world.manager["balls"].struct_name, 3)
    item = Section("retire_one", block(code("if env == 2:"), [retire]))
    run(world.context, [item], world.manager.update_items())
    assert world.moved.tolist() == [False, False, True, False]
    assert world.manager["balls"].active.sum(dim=1).tolist() == [4, 4, 3, 4]


def test_solvers_whose_state_is_that_of_the_bodies_hold_retired_objects_too():
    world = World({"balls": balls(num_active=2)}, solver=XPBDSolverCfg())
    world.after_physics(slice(None))
    for _ in range(30):
        world.step()
    pool = world.manager["balls"]
    bodies = torch.stack([o.data.body_pos_w[:, 0] for o in pool.objects], dim=1)
    assert (bodies - parked(world, "balls"))[~pool.active].abs().max() < FALL
    assert bodies[pool.active][:, 2].max() < 0.2


# -- outside the step


def test_spawn_and_retire_from_torch(world):
    pool, body = world.manager["balls"], world.scene.rigid_objects["balls_2"].data
    pool.retire()
    pose = torch.tensor([0.5, 0.5, 1.0, 0.0, 0.0, 0.0, 1.0]).repeat(2, 1, 1)
    pool.spawn([1, 3], 2, pose, torch.tensor([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert pool.active.nonzero().tolist() == [[1, 2], [3, 2]]
    torch.testing.assert_close(body.body_pose_w[1, 0], pose[0, 0])
    assert body.body_lin_vel_w[3, 0].tolist() == [1.0, 0.0, 0.0]
    torch.testing.assert_close(pool.positions[0], parked(world, "balls")[0])
    world.step()
    assert pool.age[1, 2] == 1
    pool.spawn()
    assert pool.active.all()
    pool.retire(torch.tensor([True, False, False, False]), [0, 1])
    assert pool.active.sum(dim=1).tolist() == [2, 4, 4, 4]
    with pytest.raises(ValueError, match="'balls': no slot 4, there are 0 to 3"):
        pool.spawn(None, 4)
    with pytest.raises(KeyError, match="no object pool 'cubes'; there is balls, boxes"):
        world.manager["cubes"]


def test_how_many_were_active_is_logged_when_episodes_end(world):
    log = world.context.log
    pool = world.manager["balls"]
    pool.spawn([0, 1], [0, 1, 2])
    pool.spawn([2], [0])
    world.after_physics([1, 2])
    log.finish()
    assert log.values.numpy()[log.keys.index("Metrics/balls/active")] == pytest.approx(2.0)
    assert log.values.numpy()[log.keys.index("Metrics/boxes/active")] == 0.0


def test_terms_find_a_pool_by_its_name(world):
    context = world.context
    world.after_physics(slice(None))
    world.manager["balls"].retire([2], [0, 1, 2])
    call = bind_term(context, mdp.object_active, {"pool_name": "balls"}, "observations.policy.objects", "observation")
    assert call is not None
    assert call.counts["num_objects"] == 4
    buffer = context.array("buffer", float, 6)
    name = context.scope.name("buffer", buffer)
    lifted = bind_term(
        context, mdp.object_lifted, {"pool_name": "boxes", "minimal_height": 0.05}, "rewards.lifted", "reward"
    )
    assert lifted is not None
    lines = [call.expression(code("{}[env, 1:5]", name)), code("{}[env, 0] = {}", name, lifted.expression())]
    run(context, [Section("terms", lines)])
    assert buffer.numpy()[2].tolist() == [1.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    assert bind_term(context, mdp.object_active, {}, "observations.policy.none", "observation") is None
    assert "balls, boxes" in context.problems[-1]


def test_the_manager_prints_its_pools(world):
    text = str(world.manager)
    assert "balls  4        balls_0, balls_1, balls_2, balls_3" in text
    assert "red, green" in text
    assert world.manager.active_terms == ["balls", "boxes"]


# -- configs


def test_wrong_configs_are_reported_together():
    wrong = balls(
        0,
        num_active=(2, 1),
        pose_range={"w": (0.0, 1.0)},
        min_distance=-1.0,
        target_range={"x": (1.0, 0.0)},
        max_tries=0,
    )
    with pytest.raises(ConfigError) as error:
        wrong.validate()
    text = str(error.value)
    for part in ("count: is 0", "num_active: is (2, 1)", "has 'w'", "min_distance: is -1.0",
                 "has (1.0, 0.0) for 'x'", "max_tries: is 0"):  # fmt: skip
        assert part in text
    with pytest.raises(ConfigError, match="min_distance: has no effect without 'pose_range'"):
        balls(min_distance=0.5).validate()
    with pytest.raises(ConfigError, match="must be 1 where 'objects' names each object"):
        boxes(count=3).validate()


def test_a_pool_whose_bodies_are_not_in_the_scene_is_a_problem():
    @configclass
    class Pools:
        balls: ObjectPoolCfg = balls(2)
        none: ObjectPoolCfg | None = None
        odd: Any = 3

    context = manager_context(num_envs=1, objects=boxes().bodies("boxes"))
    manager = ObjectManager(Pools(), context)
    assert manager.active_terms == []
    assert manager.reset_items() == manager.update_items() == []
    first, second = context.problems
    assert first == "objects.odd: is int, must be ObjectPoolCfg or None"
    assert second.startswith("objects.balls.objects: the scene has no rigid object balls_0, balls_1; call ")


def test_a_pool_of_bodies_that_are_not_evenly_spaced_is_a_problem():
    named = {n: body(SphereCfg(radius=0.1), n, (i, 0.0, 0.1)) for i, n in enumerate("abcd")}
    context = manager_context(num_envs=1, objects=named)
    pool = ObjectPoolCfg(objects={n: named[n] for n in "abd"})
    assert ObjectManager({"odd": pool}, context).active_terms == []
    assert "not evenly spaced" in context.problems[0]
    context.problems.clear()
    assert ObjectManager({"even": ObjectPoolCfg(objects={n: named[n] for n in "bd"})}, context).active_terms == ["even"]


def test_a_robot_that_is_not_there_is_a_problem():
    pool = boxes(pose_range=REGION, min_robot_distance=0.5, robot_name="dog")
    context = manager_context(num_envs=1, objects=pool.bodies("boxes"))
    ObjectManager({"boxes": pool}, context)
    assert any("objects.boxes" in p and "no asset or sensor 'dog'" in p for p in context.problems)
