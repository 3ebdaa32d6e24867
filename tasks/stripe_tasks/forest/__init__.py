# SPDX-License-Identifier: Apache-2.0
"""A natural forest: ground, plants and stones, made from seeds."""
