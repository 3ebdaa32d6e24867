# SPDX-License-Identifier: Apache-2.0
"""Contact margins that the solver does not heed: rows of a report, and one warning for all shapes."""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager

import newton
from newton import GeoType, ShapeFlags

__all__ = ["margin_rows", "one_margin_warning"]

_WHY = (
    "MuJoCo's collision detection has no margins once a scene has a box: contacts begin later, and bodies rest lower, "
    "by so much; MuJoCoSolverCfg(use_mujoco_contacts=False) heeds them"
)
_ONE = re.compile(r"(?:Geom|Pair) (?P<name>.+?): authored margin=(?P<margin>\S+) zeroed")


@contextmanager
def one_margin_warning() -> Iterator[None]:
    """Replace Newton's warnings about margins, one for each shape, by one; all others are shown as they are."""
    with warnings.catch_warnings(record=True) as caught:
        yield
    found = [match for w in caught if (match := _ONE.match(str(w.message)))]
    for w in caught:
        if not _ONE.match(str(w.message)):
            warnings.warn_explicit(w.message, w.category, w.filename, w.lineno, source=w.source)
    if found:
        more = f" and {len(found) - 1} more" if len(found) > 1 else ""
        text = f"contact margin {float(found[0]['margin']):.3g} m of {found[0]['name']}{more} is not heeded"
        warnings.warn(f"{text}: {_WHY}", stacklevel=4)


def margin_rows(builder: newton.ModelBuilder, first: int) -> Iterator[tuple[str, str, str]]:
    """Rows ``(path, what, why)`` of shapes from ``first`` on with margins, if a box among them makes these zero."""
    shapes = range(first, builder.shape_count)
    if not any(builder.shape_type[s] == GeoType.BOX for s in shapes):
        return
    for shape in shapes:
        margin = float(builder.shape_margin[shape])
        if margin > 0.0 and builder.shape_flags[shape] & ShapeFlags.COLLIDE_SHAPES:
            yield builder.shape_label[shape], f"contact margin {margin:.3g} m", _WHY
