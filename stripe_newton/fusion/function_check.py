# SPDX-License-Identifier: Apache-2.0
"""Function check: errors in a Warp function, found by translating it alone, before any kernel is compiled.

>>> import warp as wp
>>> from stripe_newton.fusion import function_problem
>>> @wp.func
... def doubled(x: float) -> float:
...     return 2 * x
>>> function_problem(doubled)
"...: Input types must be the same, got ['int32', 'float32']. an int meets a float; write 1.0 for 1, ..."
"""

from __future__ import annotations

import difflib
import re

import warp as wp

__all__ = ["function_problem"]

_PLACE = re.compile(r"Error while parsing function \"(?P<name>\w+)\" at (?P<file>.+?):(?P<line>\d+):")
_HINTS = (
    (
        r"mutating a constant (\w+) inside a dynamic loop",
        r"'\1' changes in a loop, so it must be a variable: begin with \1 = wp.float32(0.0), or wp.int32(0)",
    ),
    (
        r"Input types must be the same, got \['int32', 'float32'\]",
        "an int meets a float; write 1.0 for 1, or float(i) for a variable",
    ),
    (r"Referencing undefined symbol: (\w+)", r"'\1' is not known here; import it, or define it with @wp.func"),
)
"""Hints by what Warp says."""


def function_problem(function: wp.Function) -> str:
    """The error in a Warp function, in a line with file and line number; empty if there is none.

    Its types are checked as Warp checks them when it compiles a kernel, which happens much later.
    """
    try:
        from warp._src.context import ModuleBuilder  # Warp has no public way to translate one function
    except ImportError:
        return ""
    try:
        ModuleBuilder(function.module, dict(function.module.options)).build_function(function)
    except Exception as error:  # Warp raises errors of many kinds, also Python's own
        return _in_a_line(str(error.args[0]) if error.args else str(error), function)
    return ""


def _in_a_line(text: str, function: wp.Function) -> str:
    places = list(_PLACE.finditer(text))
    said = text.rpartition("\n;")[2].strip() if "\n;" in text else text.strip()
    said = re.sub(r"^Error,? ?", "", said.partition("\n")[0]).partition(", use the following syntax")[0]
    hint = next((match.expand(new) for old, new in _HINTS if (match := re.search(old, said))), "")
    hint = hint or _attribute_hint(said, function)
    where = f"{places[-1]['file']}:{places[-1]['line']}: " if places else ""
    return f"{where}{said}" + (f". {hint}" if hint else "")


def _attribute_hint(said: str, function: wp.Function) -> str:
    """The field of a struct that is nearest to one that it does not have."""
    match = re.search(r"`(\w+)` is not an attribute of '(\w+)'", said)
    if match is None:
        return ""
    kind = function.input_types.get(match[2])
    fields = list(getattr(kind, "vars", {}))
    near = difflib.get_close_matches(match[1], fields, n=1)
    return f"did you mean '{near[0]}'?" if near else f"it has {', '.join(fields)}" if fields else ""
