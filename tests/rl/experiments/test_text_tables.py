# SPDX-License-Identifier: Apache-2.0
"""Text tables: numbers, columns and short names of fields."""

from __future__ import annotations

from stripe_newton.rl.experiments.text_tables import format_number, format_table, short_names


def test_numbers_and_tables():
    numbers = [0.000123456, 3.0, 12345.678, 123456, float("nan"), None, "x", True, 1e-4]
    shown = ["0.0001235", "3", "12,346", "123,456", "-", "-", "x", "True", "0.0001"]
    assert [format_number(number) for number in numbers] == shown
    assert format_table(["a", "number"], [["x", 1.5], ["long", None]]).splitlines() == [
        "a     number",
        "----  ------",
        "x        1.5",
        "long       -",
    ]


def test_short_names_are_told_apart():
    names = short_names(["agent.actor.lr", "agent.critic.lr", "agent.gamma", "gamma"])
    assert names["agent.actor.lr"] == "actor.lr"
    assert names["agent.critic.lr"] == "critic.lr"
    assert names["agent.gamma"] == "agent.gamma"
    assert names["gamma"] == "gamma"
