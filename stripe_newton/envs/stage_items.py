# SPDX-License-Identifier: Apache-2.0
"""Stage items: parts of a step that all kinds of environments have."""

from __future__ import annotations

from functools import partial

from stripe_newton.fusion import Item, KernelLaunches, Section, code
from stripe_newton.managers import ManagerContext
from stripe_newton.scene import InteractiveScene

__all__ = ["count_section", "launch_scenery_reset", "scenery_items", "sensor_items"]


def count_section(context: ManagerContext, parts: int = 0) -> Section:
    """Section that counts the environment steps on the device. One thread does it for all environments.

    Args:
        context: The context of the environment.
        parts: 1 to join a kernel in which a section has one thread for each number of an environment; 0 otherwise.
    """
    count = context.code("    {step}[0] = {step}[0] + wp.int64(1)")
    return Section("count", [code("if env == 0:"), count], parts=parts)


def sensor_items(scene: InteractiveScene, context: ManagerContext, when: str) -> list[Item]:
    """Launches of the sensors that measure at a point of the step.

    Args:
        scene: The scene, which has the sensors.
        context: The context of the environment.
        when: ``"launch_measured"`` after the physics, ``"launch_reset"`` where episodes begin, or
            ``"launch_observed"`` before the observations.
    """
    items: list[Item] = []
    for name, sensor in scene.sensors.items():
        if when in sensor.measures:
            launch = getattr(sensor, when)
            function = partial(launch, context.reset) if when == "launch_reset" else launch
            items.append(KernelLaunches(name, function, fields=sensor.launch_fields))
    return items


def scenery_items(scene: InteractiveScene, context: ManagerContext) -> list[Item]:
    """Launches that begin an episode in an imported scenery, before all that reads the environment's origin.

    Args:
        scene: The scene.
        context: The context of the environment.
    """
    if scene.scenery is None:
        return []
    name = "place to start" if scene.scenery.reset.draws else "bodies of the scenery"
    return [KernelLaunches(name, partial(launch_scenery_reset, scene, context))]


def launch_scenery_reset(scene: InteractiveScene, context: ManagerContext) -> None:
    """Launch what begins an episode in an imported scenery, if the scene has one."""
    if scene.scenery is not None:
        scene.scenery.reset.launch(context.reset, context.rng)
