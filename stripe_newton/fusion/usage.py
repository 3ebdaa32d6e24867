# SPDX-License-Identifier: Apache-2.0
"""Usage: the fields that a Warp function reads and writes and the functions that it calls, from its syntax tree.

>>> import warp as wp
>>> from stripe_newton.fusion import usage_of
>>> @wp.struct
... class Cart:
...     position: wp.array[float]
...     velocity: wp.array[float]
>>> @wp.func
... def move(env: int, cart: Cart, dt: float):
...     cart.position[env] = cart.position[env] + dt * cart.velocity[env]
>>> usage = usage_of(move)
>>> sorted(usage.reads), sorted(usage.writes)
(['position', 'velocity'], ['position'])
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeGuard, TypeVar
from weakref import WeakKeyDictionary

import warp as wp

from .outside_names import OutsideNames

__all__ = ["Usage", "usage_of"]

T = TypeVar("T")


@dataclass(frozen=True)
class Usage:
    """Fields and arguments that a Warp function uses, itself and through the functions that it calls.

    A field is known by its name alone, whatever its struct: a struct may be passed on, assigned to a variable or be an
    element of an array, and its type is then known to Warp's compiler only.
    """

    reads: frozenset[str] = frozenset()
    """Fields of structs that it reads, or passes to a function that may read them."""
    writes: frozenset[str] = frozenset()
    """Fields of structs that it writes."""
    writes_arguments: frozenset[str] = frozenset()
    """Arguments of the function, arrays, that it writes."""
    calls: frozenset[wp.Function] = frozenset()
    """Warp functions that it calls."""
    unresolved: tuple[str, ...] = ()
    """Calls, as written, whose function could not be found. They may read and write any field."""

    def may_use(self, fields: Iterable[str]) -> bool:
        """Whether it may read or write one of some fields. True if a call is unresolved."""
        return bool(self.unresolved) or not (self.reads | self.writes).isdisjoint(fields)

    def among(self, fields: Mapping[str, T]) -> dict[str, T]:
        """The entries of ``fields`` whose fields it is known to read or write."""
        used = self.reads | self.writes
        return {name: value for name, value in fields.items() if name in used}


_CACHE: WeakKeyDictionary[wp.Function, Usage] = WeakKeyDictionary()


def usage_of(function: wp.Function) -> Usage:
    """The usage of a Warp function.

    Globals, closures and ``wp.static`` expressions are resolved as Warp resolves them.
    """
    if function not in _CACHE:
        _CACHE[function] = Usage()  # ends the recursion for a function that calls itself; Warp does not compile those
        # All overloads count, as Warp chooses one by the types of the arguments, which are not known here.
        overloads = {id(f): f for f in (function, *function.user_overloads.values(), *function.user_templates.values())}
        _CACHE[function] = _united([_read(f) for f in overloads.values()])
    return _CACHE[function]


def _united(parts: Iterable[Usage]) -> Usage:
    """The usage of several functions together."""
    every = list(parts)
    return Usage(
        reads=frozenset().union(*(u.reads for u in every)),
        writes=frozenset().union(*(u.writes for u in every)),
        writes_arguments=frozenset().union(*(u.writes_arguments for u in every)),
        calls=frozenset().union(*(u.calls for u in every)),
        unresolved=tuple(dict.fromkeys(text for u in every for text in u.unresolved)),
    )


def _read(function: wp.Function) -> Usage:
    """The usage of one overload."""
    if function.native_snippet is not None:
        return _usage_of_native(function)
    reader = _Reader(function)
    for statement in function.adj.tree.body[0].body:
        reader.visit(statement)
    return reader.usage()


def _usage_of_native(function: wp.Function) -> Usage:
    """Usage of a native snippet. C++ is not parsed: it may read and write all of its arguments."""
    arrays = {name for name, kind in function.input_types.items() if wp.types.is_array(kind)}
    structs = any(wp.types.type_is_struct(kind) for kind in function.input_types.values())
    unresolved = (f"{function.key}, which is native code",) if structs else ()
    return Usage(writes_arguments=frozenset(arrays), unresolved=unresolved)


class _Reader(ast.NodeVisitor):
    """Visits the body of one function and collects its usage."""

    def __init__(self, function: wp.Function):
        self._outside = OutsideNames(function)
        self._local = {name: frozenset[str]() for name in self._outside.local}
        """Fields that a local variable may stand for, as ``pose`` does after ``pose = robot.body_pose``."""
        self._passed: dict[str, set[str]] = {name: {name} for name in function.input_types}
        """Arguments that a variable may stand for."""
        self._reads: set[str] = set()
        self._writes: set[str] = set()
        self._writes_arguments: set[str] = set()
        self._calls: set[wp.Function] = set()
        self._unresolved: list[str] = []

    def usage(self) -> Usage:
        """The usage that was collected, together with that of the functions that are called."""
        own = Usage(
            frozenset(self._reads),
            frozenset(self._writes),
            frozenset(self._writes_arguments),
            frozenset(self._calls),
            tuple(self._unresolved),
        )
        called = [usage_of(f) for f in self._calls]
        # Arguments that a called function writes were attributed at the call, to the expressions passed there.
        inner = [Usage(u.reads, u.writes, frozenset(), u.calls, u.unresolved) for u in called]
        return _united([own, *inner])

    # -- reads

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if self._outside.has(node):
            self._refer(self._outside.value(node))
            return
        self._reads.add(node.attr)
        self.visit(node.value)

    def visit_Name(self, node: ast.Name) -> None:
        if isinstance(node.ctx, ast.Load):
            self._refer(self._outside.value(node))

    def _refer(self, thing: object) -> None:
        """Note a function that is mentioned. It is called, here or by the function that it is passed to."""
        if _is_own(thing):
            self._calls.add(thing)

    # -- writes

    def visit_Assign(self, node: ast.Assign) -> None:
        self.visit(node.value)
        for target in node.targets:
            self._store(target, node.value)

    def visit_AnnAssign(self, node: ast.AnnAssign) -> None:
        if node.value is not None:
            self.visit(node.value)
            self._store(node.target, node.value)

    def visit_AugAssign(self, node: ast.AugAssign) -> None:
        self.visit(node.value)
        self._store(node.target, None)
        self._reads |= self._fields(node.target)

    def _store(self, target: ast.expr, value: ast.expr | None) -> None:
        """Note an assignment: a variable takes over what its value stands for, anything else is written."""
        if isinstance(target, (ast.Tuple, ast.List)):
            for element in target.elts:
                self._store(element, value)
        elif isinstance(target, ast.Name):
            if value is not None:  # the order of statements is ignored: a variable stands for all of its values
                self._local[target.id] = self._local.get(target.id, frozenset()) | self._fields(value)
                self._passed.setdefault(target.id, set()).update(self._arguments_in(value))
        else:
            self._written(target)
            self._visit_indices(target)

    def _written(self, target: ast.expr) -> None:
        self._writes |= self._fields(target)
        self._writes_arguments |= self._arguments_in(target)

    def _visit_indices(self, node: ast.expr) -> None:
        """Visit the indices of a target, which are read: ``i`` of ``array[i] = value``."""
        while isinstance(node, (ast.Subscript, ast.Attribute)):
            if isinstance(node, ast.Subscript):
                self.visit(node.slice)
            node = node.value

    def _fields(self, node: ast.expr) -> frozenset[str]:
        """Fields to which an expression belongs: ``robot.joint_pos[env, 0]`` belongs to ``joint_pos``."""
        found: set[str] = set()
        while isinstance(node, (ast.Attribute, ast.Subscript)):
            if isinstance(node, ast.Attribute):
                found.add(node.attr)
            node = node.value
        if isinstance(node, ast.Name):
            found |= self._local.get(node.id, frozenset())
        return frozenset(found)

    def _arguments_in(self, node: ast.expr) -> set[str]:
        """Arguments to which an expression belongs, as an element, a slice or the whole."""
        while isinstance(node, ast.Subscript):
            node = node.value
        return self._passed.get(node.id, set()) if isinstance(node, ast.Name) else set()

    # -- calls

    def visit_Call(self, node: ast.Call) -> None:
        if self._outside.is_static(node.func):
            self._static_value(node)
            return
        function = self._called(node.func)
        for argument in (*node.args, *(k.value for k in node.keywords)):
            self.visit(argument)
        if _is_own(function):
            names = list(function.input_types)
            given = [*zip(names, node.args, strict=False), *((k.arg or "", k.value) for k in node.keywords)]
            written = usage_of(function).writes_arguments
            for argument in (value for name, value in given if name in written):
                self._written(argument)
        elif self._outside.is_builtin(node.func, function):
            # Of Warp's functions only these write to an array, which is their first argument.
            if node.args and _last_name(node.func).startswith(("atomic_", "tile_store", "tile_atomic_")):
                self._written(node.args[0])
        else:
            self._unresolved.append(ast.unparse(node.func))

    def _called(self, node: ast.expr) -> object:
        """The function that a call names, as ``f`` or as ``wp.static(f)``; None if unknown."""
        if isinstance(node, ast.Call) and self._outside.is_static(node.func):
            return self._static_value(node)
        self.visit(node)
        return self._outside.value(node)

    def _static_value(self, node: ast.Call) -> object:
        """Value of a ``wp.static`` expression; None if unknown. A function in it counts as called."""
        try:
            value = self._outside.evaluated(node)
        except Exception:  # the expression may use things that only Warp's compiler knows, such as a loop counter
            self._unresolved.append(ast.unparse(node))
            return None
        self._refer(value)
        return value


def _is_own(thing: object) -> TypeGuard[wp.Function]:
    """Whether a thing is a Warp function that is none of Warp's own."""
    return isinstance(thing, wp.Function) and not thing.is_builtin()


def _last_name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
