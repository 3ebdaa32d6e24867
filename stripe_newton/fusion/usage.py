# SPDX-License-Identifier: Apache-2.0
"""Usage: the fields that a Warp function reads and writes and the functions that it calls, from its syntax tree."""

from __future__ import annotations

import ast
import builtins
import inspect
import types
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import TypeVar
from weakref import WeakKeyDictionary

import warp as wp

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
    every = list(parts)
    return Usage(
        reads=frozenset().union(*(u.reads for u in every)),
        writes=frozenset().union(*(u.writes for u in every)),
        writes_arguments=frozenset().union(*(u.writes_arguments for u in every)),
        calls=frozenset().union(*(u.calls for u in every)),
        unresolved=tuple(dict.fromkeys(text for u in every for text in u.unresolved)),
    )


def _read(function: wp.Function) -> Usage:
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
        python = inspect.unwrap(function.func)
        # As in Python, a variable of the closure hides a global of the same name.
        self._outside = {**vars(builtins), **python.__globals__, **_closure(python)}
        self._local = {name: frozenset[str]() for name in python.__code__.co_varnames}
        """Fields that a local variable may stand for, as ``pose`` does after ``pose = robot.body_pose``."""
        self._arguments = set(function.input_types)
        self._passed: dict[str, set[str]] = {name: {name} for name in self._arguments}
        """Arguments that a variable may stand for."""
        self._reads: set[str] = set()
        self._writes: set[str] = set()
        self._writes_arguments: set[str] = set()
        self._calls: set[wp.Function] = set()
        self._unresolved: list[str] = []

    def usage(self) -> Usage:
        called = [usage_of(f) for f in self._calls]
        own = Usage(
            frozenset(self._reads),
            frozenset(self._writes),
            frozenset(self._writes_arguments),
            frozenset(self._calls),
            tuple(self._unresolved),
        )
        # Arguments that a called function writes were attributed at the call, to the expressions passed there.
        inner = [Usage(u.reads, u.writes, frozenset(), u.calls, u.unresolved) for u in called]
        return _united([own, *inner])

    # -- reads

    def visit_Attribute(self, node: ast.Attribute) -> None:
        if self._external(node) is not None:
            self._refer(node)
            return
        self._reads.add(node.attr)
        self.visit(node.value)

    def visit_Name(self, node: ast.Name) -> None:
        if isinstance(node.ctx, ast.Load):
            self._refer(node)

    def _refer(self, node: ast.expr) -> None:
        """Note a function that is mentioned. It is called, here or by the function that it is passed to."""
        thing = self._resolve(node)
        if isinstance(thing, wp.Function) and not thing.is_builtin():
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
        function = self._resolve(node.func)
        if _is_static(function):
            self._evaluated(node)
            return
        if isinstance(node.func, ast.Call) and _is_static(self._resolve(node.func.func)):
            function = self._evaluated(node.func)
        else:
            self.visit(node.func)
        for argument in (*node.args, *(k.value for k in node.keywords)):
            self.visit(argument)
        if isinstance(function, wp.Function) and not function.is_builtin():
            names = list(function.input_types)
            given = [*zip(names, node.args, strict=False), *((k.arg or "", k.value) for k in node.keywords)]
            written = usage_of(function).writes_arguments
            for argument in (value for name, value in given if name in written):
                self._written(argument)
        elif self._is_builtin(node.func, function):
            # Of Warp's functions only these write to an array, which is their first argument.
            if node.args and _last_name(node.func).startswith(("atomic_", "tile_store", "tile_atomic_")):
                self._written(node.args[0])
        else:
            self._unresolved.append(ast.unparse(node.func))

    def _evaluated(self, node: ast.Call) -> object:
        """Value of a ``wp.static`` expression. A function in it counts as called."""
        argument = node.args[0] if node.args else node.keywords[0].value
        try:
            value = eval(compile(ast.Expression(argument), "<static>", "eval"), dict(self._outside))
        except Exception:  # the expression may use things that only Warp's compiler knows, such as a loop counter
            self._unresolved.append(ast.unparse(node))
            return None
        if isinstance(value, wp.Function) and not value.is_builtin():
            self._calls.add(value)
        return value

    def _is_builtin(self, node: ast.expr, function: object) -> bool:
        """Whether a call is of a function of Warp or of Python, or makes a value of a type."""
        root = node
        while isinstance(root, ast.Attribute):
            root = root.value
        of_warp = isinstance(root, ast.Name) and root.id not in self._local and self._outside.get(root.id) is wp
        known = isinstance(function, (type, types.BuiltinFunctionType, wp.Function))
        known = known or wp.types.type_is_struct(function)
        # Some functions, such as wp.tid, exist in Warp's compiler only, and kernels may call them without "wp.".
        bare = isinstance(root, ast.Name) and root.id not in self._local and hasattr(wp, root.id)
        return of_warp or known or bare

    # -- names

    def _external(self, node: ast.expr) -> ast.Name | None:
        """The first name of a dotted path, such as ``wp`` in ``wp.sin``, if it is not a local variable; else None."""
        while isinstance(node, ast.Attribute):
            node = node.value
        outside = isinstance(node, ast.Name) and node.id not in self._local and node.id in self._outside
        return node if outside and isinstance(node, ast.Name) else None

    def _resolve(self, node: ast.expr) -> object:
        """The object of a name or a dotted path outside of the function; None if unknown."""
        path: list[str] = []
        while isinstance(node, ast.Attribute):
            path.append(node.attr)
            node = node.value
        if not isinstance(node, ast.Name) or node.id in self._local:
            return None
        if hasattr(node, "warp_func"):  # Warp has replaced a wp.static expression by its value already
            return node.warp_func
        thing = self._outside.get(node.id)
        for part in reversed(path):
            thing = getattr(thing, part, None)
        return thing


def _closure(function: types.FunctionType) -> dict[str, object]:
    """Variables of the closure of a function, without those that are not set yet."""
    held = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            held[name] = cell.cell_contents
        except ValueError:  # an empty cell: the function is defined before the variable
            continue
    return held


def _is_static(function: object) -> bool:
    return function is not None and function is getattr(wp, "static", None)


def _last_name(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
