# SPDX-License-Identifier: Apache-2.0
"""Solvers: the physics of articulated robots in one kernel, with MuJoCo's model and MuJoCo's formulas.

:class:`SolverFused` is a Newton solver. MuJoCo compiles the model and MuJoCo Warp holds its arrays, as in Newton's own
``SolverMuJoCo``; one generated kernel does a whole time step of a world, or several. The way from a model to a launch:

1. ``support`` says what models the kernel does not step. MuJoCo Warp then steps them.
2. ``pair_division`` decides which pairs of geoms the kernel finds contacts of (``contact_pairs`` has its routines), and
   leaves the others to MuJoCo Warp's collision detection. Static meshes are touched by their triangles
   (``static_triangles``, ``mesh_grid``, ``stand_ins``), other meshes by their hulls (``hulls``).
3. ``kernel_choice`` takes one of two forms of the step: a general one, or one for a hub with limbs (``limb_form``); and
   the features that are used, see ``per_step``.
4. ``model_tables`` writes the model's sizes and topology as constants of C++ source (``topology``, ``constant_tables``,
   ``newton_layout``). ``step_kernel`` joins them with the headers in ``stripe_kernels/fused`` to a Warp kernel.
5. ``step_launcher`` owns that kernel and launches it. ``launch_arguments`` fills in the addresses of MuJoCo Warp's,
   Newton's and its own arrays (``kernel_buffers``). Parameters that are equal in all worlds are read from one
   (``shared_parameters``); ``model_assumptions`` notices when they are no longer.
"""

from .kernel_buffers import ContactForces
from .per_step import PerStep
from .solver_fused import SolverFused
from .support import why_unsupported

__all__ = ["ContactForces", "PerStep", "SolverFused", "why_unsupported"]
