# SPDX-License-Identifier: Apache-2.0
"""Wrappers that give an environment the interface of a learning library: rsl_rl, Stable-Baselines3, skrl.

Each library is imported by its own module alone, so that none of them has to be installed for another.
"""
