# SPDX-License-Identifier: Apache-2.0
"""What was read from a stage: plain rows, printable and JSON-able."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from .lights import Light

__all__ = ["ArticulationRow", "BodyRow", "JointRow", "MaterialRow", "ShapeRow", "SiteRow", "StageReport"]

_WIDTH = 120
_FOLD = 40
"""A table shows at most this many rows and says how many follow."""


@dataclass
class BodyRow:
    """A rigid body. SI units; centre of mass and inertia in the body's frame, inertia about the centre of mass."""

    path: str
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float]
    """Diagonal of the inertia tensor, kg m^2."""
    kinematic: bool
    position: tuple[float, float, float]
    """Of the body's origin, world frame, as authored."""


@dataclass
class JointRow:
    """One degree of freedom. Fixed, free and ball joints have one row, with ``axis`` None and ``dof`` -1."""

    path: str
    type: str
    dof: int
    """Index among the joint's degrees of freedom; -1 for a fixed, a free and a ball joint (one row each)."""
    angular: bool
    axis: tuple[float, float, float] | None
    """In the joint's frame."""
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
    """Initial, rad or m."""
    armature: float
    friction: float
    passive_damping: float
    velocity_limit: float
    loop: bool
    """The joint closes a loop: a constraint, not a coordinate of its own."""

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
    """Box: half extents. Sphere: radius. Capsule, cone, cylinder: radius, half height. Plane: sides. Mesh: scale."""
    body: str
    """Empty for static geometry."""
    collides: bool
    visible: bool
    friction: float
    restitution: float
    density: float | None
    """kg/m^3 of the bound material or the shape's own MassAPI; None where the default applies."""


@dataclass
class ArticulationRow:
    """A tree of bodies."""

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
    """In the body's frame."""


@dataclass
class StageReport:
    """Everything that was read from a stage, and what was not."""

    file: str
    root_path: str
    units: dict[str, Any]
    """``meters_per_unit``, ``kilograms_per_unit``, ``up_axis`` as authored, ``gravity`` (m/s^2, Z up) and ``scene``
    (the PhysicsScene's path or None)."""
    bodies: list[BodyRow] = field(default_factory=list)
    joints: list[JointRow] = field(default_factory=list)
    shapes: list[ShapeRow] = field(default_factory=list)
    articulations: list[ArticulationRow] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    materials: list[MaterialRow] = field(default_factory=list)
    sites: list[SiteRow] = field(default_factory=list)
    semantics: dict[str, dict[str, list[str]]] = field(default_factory=dict)
    ignored: list[tuple[str, str, str]] = field(default_factory=list)
    """``(path, what, why)``: what was left out, read otherwise than authored, or changed."""

    @property
    def dofs(self) -> int:
        """Degrees of freedom of all articulations, free joints counting six."""
        return sum(row.dofs for row in self.articulations)

    def to_dict(self) -> dict[str, Any]:
        """Plain lists, dicts, strings, numbers and None; infinite numbers become the strings ``inf`` and ``-inf``."""
        return _plain(dataclasses.asdict(self))

    def to_text(self) -> str:
        """Tables of at most 120 columns; long ones are folded, with the number of rows left out."""
        head = [
            f"{_shorten(self.file, _WIDTH)}",
            f"{_count(self.bodies, 'body', 'bodies')}, {self.dofs} degrees of freedom in "
            f"{_count(self.articulations, 'articulation')}, {_count(self.shapes, 'shape')}, "
            f"{_count(self.materials, 'physics material')}, {_count(self.lights, 'light')}, "
            f"{_count(self.sites, 'site')}",
            f"{self.units['meters_per_unit']:g} m and {self.units['kilograms_per_unit']:g} kg a unit, "
            f"{self.units['up_axis']} up, gravity ({', '.join(_number(g) for g in self.units['gravity'])}) m/s^2",
        ]
        return "\n\n".join(["\n".join(head), *(text for text in self._tables() if text)]) + "\n"

    def _tables(self) -> list[str]:
        deg = [row.limits_deg for row in self.joints]
        return [
            _table(
                "Articulations",
                ["path", "base", "dofs", "bodies"],
                [[a.path, a.base, str(a.dofs), str(len(a.bodies))] for a in self.articulations],
            ),
            _table(
                "Bodies",
                ["path", "mass kg", "centre of mass m", "inertia kg m^2", ""],
                [
                    [b.path, _number(b.mass), _vector(b.com), _vector(b.inertia), "kinematic" if b.kinematic else ""]
                    for b in self.bodies
                ],
            ),
            _table(
                "Joints",
                ["path", "type", "axis", "limits", "degrees", "kp", "kd", "max", "mode"],
                [
                    [
                        j.path,
                        j.type + (" loop" if j.loop else ""),
                        "" if j.axis is None else _axis(j.axis),
                        "" if j.axis is None else _range(j.lower, j.upper),
                        "" if d is None or j.axis is None else _range(*d, digits=4),
                        "" if j.axis is None else _number(j.stiffness),
                        "" if j.axis is None else _number(j.damping),
                        "" if j.axis is None else _number(j.max_force),
                        "" if j.axis is None else j.target_mode.replace("position_velocity", "pos+vel"),
                    ]
                    for j, d in zip(self.joints, deg, strict=True)
                ],
            ),
            _table(
                "Joint dynamics",
                ["path", "armature", "friction", "damping", "max speed", "starts at"],
                [
                    [j.path, *(_number(v) for v in (j.armature, j.friction, j.passive_damping, j.velocity_limit))]
                    + [_number(j.position)]
                    for j in self.joints
                    if j.axis is not None
                ],
            ),
            _table(
                "Shapes",
                ["path", "type", "size m", "body", "", "mu", "rest.", "kg/m^3"],
                [
                    [
                        s.path,
                        s.type,
                        _vector(s.size),
                        s.body.rsplit("/", 1)[-1] or "static",
                        ("collides " if s.collides else "") + ("visible" if s.visible else ""),
                        _number(s.friction) if s.collides else "",
                        _number(s.restitution) if s.collides else "",
                        "" if s.density is None or not s.collides else _number(s.density),
                    ]
                    for s in self.shapes
                ],
            ),
            _table(
                "Physics materials",
                ["path", "static friction", "dynamic friction", "restitution", "density"],
                [
                    [m.path, *map(_number, (m.static_friction, m.dynamic_friction, m.restitution, m.density))]
                    for m in self.materials
                ],
            ),
            _table(
                "Sites", ["path", "body", "position m"], [[s.path, s.body, _vector(s.position)] for s in self.sites]
            ),
            _table(
                "Lights",
                ["path", "kind", "intensity", "colour", "direction"],
                [
                    [
                        light.path,
                        light.kind,
                        _number(light.intensity),
                        _vector(light.color),
                        _vector(light.direction) if light.kind == "distant" else "",
                    ]
                    for light in self.lights
                ],
            ),
            _table(
                "Semantics",
                ["path", "labels"],
                [
                    [path, "; ".join(f"{kind}: {', '.join(values)}" for kind, values in labels.items())]
                    for path, labels in self.semantics.items()
                ],
            ),
            _table("Ignored or changed", ["path", "what", "why"], [list(row) for row in self.ignored]),
        ]


