# SPDX-License-Identifier: Apache-2.0
"""Expressions: those that may take hours are refused; all others match as Python's own do."""

from __future__ import annotations

import re
import time

import pytest

from stripe_newton.expressions import SlowExpressionError, expression_of, full_match
from stripe_newton.matching import NoMatchError, match_names

NAMES = ["FL_hip_joint", "left_knee", "a", "", "aaa", "LF_FOOT", "/World/envs/env_0/Robot/base", "slider_to_cart", "x2"]


@pytest.mark.parametrize(
    "text",
    [
        ".*", "(FL|FR|RL|RR)_(hip|thigh|calf)_joint", ".*_knee", "(left|right)?_?.*", "[a-z_]+[0-9]{0,3}", "(?i:lf_.*)",
        "(?!a).*", "(a)?(?(1)aa|.*2)", "/World/envs/env_.*/Robot(/.*)?", "(?P<x>a)(?P=x)*", "(ab|a){0,3}", "", "a{3}",
        "(a|l)*", "(?:sl|e|i|d|r){1,5}_to_cart", "(?=s).*(?<=t)",
    ],
)  # fmt: skip
def test_what_matches_is_what_python_matches(text):
    for name in NAMES:
        ours, theirs = full_match(text, name), re.fullmatch(text, name)
        assert (ours and ours.groups()) == (theirs and theirs.groups())


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ("(.|.)*Q", "slider_to_cart"),
        ("(a+)*Q", "a" * 60),
        ("(?:a?){60}Q", "a" * 60),
        ("(?=(a|a)*Q).*", "a" * 60),
        ("(a|a)" * 60 + "Q", "a" * 60),
        ("(?:a?){16}" * 4 + "Q", "a" * 64),
        (".*a" * 20 + "Q", "a" * 60),
        (".*a.*a.*a.*Q", "a" * 10_000),
        ("((a|a){4}|b){16}Q", "a" * 64),
    ],
)
def test_what_may_take_hours_is_refused_at_once(text, name):
    began = time.monotonic()
    with pytest.raises(SlowExpressionError, match="may take hours to match"):
        full_match(text, name)
    assert time.monotonic() - began < 5.0


@pytest.mark.parametrize("text", ["(", "[", "a{99999999999}", "(" * 5000 + ")" * 5000, "(?P<1>a)", "*"])
def test_what_is_no_expression_is_an_error_of_re(text):
    with pytest.raises(re.error):
        expression_of(text)


def test_names_say_why_an_expression_is_refused():
    with pytest.raises(NoMatchError, match=r"joint expression '\(.\|.\)\*Q' may take hours to match, as it repeats"):
        match_names("(.|.)*Q", NAMES, what="joint")
    with pytest.raises(NoMatchError, match=r"joint expression '\(' is no regular expression: missing \)"):
        match_names("(", NAMES, what="joint")
