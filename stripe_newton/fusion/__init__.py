# SPDX-License-Identifier: Apache-2.0
"""Terms composed into kernels, kernels into one graph a step."""

from .binding import TermCall, TermState, bind_term, fields_read
from .entity import SceneEntityCfg, names_of, resolve_entities
from .items import Captured, Eager, Item, Section
from .kernels import FusedKernel, fuse
from .log import EpisodeLog
from .parameters import Parameters
from .plan import GraphCaptureError, Plan, Stage
from .scope import Scope
from .single import single_thread

__all__ = [
    "Captured",
    "Eager",
    "EpisodeLog",
    "FusedKernel",
    "GraphCaptureError",
    "Item",
    "Parameters",
    "Plan",
    "SceneEntityCfg",
    "Scope",
    "Section",
    "Stage",
    "TermCall",
    "TermState",
    "bind_term",
    "fields_read",
    "fuse",
    "names_of",
    "resolve_entities",
    "single_thread",
]
