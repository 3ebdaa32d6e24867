# SPDX-License-Identifier: Apache-2.0
"""Spawners author assets as USD prims; import their names from :mod:`stripe_newton.sim`."""
