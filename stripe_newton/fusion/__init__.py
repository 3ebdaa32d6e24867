# SPDX-License-Identifier: Apache-2.0
"""Fusion: terms become calls in generated source code, source code becomes kernels, kernels become a CUDA graph.

Data flows in one direction. ``bind_term`` finds the arguments of a term and returns a :class:`TermCall`. A manager
writes calls and other lines into a :class:`Section`. A :class:`Plan` fuses neighbouring sections into kernels and
records them in CUDA graphs. Source code is written and never parsed: a piece of :class:`Code` knows the names in it.
"""

from .binding import BindingContext, bind_term
from .episode_log import EpisodeLog
from .function_check import function_problem
from .fused_kernel import FusedKernel, fuse
from .parameters import Parameters
from .plan import GraphCaptureError, Plan
from .scene_entity import HasNames, SceneEntityCfg, resolve_entities
from .scope import Scope
from .single_thread import single_thread
from .source import Code, Name, TunedNumber, block, code, indented
from .stage import Captured, Eager, Flag, GraphPart, Item, Section, Stage, fields_used, may_use, only
from .structs import NamedStructs, ParameterReferences, SharedStruct, StructRegistry, StructResolver
from .term_arrays import TermState
from .term_binding import ArgumentError, TermBinding, TermContext
from .term_call import TermCall
from .usage import Usage, usage_of

__all__ = [
    "ArgumentError",
    "BindingContext",
    "Captured",
    "Code",
    "Eager",
    "EpisodeLog",
    "Flag",
    "FusedKernel",
    "GraphCaptureError",
    "GraphPart",
    "HasNames",
    "Item",
    "Name",
    "NamedStructs",
    "ParameterReferences",
    "Parameters",
    "Plan",
    "SceneEntityCfg",
    "Scope",
    "Section",
    "SharedStruct",
    "Stage",
    "StructRegistry",
    "StructResolver",
    "TermBinding",
    "TermCall",
    "TermContext",
    "TermState",
    "TunedNumber",
    "Usage",
    "bind_term",
    "block",
    "code",
    "fields_used",
    "function_problem",
    "fuse",
    "indented",
    "may_use",
    "only",
    "resolve_entities",
    "single_thread",
    "usage_of",
]
