# SPDX-License-Identifier: Apache-2.0
"""Stage report: what was read from a stage, as plain rows that can be printed or written as JSON."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TypedDict

from .ignored_rows import Ignored, shared_rows
from .stage_lights import Light
from .text_table import WIDTH, count, number, shorten, table, vector

__all__ = [
    "ArticulationRow",
    "BodyRow",
    "JointRow",
    "MaterialRow",
    "ShapeRow",
    "SiteRow",
    "StageReport",
    "StageUnits",
]


class StageUnits(TypedDict):
    """Units and gravity of a stage."""

    meters_per_unit: float
    """Unit of length as authored [m]."""
    kilograms_per_unit: float
    """Unit of mass as authored [kg]."""
    up_axis: str
    """Up axis as authored, ``"Y"`` or ``"Z"``."""
    gravity: list[float]
    """Gravity, with Z up [m/s^2]."""
    scene: str | None
    """Path of the PhysicsScene."""


@dataclass
class BodyRow:
    """A rigid body, in SI units. Centre of mass and inertia are in the body's frame."""

    path: str
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]
    """Diagonal of the inertia tensor about the centre of mass, kg m^2."""
    kinematic: bool
    position: tuple[float, float, float]
    """Position of the body's origin in the world frame, as authored."""


@dataclass
class JointRow:
    """One degree of freedom of a joint. A fixed, free or ball joint has one row, with ``axis`` None."""

    path: str
    type: str
    dof: int
    """Index among the joint's degrees of freedom; -1 for a fixed, free or ball joint."""
    angular: bool
    axis: tuple[float, float, float] | None
    """Unit vector in the joint's frame."""
    parent: str
    """Body path; empty for the world."""
    child: str
    lower: float
    """rad or m."""
    upper: float
    stiffness: float
    """Drive gain, N m/rad or N/m."""
    damping: float
    """Drive gain, N m s/rad or N s/m."""
    max_force: float
    """N m or N."""
    target_mode: str
    target: float
    position: float
    """Initial position, rad or m."""
    armature: float
    friction: float
    passive_damping: float
    velocity_limit: float
    loop: bool
    """Whether the joint closes a loop: it is a constraint, not a coordinate."""

    @property
    def limits_deg(self) -> tuple[float, float] | None:
        """Limits in degrees; None for a linear axis."""
        return (math.degrees(self.lower), math.degrees(self.upper)) if self.angular else None


@dataclass
class ShapeRow:
    """A collider or a visible shape."""

    path: str
    type: str
    size: tuple[float, ...]
    """Box, mesh: half extents. Sphere: radius. Capsule, cone, cylinder: radius, half height. Plane: sides. [m]"""
    body: str
    """Empty for static geometry."""
    collides: bool
    visible: bool
    friction: float
    restitution: float
    density: float | None
    """Density of the shape's own MassAPI or of the bound material, kg/m^3; None if the default applies."""


@dataclass
class ArticulationRow:
    """A tree of bodies connected by joints."""

    path: str
    base: str
    """``floating`` or ``fixed``."""
    dofs: int
    bodies: list[str]


@dataclass
class MaterialRow:
    """A physics material, as authored."""

    path: str
    static_friction: float
    dynamic_friction: float
    restitution: float
    density: float


@dataclass
class SiteRow:
    """A named frame on a body."""

    path: str
    body: str
    position: tuple[float, float, float]
    """Position in the body's frame [m]."""


@dataclass
class StageReport:
    """Everything that was read from a stage, and what was ignored or changed."""

    file: str
    root_path: str
    units: StageUnits
    bodies: list[BodyRow] = field(default_factory=list)
    joints: list[JointRow] = field(default_factory=list)
    shapes: list[ShapeRow] = field(default_factory=list)
    articulations: list[ArticulationRow] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    materials: list[MaterialRow] = field(default_factory=list)
    sites: list[SiteRow] = field(default_factory=list)
    semantics: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    ignored: Ignored = field(default_factory=list)
    """Rows ``(path, what, why)``: what was left out, read differently from what is authored, or changed."""

    @property
    def dofs(self) -> int:
        """Degrees of freedom of all articulations; a free joint has six."""
        return sum(row.dofs for row in self.articulations)

    def to_dict(self) -> dict[str, object]:
        """Plain lists, dicts, strings, numbers and None; infinite numbers become the strings ``inf`` and ``-inf``."""
        return {name: _plain(value) for name, value in dataclasses.asdict(self).items()}

    def to_text(self) -> str:
        """Tables of at most 120 columns. Long tables are folded and say how many rows are left out."""
        head = [
            shorten(self.file, WIDTH),
            f"{count(self.bodies, 'body', 'bodies')}, {self.dofs} degree{'s'[: self.dofs != 1]} of freedom in "
            f"{count(self.articulations, 'articulation')}, {count(self.shapes, 'shape')}, "
            f"{count(self.materials, 'physics material')}, {count(self.lights, 'light')}, "
            f"{count(self.sites, 'site')}",
            f"{self.units['meters_per_unit']:g} m and {self.units['kilograms_per_unit']:g} kg a unit, "
            f"{self.units['up_axis']} up, gravity ({', '.join(number(g) for g in self.units['gravity'])}) m/s^2",
        ]
        axes = [row for row in self.joints if row.axis is not None]  # the others have no dynamics of their own
        tables = [
            table("Articulations", self.articulations, _ARTICULATION_COLUMNS),
            table("Bodies", self.bodies, _BODY_COLUMNS),
            table("Joints", self.joints, _JOINT_COLUMNS),
            table("Joint dynamics", axes, _DYNAMICS_COLUMNS),
            table("Shapes", self.shapes, _SHAPE_COLUMNS),
            table("Physics materials", self.materials, _MATERIAL_COLUMNS),
            table("Sites", self.sites, _SITE_COLUMNS),
            table("Lights", self.lights, _LIGHT_COLUMNS),
            table("Semantics", list(self.semantics.items()), _SEMANTICS_COLUMNS, wrap_last=True),
            table("Ignored or changed", shared_rows(self.ignored), _IGNORED_COLUMNS, wrap_last=True),
        ]
        return "\n\n".join(["\n".join(head), *(text for text in tables if text)]) + "\n"


