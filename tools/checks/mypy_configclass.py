# SPDX-License-Identifier: Apache-2.0
"""mypy plugin for the methods that ``@configclass`` adds: replace, copy, to_dict, from_dict, validate.

mypy knows from ``typing.dataclass_transform`` that a config class is a dataclass, but annotations cannot express a
decorator that adds methods.
"""

from __future__ import annotations

from collections.abc import Callable

from mypy.nodes import ARG_POS, ARG_STAR2, Argument, Var
from mypy.plugin import ClassDefContext, Plugin
from mypy.plugins.common import add_method_to_class
from mypy.plugins.dataclasses import dataclass_class_maker_callback, dataclass_tag_callback
from mypy.types import AnyType, NoneType, Type, TypeOfAny

DECORATOR = "stripe_newton.configclass.configclass"


def add_config_methods(ctx: ClassDefContext) -> bool:
    """Add the methods to a config class, where it has none of that name."""
    self_type: Type = ctx.api.named_type_or_none(ctx.cls.fullname, []) or AnyType(TypeOfAny.special_form)
    anything: Type = AnyType(TypeOfAny.explicit)
    text = ctx.api.named_type("builtins.str")
    mapping = ctx.api.named_type_or_none("builtins.dict", [text, anything]) or anything

    def add(name: str, args: list[Argument], result: Type) -> None:
        if name not in ctx.cls.info.names:
            add_method_to_class(ctx.api, ctx.cls, name, args, result)

    add("replace", [Argument(Var("changes", anything), anything, None, ARG_STAR2)], self_type)
    add("copy", [], self_type)
    add("to_dict", [], mapping)
    add("from_dict", [Argument(Var("data", anything), anything, None, ARG_POS)], NoneType())
    add("validate", [], NoneType())
    return dataclass_class_maker_callback(ctx)


class ConfigClassPlugin(Plugin):
    """Hooks for the decorator."""

    def get_class_decorator_hook(self, fullname: str) -> Callable[[ClassDefContext], None] | None:
        return dataclass_tag_callback if fullname == DECORATOR else None

    def get_class_decorator_hook_2(self, fullname: str) -> Callable[[ClassDefContext], bool] | None:
        return add_config_methods if fullname == DECORATOR else None


def plugin(version: str) -> type[Plugin]:
    """Entry point that mypy calls."""
    return ConfigClassPlugin
