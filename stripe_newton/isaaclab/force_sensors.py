# SPDX-License-Identifier: Apache-2.0
"""Force sensors of operational space actions, which their class in Isaac Lab makes for itself."""

from __future__ import annotations

from stripe_newton.sensors import ContactSensorCfg

from .mdp.operational_space import OperationalSpaceControllerActionCfg

__all__ = ["add_force_sensors"]


def add_force_sensors(actions: object, scene: object) -> None:
    """Give each action with feedback of forces a contact sensor on its body, as Isaac Lab's action makes its own.

    Args:
        actions: Config of the actions, or a dict of them.
        scene: Config of the scene, which gets the sensors.
    """
    terms = actions if isinstance(actions, dict) else vars(actions)
    for name, term in terms.items():
        if not isinstance(term, OperationalSpaceControllerActionCfg) or term.contact_sensor is not None:
            continue
        if term.controller_cfg.contact_wrench_stiffness_task is not None:
            term.contact_sensor = f"{name}_force"
            path = f"{getattr(scene, term.asset_name).prim_path}/{term.body_name}"
            setattr(scene, term.contact_sensor, ContactSensorCfg(prim_path=path, substeps=True))
