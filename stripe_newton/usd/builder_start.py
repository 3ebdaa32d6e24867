# SPDX-License-Identifier: Apache-2.0
"""Builder start: what was in a builder before a file is read into it."""

from __future__ import annotations

import newton

__all__ = ["BuilderStart"]


class BuilderStart:
    """Counts of a builder before a stage is read into it: what comes after them belongs to the stage."""

    def __init__(self, builder: newton.ModelBuilder):
        self.body, self.joint, self.shape = builder.body_count, builder.joint_count, builder.shape_count
        self.dof, self.coord = builder.joint_dof_count, builder.joint_coord_count
        self.articulation = builder.articulation_count
