# SPDX-License-Identifier: Apache-2.0
"""Model names config: how the joints and bodies of a file are called in the scene."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator

from pxr import Usd

from stripe_newton.configclass import configclass
from stripe_newton.expressions import expression_of, reason_of

__all__ = ["NAMES_KEY", "ModelNamesCfg", "author_names"]

NAMES_KEY = "stripeNewton:names"
"""Custom data of a prim whose file has other names in the scene: JSON of the fields of :class:`ModelNamesCfg`."""


@configclass
class ModelNamesCfg:
    """Other names for the joints and bodies of a file, so that a task that was written for other names finds them.

    New names may refer to groups of the expression for the old name as ``\\1``. Expressions match whole names, and the
    first that matches counts::

        ModelNamesCfg(
            joints={r"joint(\\d)": r"panda_joint\\1"},
            bodies={r"link(\\d)": r"panda_link\\1", "hand": "panda_hand"},
        )
    """

    joints: dict[str, str] = {}
    """New name by an expression for the name in the file."""
    bodies: dict[str, str] = {}
    """New name by an expression for the name in the file."""
    links: dict[str, tuple[str, str]] = {}
    """Bodies made of shapes: name of the new body and expression for its shapes, by an expression for the body that has
    them in the file. A fixed joint holds the new body, which has no mass, where the first of the shapes is. URDF and
    MJCF files only. Files that draw feet as shapes of the calf so get bodies that a contact sensor can name::

        links={r"(..)_calf": (r"\\1_foot", r"\\1_foot_collision")}
    """

    def problems(self) -> Iterator[tuple[str, str]]:
        for field in ("joints", "bodies", "links"):
            for expression in getattr(self, field):
                try:
                    expression_of(expression)
                except re.error as error:
                    yield f"{field}[{expression!r}]", reason_of(error)


def author_names(prim: Usd.Prim, names: ModelNamesCfg | None) -> None:
    """Keep the names with the prim, so that an exported stage has them too."""
    if names is not None:
        kept = {field: getattr(names, field) for field in ("joints", "bodies", "links")}
        prim.SetCustomDataByKey(NAMES_KEY, json.dumps(kept))