def _count(rows: Sequence[object], one: str, many: str | None = None) -> str:
    return f"{len(rows)} {one if len(rows) == 1 else many or one + 's'}"


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def _number(value: float, digits: int = 4) -> str:
    if abs(value) >= 1e6 and math.isfinite(value):
        return f"{value:.1e}"
    return f"{value + 0.0:.{digits}g}"


def _vector(values: Sequence[float]) -> str:
    return " ".join(_number(v, 3) for v in values)


def _axis(axis: Sequence[float]) -> str:
    for name, unit in (("X", (1, 0, 0)), ("Y", (0, 1, 0)), ("Z", (0, 0, 1))):
        for sign in (1, -1):
            if all(math.isclose(a, sign * u, abs_tol=1e-6) for a, u in zip(axis, unit, strict=True)):
                return ("" if sign > 0 else "-") + name
    return _vector(axis)


def _range(lower: float, upper: float, digits: int = 3) -> str:
    if lower <= -1e9 and upper >= 1e9:
        return "free"
    return f"{_number(lower, digits)} .. {_number(upper, digits)}"


def _shorten(text: str, width: int) -> str:
    """The end of a path tells most, so the start gives way."""
    return text if len(text) <= width else "..." + text[len(text) - width + 3 :]


def _table(title: str, header: list[str], rows: list[list[str]]) -> str:
    """A table fitted to the page: the first and the last column give way; text of the last is wrapped."""
    if not rows:
        return ""
    kept = [key for key in range(len(header)) if header[key] or any(row[key] for row in rows)]
    header, rows = [header[k] for k in kept], [[row[k] for k in kept] for row in rows]
    shown = rows[:_FOLD]
    lines = [f"{title} ({len(rows)})"]
    widths = [max(len(line[k]) for line in [header, *shown]) for k in range(len(header))]
    room = _WIDTH - 2 - 2 * (len(widths) - 1)
    wrap_last = header[-1] in ("why", "labels")
    if wrap_last:
        others = sum(widths[1:-1])
        widths[0] = min(widths[0], max(16, (room - others) // 2))
        widths[-1] = max(20, room - others - widths[0])
    while sum(widths) > room:
        widest = max(range(len(widths)), key=lambda k: widths[k])
        widths[widest] -= 1
    for line in [header, *shown]:
        cells = [_shorten(cell, width) for cell, width in zip(line, widths, strict=True)]
        if wrap_last:
            pieces = _wrapped(line[-1], widths[-1])
            cells[-1] = pieces[0]
        lines.append(("  " + "  ".join(c.ljust(w) for c, w in zip(cells, widths, strict=True))).rstrip())
        if wrap_last:
            indent = 2 + sum(widths[:-1]) + 2 * (len(widths) - 1)
            lines.extend(" " * indent + piece for piece in pieces[1:4])
    if len(rows) > len(shown):
        lines.append(f"  ... and {len(rows) - len(shown)} more{_kinds(rows[_FOLD:])}")
    return "\n".join(lines)


def _kinds(rows: list[list[str]]) -> str:
    kinds = Counter(row[1] for row in rows)
    if len(kinds) > 5:
        return ""
    return ": " + ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())


def _wrapped(text: str, width: int) -> list[str]:
    import textwrap

    return textwrap.wrap(text, width) or [""]
