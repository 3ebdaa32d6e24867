# SPDX-License-Identifier: Apache-2.0
"""Outside names: globals, closures and ``wp.static`` expressions in a Warp function, resolved as Warp resolves them.

>>> import ast
>>> import warp as wp
>>> from stripe_newton.fusion.outside_names import OutsideNames
>>> def scaled_by(factor: float):
...     @wp.func
...     def scaled(x: float) -> float:
...         return wp.abs(factor * x)
...     return scaled
>>> names = OutsideNames(scaled_by(2.0))
>>> [names.value(ast.parse(text, mode="eval").body) for text in ("factor", "x")]
[2.0, None]
"""

from __future__ import annotations

import ast
import builtins
import inspect
import types

import warp as wp

__all__ = ["OutsideNames"]


class OutsideNames:
    """The names in a Warp function that are neither its arguments nor its local variables."""

    def __init__(self, function: wp.Function):
        python = inspect.unwrap(function.func)
        # As in Python, a variable of the closure hides a global of the same name.
        self._values = {**vars(builtins), **python.__globals__, **_closure(python)}
        self.local = frozenset(python.__code__.co_varnames)
        """Names of the arguments and local variables."""

    def has(self, node: ast.expr) -> bool:
        """Whether a name or a dotted path, such as ``wp.sin``, begins with one of these names."""
        root = _root(node)
        return isinstance(root, ast.Name) and root.id not in self.local and root.id in self._values

    def value(self, node: ast.expr) -> object:
        """The object of a name or a dotted path; None if unknown."""
        path: list[str] = []
        while isinstance(node, ast.Attribute):
            path.append(node.attr)
            node = node.value
        if not isinstance(node, ast.Name) or node.id in self.local:
            return None
        if hasattr(node, "warp_func"):  # Warp has replaced a wp.static expression by its value already
            return node.warp_func
        thing = self._values.get(node.id)
        for part in reversed(path):
            thing = getattr(thing, part, None)
        return thing

    def is_static(self, node: ast.expr) -> bool:
        """Whether an expression is ``wp.static``, whose calls Warp evaluates before it compiles."""
        value = self.value(node)
        return value is not None and value is getattr(wp, "static", None)

    def evaluated(self, call: ast.Call) -> object:
        """Value of a ``wp.static`` expression.

        Raises:
            Exception: any, if it uses things that only Warp's compiler knows, such as a loop counter.
        """
        argument = call.args[0] if call.args else call.keywords[0].value
        return eval(compile(ast.Expression(argument), "<static>", "eval"), dict(self._values))

    def is_builtin(self, node: ast.expr, function: object) -> bool:
        """Whether a called function is one of Warp or of Python, or a type, of which the call makes a value.

        Args:
            node: The function as written.
            function: Its value, where that is known.
        """
        root = _root(node)
        of_warp = isinstance(root, ast.Name) and root.id not in self.local and self._values.get(root.id) is wp
        known = isinstance(function, (type, types.BuiltinFunctionType, wp.Function))
        known = known or wp.types.type_is_struct(function)
        # Some functions, such as wp.tid, exist in Warp's compiler only, and kernels may call them without "wp.".
        bare = isinstance(root, ast.Name) and root.id not in self.local and hasattr(wp, root.id)
        return of_warp or known or bare


def _root(node: ast.expr) -> ast.expr:
    """The first part of a dotted path."""
    while isinstance(node, ast.Attribute):
        node = node.value
    return node


def _closure(function: types.FunctionType) -> dict[str, object]:
    """Variables of the closure of a function, without those that are not set yet."""
    held = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            held[name] = cell.cell_contents
        except ValueError:  # an empty cell: the function is defined before the variable
            continue
    return held
