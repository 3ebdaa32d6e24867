# SPDX-License-Identifier: Apache-2.0
"""Spawners of URDF and MJCF files of the Isaac Lab dialect, with the fields and defaults of its converters."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar

from stripe_newton import sim as native
from stripe_newton.configclass import MISSING, configclass

from .spawners import Spawn, WxyzFunc, deformable_problems, spawn_from_mjcf, spawn_from_urdf

__all__ = ["MjcfFileCfg", "UrdfConverterCfg", "UrdfFileCfg"]

Gain = float | dict[str, float] | None
"""One number for all joints, or numbers by joint-name expression; ``None`` for what the file says."""

_CONVERTER = "no file is converted on disk"
_IGNORED = {
    "usd_dir": _CONVERTER,
    "usd_file_name": _CONVERTER,
    "force_usd_conversion": _CONVERTER,
    "make_instanceable": _CONVERTER,
    "link_density": "bodies have the masses of the file",
    "fixed_tendons_props": "tendons are those of the file",
    "spatial_tendons_props": "tendons are those of the file",
    "mass_props": "bodies have the masses of the file",
    "collision_props": "colliders are as the file has them",
    "visual_material": "colours are those of the file",
    "visual_material_path": "colours are those of the file",
    "joint_drive_props": "give the gains as joint_drive",
}


@configclass
class _FileFields:
    """Fields of Isaac Lab that the spawners of both kinds of files have."""

    self_collision: bool = False
    scale: float | tuple[float, float, float] | None = None
    link_density: float = 0.0
    usd_dir: str | None = None
    usd_file_name: str | None = None
    force_usd_conversion: bool = False
    make_instanceable: bool = True
    fixed_tendons_props: object = None
    spatial_tendons_props: object = None
    deformable_props: object = None
    mass_props: object = None
    collision_props: object = None
    joint_drive_props: object = None
    visual_material: object = None
    visual_material_path: str = "material"

    def problems(self) -> Iterator[tuple[str, str]]:
        yield from super().problems()  # type: ignore[misc]  # of the native config
        if isinstance(self.scale, Sequence) and len(set(self.scale)) != 1:
            yield "scale", f"is {tuple(self.scale)}, but a robot's file is scaled by the same number in x, y and z"
        yield from deformable_problems(self.deformable_props)

    def importer_options(self) -> dict[str, object]:
        options: dict[str, object] = super().importer_options()  # type: ignore[misc]  # of the native config
        given = self.scale
        options["scale"] = 1.0 if given is None else float(given[0] if isinstance(given, Sequence) else given)
        return options


@configclass
class UrdfConverterCfg:
    """Isaac Lab's config of its converter of URDF files, of which files use the nested classes."""

    @configclass
    class JointDriveCfg:
        """Drives of the joints, which a URDF file does not have."""

        @configclass
        class PDGainsCfg:
            """Gains of the drives."""

            stiffness: Gain = None
            """Position gain [N/m or N m/rad]; for ``target_type="velocity"`` the velocity gain [N m s/rad]."""
            damping: Gain = None
            """Velocity gain [N s/m or N m s/rad]; for ``target_type="velocity"`` it has no effect."""

        @configclass
        class NaturalFrequencyGainsCfg:
            """Gains by the frequency of the joint, which are not supported."""

            natural_frequency: float | dict[str, float] = MISSING
            """Frequency [Hz]."""
            damping_ratio: float | dict[str, float] = 0.005
            """Ratio to the critical damping."""

            def problems(self) -> Iterator[tuple[str, str]]:
                yield "", "is NaturalFrequencyGainsCfg, which is not supported; give PDGainsCfg(stiffness=, damping=)"

        drive_type: str | dict[str, str] = "force"
        """``"force"``; ``"acceleration"`` is not supported."""
        target_type: str | dict[str, str] = "position"
        """``"position"``, ``"velocity"`` or ``"none"``, which means no gains."""
        gains: PDGainsCfg | NaturalFrequencyGainsCfg = PDGainsCfg()
        """The gains."""

        def problems(self) -> Iterator[tuple[str, str]]:
            if self.drive_type != "force":
                yield "drive_type", f"is {self.drive_type!r}, must be 'force': drives do not scale with inertia here"
            if self.target_type not in ("none", "position", "velocity"):
                yield "target_type", f"is {self.target_type!r}, must be 'none', 'position' or 'velocity' for all joints"

        def stiffness_and_damping(self) -> tuple[Gain, Gain]:
            """Gains of position and velocity, ``None`` for those of the file."""
            if self.target_type == "none":
                return 0.0, 0.0
            if not isinstance(self.gains, UrdfConverterCfg.JointDriveCfg.PDGainsCfg):
                return None, None
            if self.target_type == "velocity":
                return 0.0, self.gains.stiffness
            return self.gains.stiffness, self.gains.damping


@configclass
class UrdfFileCfg(_FileFields, WxyzFunc, native.UrdfFileCfg):  # type: ignore[misc]  # `scale` may be three numbers
    """:class:`stripe_newton.sim.UrdfFileCfg` with Isaac Lab's fields and defaults; ``func`` takes (w, x, y, z)."""

    func: Spawn = spawn_from_urdf
    merge_fixed_joints: bool = True
    joint_drive: UrdfConverterCfg.JointDriveCfg | None = None
    collision_from_visuals: bool = False
    collider_type: str = "convex_hull"
    root_link_name: str | None = None
    convert_mimic_joints_to_normal_joints: bool = False

    IGNORED: ClassVar[dict[str, str]] = {
        **native.UrdfFileCfg.IGNORED,
        **_IGNORED,
        "collider_type": "meshes collide by their convex hulls",
        "root_link_name": "the root is that of the file",
        "convert_mimic_joints_to_normal_joints": "joints that follow others are coupled",
    }

    def importer_options(self) -> dict[str, object]:
        options = super().importer_options()
        options["parse_visuals_as_colliders"] = self.parse_visuals_as_colliders or self.collision_from_visuals
        if self.joint_drive is not None:
            options["joint_stiffness"], options["joint_damping"] = self.joint_drive.stiffness_and_damping()
        return options


@configclass
class MjcfFileCfg(_FileFields, WxyzFunc, native.MjcfFileCfg):  # type: ignore[misc]  # `scale` may be three numbers
    """:class:`stripe_newton.sim.MjcfFileCfg` with Isaac Lab's fields and defaults; ``func`` takes (w, x, y, z)."""

    func: Spawn = spawn_from_mjcf
    import_inertia_tensor: bool = True
    import_sites: bool = True

    IGNORED: ClassVar[dict[str, str]] = {
        **native.MjcfFileCfg.IGNORED,
        **_IGNORED,
        "import_inertia_tensor": "bodies have the inertias of the file",
        "import_sites": "sites are not bodies",
        "joint_drive_props": "drives are those of the file; give gains by actuators",
    }
