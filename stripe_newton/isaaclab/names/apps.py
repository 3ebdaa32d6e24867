# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Sim's own modules, and of Isaac Lab's application."""

from .entries import Table, dialect, inert, refused
from .sim import PRIMS

_NO_APP = "there is no application of Omniverse"
_NO_REPLICATOR = "Replicator is part of Omniverse"
_TORCH_MATH = """get_euler_xyz normalize quat_apply quat_conjugate quat_from_angle_axis quat_from_euler_xyz quat_mul
    quat_rotate quat_rotate_inverse tf_apply tf_combine tf_inverse tf_vector torch_rand_float"""

NAMES: dict[str, Table] = {
    "isaaclab.app": dialect("app", "AppLauncher"),
    "isaacsim": dialect("app", "SimulationApp"),
    "isaacsim.core.utils.extensions": inert(_NO_APP, "enable_extension"),
    "isaacsim.core.utils.torch": dialect("torch_rotations", _TORCH_MATH)
    | {"maths": "stripe_newton.isaaclab.torch_rotations:"},
    "isaacsim.core.utils.torch.maths": dialect("torch_rotations", "normalize scale torch_rand_float unscale"),
    "isaacsim.core.utils.torch.rotations": dialect(
        "torch_rotations", f"{_TORCH_MATH} compute_heading_and_up compute_rot"
    ),
    "isaacsim.core.utils.torch.transformations": dialect("torch_rotations", _TORCH_MATH),
    "isaacsim.util.debug_draw._debug_draw": inert(_NO_APP, "acquire_debug_draw_interface"),
    "isaacsim.core.utils.stage": dialect("prims", "get_current_stage"),
    "isaacsim.core.utils.prims": dialect("prims", PRIMS),
    "omni": {},
    "omni.ext": inert(_NO_APP, "IExt IExtLogger"),
    "omni.ui": inert(
        _NO_APP,
        """Button CheckBox CollapsableFrame ColorWidget ComboBox DockPreference FloatDrag FloatField FloatSlider Frame
        HStack Image IntDrag IntField IntSlider Label Line Plot Rectangle ScrollingFrame Separator Spacer StringField
        VStack Window ZStack""",
    ),
    "omni.kit.app": inert(_NO_APP, "get_app"),
    "omni.log": inert(_NO_APP, "error info verbose warn"),
    "omni.replicator.core": refused(_NO_REPLICATOR, "BasicWriter create distribution get modify randomizer trigger"),
    "omni.usd": dialect("prims", "get_context") | refused(_NO_APP, "get_world_transform_matrix"),
    "carb": dialect("app", "log_error log_info log_warn settings") | refused(_NO_APP, "Float3 input tokens"),
    "carb.settings": dialect("app", "get_settings"),
}

ALIASES: dict[str, str] = {}
