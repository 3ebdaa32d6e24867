# SPDX-License-Identifier: Apache-2.0
"""Manager fields: the fields of an environment's config that managers read, and what is wrong with others."""

from __future__ import annotations

import difflib
import inspect
from collections.abc import Iterator

from stripe_newton.configclass import MISSING, Config, is_config
from stripe_newton.managers import (
    ActionTermCfg,
    CommandTermCfg,
    CurriculumTermCfg,
    CustomManagerCfg,
    EventTermCfg,
    MetricTermCfg,
    ObjectPoolCfg,
    ObservationGroupCfg,
    ObservationTermCfg,
    RecorderTermCfg,
    RewardTermCfg,
    TerminationTermCfg,
)
from stripe_newton.managers.manager_base import terms_of

__all__ = ["MANAGER_FIELDS", "manager_field_problems"]

MANAGER_FIELDS: dict[str, tuple[type, ...]] = {
    "observations": (ObservationGroupCfg, ObservationTermCfg),
    "actions": (ActionTermCfg,),
    "rewards": (RewardTermCfg,),
    "terminations": (TerminationTermCfg,),
    "events": (EventTermCfg,),
    "commands": (CommandTermCfg,),
    "curriculum": (CurriculumTermCfg,),
    "objects": (ObjectPoolCfg,),
    "metrics": (MetricTermCfg,),
    "recorders": (RecorderTermCfg,),
    "managers": (CustomManagerCfg,),
}
"""Classes of the terms, by the field of the config that has them."""
_TERMS = tuple(kind for kinds in MANAGER_FIELDS.values() for kind in kinds)


def manager_field_problems(cfg: Config) -> Iterator[tuple[str, str]]:
    """Problems of the fields that managers read, and of fields with terms that no manager reads.

    Args:
        cfg: Config of an environment.

    Yields:
        Field, and what is wrong with it.
    """
    for name in type(cfg).__dataclass_fields__:
        value = getattr(cfg, name)
        if name in MANAGER_FIELDS:
            yield from ((name, text) for text in _container_problems(value, MANAGER_FIELDS[name][0].__name__))
        elif _holds_terms(value):
            near = difflib.get_close_matches(name, MANAGER_FIELDS, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"terms are read from {', '.join(MANAGER_FIELDS)}"
            yield name, f"has terms, and no manager reads a field of that name; {hint}"


def _container_problems(value: object, term: str) -> Iterator[str]:
    """Problems of what should be a config or a dict of terms."""
    kind = type(value).__name__
    if value is None or value is MISSING or isinstance(value, dict) or is_config(value):
        return
    if inspect.isclass(value):
        yield f"is the class {value.__name__}, must be an instance of it: {value.__name__}()"
    elif hasattr(value, "__dataclass_fields__"):
        yield f"is a {kind}, whose class has @dataclass; write @configclass above it"
    else:
        yield f"is a {kind}, must be a dict of {term} by name, or an instance of a class with @configclass"


def _holds_terms(value: object) -> bool:
    """Whether it is a term, or a config or dict with a term in it."""
    if isinstance(value, _TERMS):
        return True
    inside = terms_of(value) if isinstance(value, dict) or is_config(value) else {}
    return any(isinstance(item, _TERMS) for item in inside.values())
