# SPDX-License-Identifier: Apache-2.0
"""Constant tables: types, what fits into shared memory, and the C++ that they become."""

import re

import pytest

from stripe_newton.solvers.constant_tables import ConstantTables


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([0, 255], "unsigned char"), ([-1, 127], "signed char"), ([0, 256], "short"), ([-129], "short"),
        ([2**15], "int"), ([2**40], "unsigned long long"), ([], "unsigned char"),
    ],
)  # fmt: skip
def test_integers_take_the_smallest_type_that_holds_them(values, kind):
    assert re.search(rf"{kind} parent\[{max(1, len(values))}\];", ConstantTables({"parent": values}, {}).source())


def test_an_element_is_the_value_of_a_function():
    source = ConstantTables({"parent": [0, 0, 1]}, {"gear": [1.5]}).source()
    assert "FN int parent(int i) { return tables().parent[i]; }" in source
    assert "FN real gear(int i) { return tables().gear[i]; }" in source
    assert "{0, 0, 1}," in source
    assert "{1.5}," in source


def test_large_tables_stay_in_global_memory():
    tables = ConstantTables({"pair": [1] * 5000, "parent": [0] * 10}, {})
    assert "TABLE unsigned char all_of_pair[] = {1, 1" in tables.source()
    assert "FN int pair(int i) { return all_of_pair[i]; }" in tables.source()
    assert tables.shared_size == 16


def test_tables_have_no_gaps():
    tables = ConstantTables({"small": [1] * 3, "wide": [2**40], "medium": [300] * 2}, {"real": [0.5]})
    assert tables.shared_size == 32  # 8 + 4 + 4 + 3 bytes, in sixteens
    names = re.findall(r"^ {4}[a-z ]+ (\w+)\[", tables.source(), re.MULTILINE)
    assert names == ["wide", "real", "medium", "small"]
