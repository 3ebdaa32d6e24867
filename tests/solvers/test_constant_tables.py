# SPDX-License-Identifier: Apache-2.0
"""Constant tables: types, what fits into shared memory, and the C++ that they become."""

import random
import re

import pytest

from stripe_newton.solvers.constant_tables import ConstantTables, rule_of

WITHOUT_RULE = [3, 1, 2, 0, 5]


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([255], "unsigned char"), ([-1, 127], "signed char"), ([256], "short"), ([-129], "short"), ([2**15], "int"),
        ([2**40], "unsigned long long"), ([], "unsigned char"),
    ],
)  # fmt: skip
def test_integers_take_the_smallest_type_that_holds_them(values, kind):
    source = ConstantTables({"parent": [*WITHOUT_RULE, *values]}, {}).source()
    assert re.search(rf"{kind} parent\[{5 + len(values)}\];", source)


def test_an_element_is_the_value_of_a_function():
    source = ConstantTables({"parent": WITHOUT_RULE}, {"gear": [1.5, 2.0]}).source()
    assert "FN int parent(int i) { return tables().parent[i]; }" in source
    assert "FN real gear(int i) { return tables().gear[i]; }" in source
    assert "{3, 1, 2, 0, 5}," in source
    assert "{1.5, 2.0}," in source


def test_large_tables_stay_in_global_memory():
    tables = ConstantTables({"pair": WITHOUT_RULE * 1000, "parent": WITHOUT_RULE}, {})
    assert "TABLE unsigned char all_of_pair[] = {3, 1" in tables.source()
    assert "FN int pair(int i) { return all_of_pair[i]; }" in tables.source()
    assert tables.shared_size == 16


def test_tables_have_no_gaps():
    tables = ConstantTables(
        {"small": [1, 0, 0, 1, 1], "wide": [2**40], "medium": [300, 0, 0, 300, 300]}, {"real": [0.5, 1]}
    )
    assert tables.shared_size == 32  # 8 + 8 + 10 + 5 bytes, in sixteens
    names = re.findall(r"^ {4}[a-z ]+ (\w+)\[", tables.source(), re.MULTILINE)
    assert names == ["wide", "real", "medium", "small"]


@pytest.mark.parametrize(
    ("values", "rule"),
    [
        ([], "0"), ([7], "7"), ([-1] * 4, "-1"), ([1, 2, 3], "1 * i + 1"), ([0, 7, 8, 9], "i < 1 ? 0 : 1 * i + 6"),
        ([0, 0, 0, 1, 2], "i < 2 ? 0 : 1 * i + -2"), (WITHOUT_RULE, ""), ([2**31], ""),
    ],
)  # fmt: skip
def test_a_table_that_follows_a_rule_is_computed(values, rule):
    assert rule_of(values) == rule
    if rule:
        tables = ConstantTables({"parent": values}, {})
        assert f"FN int parent(int i) {{ return {rule}; }}" in tables.source()
        assert "parent[" not in tables.source()


def test_equal_reals_are_a_constant():
    assert "FN real gear(int i) { return (real)1.5; }" in ConstantTables({}, {"gear": [1.5, 1.5]}).source()


def test_rules_give_the_elements_of_their_tables():
    draw, followed = random.Random(0), 0
    for _ in range(3000):
        first, second = (draw.randint(-3, 3) for _ in range(2))
        start, size = draw.randint(0, 5), draw.randint(1, 9)
        values = [first * i + 1 if i < start else second * i - 2 for i in range(size)]
        if draw.random() < 0.5:
            values[draw.randrange(size)] += 1
        if rule := rule_of(values):
            followed += 1
            condition, _, lines = rule.partition(" ? ")
            line = "{1} if {0} else {2}".format(condition, *lines.split(" : ")) if lines else rule
            assert [eval(line, {"i": i}) for i in range(size)] == values
    assert followed > 1500
