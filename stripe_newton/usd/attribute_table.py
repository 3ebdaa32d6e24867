# SPDX-License-Identifier: Apache-2.0
"""Attribute table: type, range and meaning of the attributes of a stage that enter the simulation.

UsdPhysics' parser and Newton's importer take a default, without a word, for a value whose type or range they do not
expect: a size that is a string makes a cube of 2 m. So each attribute that is read is held against a rule of this table
before it is read.
"""

from __future__ import annotations

import math
import re
from typing import NamedTuple

__all__ = ["MAX_COORDINATE", "Rule", "rule_of"]

MAX_COORDINATE = 1.0e9
"""Largest coordinate or length in stage units. Far below it float32 has no room for a robot."""
_MAX_MASS = 1.0e30
"""Largest mass, density and moment of inertia: sums and products of larger ones are beyond float32."""
_NO_LIMIT = (-math.inf, math.inf)


class Rule(NamedTuple):
    """Values that an attribute may have. Not-a-number is none of them."""

    pattern: re.Pattern[str]
    """Names of the attributes, matched as a whole."""
    right: str
    """The right values in words, for the sentence "it must be ..."."""
    low: float = -math.inf
    """Least value of each component."""
    high: float = math.inf
    """Greatest value of each component."""
    above: bool = False
    """Whether ``low`` itself is excluded."""
    infinite: tuple[float, ...] = ()
    """Infinities that have a meaning."""
    tokens: tuple[str, ...] = ()
    """Values of a token; empty for any."""
    kind: str = "number"
    """``number``, ``bool``, ``token`` or ``any``. A number may be in a vector, quaternion, matrix or array."""
    vector: bool = False
    """Whether the value has several components; a schema that USD knows says so itself."""
    nonzero: bool = False
    """Whether zero in all components is wrong."""


def _rule(names: str, right: str, **fields: object) -> Rule:
    return Rule(re.compile(names), right, **fields)  # type: ignore[arg-type]


_LENGTH = {"high": MAX_COORDINATE}
_PLACE = {"low": -MAX_COORDINATE, "high": MAX_COORDINATE}
_AXES = r"(linear|angular|distance|(trans|rot)[XYZ])"

_RULES = (
    # Geometry, in stage units.
    _rule("size|radius", f"a length above 0 and at most {MAX_COORDINATE:g}", low=0.0, above=True, **_LENGTH),
    _rule("height|width|length", f"a length of 0 or more and at most {MAX_COORDINATE:g}", low=0.0, **_LENGTH),
    _rule("axis|physics:axis", "X, Y or Z", tokens=("X", "Y", "Z"), kind="token"),
    _rule("xformOp:(translate|transform)(:.*)?", f"finite, within {MAX_COORDINATE:g} of the origin",
          vector=True, **_PLACE),
    _rule("xformOp:orient(:.*)?", "a finite quaternion other than 0", nonzero=True, vector=True),
    _rule("xformOp:scale(:.*)?", f"finite and at most {MAX_COORDINATE:g}", vector=True, **_PLACE),
    _rule("xformOp:.*", "finite", vector=True),
    _rule("xformOpOrder", "a list of the names of xformOps", kind="any"),
    # Bodies and masses.
    _rule("physics:(mass|density|diagonalInertia)", f"positive and at most {_MAX_MASS:g}, or 0 to have it computed",
          low=0.0, high=_MAX_MASS, vector=True),
    _rule("physics:centerOfMass", "finite, or -inf to have it computed", infinite=(-math.inf,), vector=True, **_PLACE),
    _rule("physics:principalAxes", "a finite quaternion, or 0 to have it computed", vector=True),
    _rule("physics:velocity|physics:angularVelocity", "finite", vector=True),
    _rule("physics:(rigidBody|kinematic|collision|joint)Enabled", "true or false", kind="bool"),
    _rule("physics:(startsAsleep|excludeFromArticulation)|newton:gravityEnabled", "true or false", kind="bool"),
    # Materials.
    _rule("physics:(static|dynamic)Friction|physics:restitution", "finite and 0 or more", low=0.0),
    _rule("newton:(torsional|rolling)Friction|mjc:(torsional|rolling)friction", "finite and 0 or more", low=0.0),
    # Joints.
    _rule("physics:localPos[01]", f"finite, within {MAX_COORDINATE:g} of the body", vector=True, **_PLACE),
    _rule("physics:localRot[01]", "a finite quaternion other than 0", nonzero=True, vector=True),
    _rule(f"physics:lowerLimit|limit:{_AXES}:physics:low", "finite, or -inf for none", infinite=(-math.inf,)),
    _rule(f"physics:upperLimit|limit:{_AXES}:physics:high", "finite, or inf for none", infinite=(math.inf,)),
    _rule("physics:break(Force|Torque)", "0 or more, or inf for none", low=0.0, infinite=(math.inf,)),
    _rule("physics:coneAngle[01]Limit|physics:(min|max)Distance", "a number, or negative for none", infinite=_NO_LIMIT),
    _rule(f"drive:{_AXES}:physics:(stiffness|damping)", "finite and 0 or more", low=0.0),
    _rule(f"drive:{_AXES}:physics:target(Position|Velocity)", "finite"),
    _rule(f"drive:{_AXES}:physics:maxForce", "0 or more, or inf for none", low=0.0, infinite=(math.inf,)),
    _rule(
        f"drive:{_AXES}:physics:type", "force or acceleration", tokens=("force", "acceleration"), kind="token"
    ),
    _rule("state:.*", "finite"),
    _rule(
        "newton:(armature|friction|damping)|mjc:(armature|frictionloss|damping|stiffness)|physxJoint:armature",
        "finite and 0 or more", low=0.0,
    ),
    _rule("newton:velocityLimit|physxJoint:maxJointVelocity", "above 0, or inf for none",
          low=0.0, above=True, infinite=(math.inf,)),
    _rule(r"newton:limit(Stiffness|Damping)|physxLimit:.*:(stiffness|damping)", "finite"),
    # Scenes.
    _rule(
        "physics:gravityMagnitude", "finite and 0 or more, or -inf for that of the Earth",
        low=0.0, infinite=(-math.inf,),
    ),
    _rule("physics:gravityDirection", "finite", vector=True),
    # Of what else is read it is known at least that it is no use if it is not a number.
    _rule("(newton|mjc|physxMaterial|physxCollision|physxScene):.*", "a number", infinite=_NO_LIMIT, kind="any"),
)  # fmt: skip


def rule_of(name: str) -> Rule | None:
    """The rule of an attribute; None if it is not read, or its value cannot be wrong."""
    return next((rule for rule in _RULES if rule.pattern.fullmatch(name)), None)