def _plain(value: object) -> object:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)  # JSON has no infinity
    return value


# ---- columns of the tables: text of a cell by header -----------------------------------------------------------------


def _axis(axis: Sequence[float]) -> str:
    for name, unit in (("X", (1, 0, 0)), ("Y", (0, 1, 0)), ("Z", (0, 0, 1))):
        for sign in (1, -1):
            if all(math.isclose(a, sign * u, abs_tol=1e-6) for a, u in zip(axis, unit, strict=True)):
                return ("" if sign > 0 else "-") + name
    return vector(axis)


def _range(lower: float, upper: float, digits: int = 3) -> str:
    if lower <= -1e9 and upper >= 1e9:  # exporters write large numbers in place of infinity
        return "free"
    return f"{number(lower, digits)} .. {number(upper, digits)}"


def _degrees(row: JointRow) -> str:
    return "" if row.limits_deg is None else _range(*row.limits_deg, digits=4)


def _with_axis(text: Callable[[JointRow], str]) -> Callable[[JointRow], str]:
    """``text`` of joints with an axis, nothing of fixed, free and ball joints."""
    return lambda row: "" if row.axis is None else text(row)


_ARTICULATION_COLUMNS: dict[str, Callable[[ArticulationRow], str]] = {
    "path": lambda a: a.path,
    "base": lambda a: a.base,
    "dofs": lambda a: str(a.dofs),
    "bodies": lambda a: str(len(a.bodies)),
}
_BODY_COLUMNS: dict[str, Callable[[BodyRow], str]] = {
    "path": lambda b: b.path,
    "mass kg": lambda b: number(b.mass),
    "centre of mass m": lambda b: vector(b.com),
    "inertia kg m^2": lambda b: vector(b.inertia),
    "": lambda b: "kinematic" if b.kinematic else "",
}
_JOINT_COLUMNS: dict[str, Callable[[JointRow], str]] = {
    "path": lambda j: j.path,
    "type": lambda j: j.type + (" loop" if j.loop else ""),
    "axis": lambda j: "" if j.axis is None else _axis(j.axis),
    "limits": _with_axis(lambda j: _range(j.lower, j.upper)),
    "degrees": _with_axis(_degrees),
    "kp": _with_axis(lambda j: number(j.stiffness)),
    "kd": _with_axis(lambda j: number(j.damping)),
    "max": _with_axis(lambda j: number(j.max_force)),
    "mode": _with_axis(lambda j: j.target_mode.replace("position_velocity", "pos+vel")),
}
_DYNAMICS_COLUMNS: dict[str, Callable[[JointRow], str]] = {
    "path": lambda j: j.path,
    "armature": lambda j: number(j.armature),
    "friction": lambda j: number(j.friction),
    "damping": lambda j: number(j.passive_damping),
    "max speed": lambda j: number(j.velocity_limit),
    "starts at": lambda j: number(j.position),
}
_SHAPE_COLUMNS: dict[str, Callable[[ShapeRow], str]] = {
    "path": lambda s: s.path,
    "type": lambda s: s.type,
    "half size m": lambda s: vector(s.size),
    "body": lambda s: s.body.rsplit("/", 1)[-1] or "static",
    "": lambda s: ("collides " if s.collides else "") + ("visible" if s.visible else ""),
    "mu": lambda s: number(s.friction) if s.collides else "",
    "rest.": lambda s: number(s.restitution) if s.collides else "",
    "kg/m^3": lambda s: "" if s.density is None or not s.collides else number(s.density),
}
_MATERIAL_COLUMNS: dict[str, Callable[[MaterialRow], str]] = {
    "path": lambda m: m.path,
    "static friction": lambda m: number(m.static_friction),
    "dynamic friction": lambda m: number(m.dynamic_friction),
    "restitution": lambda m: number(m.restitution),
    "density": lambda m: number(m.density),
}
_SITE_COLUMNS: dict[str, Callable[[SiteRow], str]] = {
    "path": lambda s: s.path,
    "body": lambda s: s.body,
    "position m": lambda s: vector(s.position),
}
_LIGHT_COLUMNS: dict[str, Callable[[Light], str]] = {
    "path": lambda light: light.path,
    "kind": lambda light: light.kind,
    "intensity": lambda light: number(light.intensity),
    "colour": lambda light: vector(light.color),
    "direction": lambda light: vector(light.direction) if light.kind == "distant" else "",
}
_SEMANTICS_COLUMNS: dict[str, Callable[[tuple[str, dict[str, list[str]]]], str]] = {
    "path": lambda row: row[0],
    "labels": lambda row: "; ".join(f"{kind}: {', '.join(values)}" for kind, values in row[1].items()),
}
_IGNORED_COLUMNS: dict[str, Callable[[tuple[str, str, str]], str]] = {
    "path": lambda row: row[0],
    "what": lambda row: row[1],
    "why": lambda row: row[2],
}
