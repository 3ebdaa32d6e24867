# SPDX-License-Identifier: Apache-2.0
"""Manipulation tasks: an arm reaches, lifts a cube and opens a drawer, a hand turns a cube."""
