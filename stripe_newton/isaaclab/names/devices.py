# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's input devices, which load and do nothing."""

from .entries import Table, inert

_REASON = "there are no input devices"

NAMES: dict[str, Table] = {
    "isaaclab.devices": inert(_REASON, "DeviceBase DeviceCfg DevicesCfg"),
    "isaaclab.devices.gamepad": inert(_REASON, "Se2Gamepad Se2GamepadCfg Se3Gamepad Se3GamepadCfg"),
    "isaaclab.devices.keyboard": inert(_REASON, "Se2Keyboard Se2KeyboardCfg Se3Keyboard Se3KeyboardCfg"),
    "isaaclab.devices.spacemouse": inert(_REASON, "Se2SpaceMouse Se2SpaceMouseCfg Se3SpaceMouse Se3SpaceMouseCfg"),
}

ALIASES: dict[str, str] = {}
