# SPDX-License-Identifier: Apache-2.0
"""Controllers: joint positions or efforts that move a body in task space, from Jacobians and mass matrices.

They compute on batches of torch tensors and know no simulator. Actions of the same names
(:class:`stripe_newton.managers.DifferentialInverseKinematicsActionCfg`) run within the step's graph.
"""

from .differential_ik import DifferentialIKController, DifferentialIKControllerCfg
from .operational_space import OperationalSpaceController
from .operational_space_cfg import OperationalSpaceControllerCfg

__all__ = [
    "DifferentialIKController",
    "DifferentialIKControllerCfg",
    "OperationalSpaceController",
    "OperationalSpaceControllerCfg",
]
