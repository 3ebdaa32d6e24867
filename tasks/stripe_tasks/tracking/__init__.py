# SPDX-License-Identifier: Apache-2.0
"""Motion tracking tasks: a humanoid moves as recorded motions do."""
