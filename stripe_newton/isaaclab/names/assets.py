# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's actuators, assets and controllers."""

from .entries import Table, dialect, refused, same

NAMES: dict[str, Table] = {
    "isaaclab.actuators": dialect(
        "actuator_configs",
        """ImplicitActuatorCfg IdealPDActuatorCfg DCMotorCfg DelayedPDActuatorCfg RemotizedPDActuatorCfg
        ActuatorNetLSTMCfg ActuatorNetMLPCfg""",
    )
    | dialect(
        "actuators",
        "ActuatorBase DCMotor DelayedPDActuator IdealPDActuator ImplicitActuator RemotizedPDActuator",
    )
    | same("stripe_newton.actuators", "ActuatorBaseCfg=ActuatorCfg"),
    "isaaclab.assets": dialect(
        "assets",
        """Articulation ArticulationCfg RigidObject RigidObjectCfg RigidObjectCollection RigidObjectCollectionCfg
        AssetBase AssetBaseCfg""",
    )
    | dialect("wxyz_data", "ArticulationData=WxyzData RigidObjectData=WxyzData RigidObjectCollectionData=WxyzData")
    | refused("deformable bodies are not simulated", "DeformableObject DeformableObjectCfg DeformableObjectData"),
    "isaaclab.controllers": dialect("controllers", "DifferentialIKController OperationalSpaceController")
    | same("stripe_newton.controllers", "DifferentialIKControllerCfg OperationalSpaceControllerCfg"),
}

ALIASES: dict[str, str] = {}
