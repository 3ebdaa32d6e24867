# SPDX-License-Identifier: Apache-2.0
"""Names of Isaac Lab's input devices, which load and give no input."""

from .entries import Table, dialect, inert

_REASON = "there are no input devices"


def _devices(names: str, kind: str) -> Table:
    """Devices of a kind, and their configs."""
    of_kind = " ".join(f"{name}={kind}" for name in names.split())
    configs = " ".join(f"{name}Cfg" for name in names.split())
    return dialect("input_devices", of_kind) | inert(_REASON, configs)


_BY_MODULE = {
    "gamepad": _devices("Se2Gamepad", "Se2Device") | _devices("Se3Gamepad", "Se3Device"),
    "haply": _devices("HaplyDevice", "HaplyDevice"),
    "keyboard": _devices("Se2Keyboard", "Se2Device") | _devices("Se3Keyboard", "Se3Device"),
    "spacemouse": _devices("Se2SpaceMouse", "Se2Device") | _devices("Se3SpaceMouse", "Se3Device"),
}
_OF_PACKAGE = dialect("input_devices", "DeviceBase") | inert(
    _REASON,
    """DeviceCfg DevicesCfg ManusVive ManusViveCfg OpenXRDevice OpenXRDeviceCfg RetargeterBase RetargeterCfg
    create_teleop_device""",
)

NAMES: dict[str, Table] = {
    "isaaclab.devices": {name: entry for table in (_OF_PACKAGE, *_BY_MODULE.values()) for name, entry in table.items()},
    **{f"isaaclab.devices.{module}": table for module, table in _BY_MODULE.items()},
}

ALIASES: dict[str, str] = {}
