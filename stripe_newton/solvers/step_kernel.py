# SPDX-License-Identifier: Apache-2.0
"""Step kernel: one Warp kernel that steps all worlds of a model, generated from C++ source and the model's tables."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType

import warp as wp
from mujoco_warp import OverflowType

import stripe_kernels
from stripe_kernels.actuators import JointDrives
from stripe_newton.compile_ahead import compile_ahead, wait_for
from stripe_newton.generated_files import write_generated

from .model_tables import PARAMETERS, TOUCHES, ModelTables
from .step_body import PLACING, advance, find_world

__all__ = [
    "BODY_SIZE", "CONTACTS", "NEWTON_IN", "NEWTON_MODEL", "NEWTON_OUT", "OUTPUTS", "READ", "STATE", "KernelOptions",
    "StepKernel", "has_few_worlds", "step_kernel",
]  # fmt: skip

_SOURCES = (
    "algebra.h", "primitives.h", "boxes.h", "polygons.h", "hulls.h", "hull_contacts.h", "cores.h", "curved.h",
    "search.h", "heightfield.h", "meshes.h", "search_hits.h", "contact_fields.h", "world.h", "rows.h", "poses.h",
    "impedance.h", "dynamics.h", "constraints.h", "attachments.h", "geoms.h", "ground_parts.h", "collision.h",
    "touches.h", "ground.h", "cones.h", "hessian.h", "wrench_rows.h", "wrench_solve.h", "newton.h", "newton_state.h",
    "per_step.h", "launch.h", "results.h", "accelerations.h", "step.h",
)  # fmt: skip
_LIMB_SOURCES = (
    "algebra.h", "primitives.h", "boxes.h", "search.h", "heightfield.h", "meshes.h", "search_hits.h",
    "contact_fields.h", "limb_world.h", "rows.h", "poses.h", "impedance.h", "geoms.h", "ground_parts.h", "copies.h",
    "newton_state.h", "per_step.h", "launch.h", "limb_state.h", "limb_frames.h", "limb_parameters.h",
    "limb_dynamics.h", "limb_ground.h", "limb_contacts.h", "limb_search.h", "limb_newton.h", "limb_step.h",
)  # fmt: skip
"""Those of the form for a hub with limbs."""
STATE = ("qpos", "qvel", "qacc_warmstart", "ctrl", "qfrc_applied", "xfrc_applied")
"""Arrays of the state in MuJoCo Warp's data, ``(num_worlds, ...)``; the first three are written, too."""
OUTPUTS = ("nefc", "solver_niter", "overflow", "qfrc_actuator")
"""Arrays of results in MuJoCo Warp's data: constraint rows, iterations, what did not fit, forces of actuators."""
_STRUCT = "STRUCT_OF_ARGUMENTS"
"""Stands for the name that Warp gives the struct in C++."""
_WARP = 32
_OVERFLOW = {"ROWS": OverflowType.NEFC, "CONTACTS": OverflowType.NARROWPHASE}
"""Bits that MuJoCo Warp reports for what did not fit."""
READ = ("xpos", "xquat", "efc_force")
"""Arrays of MuJoCo Warp's data that are written where somebody reads contacts, ``(num_worlds, ...)``."""
CONTACTS = ("pos", "frame", "friction", "dist", "dim", "geom", "efc_address", "worldid")
"""Arrays of its contacts that are; the arguments have their addresses as ``contact_*``, 0 where nobody reads them."""
_SPACES = ("contacts", "bodies", "contact_forces")
"""Arrays for contacts that others find, for what the kernel keeps of bodies for a moment where their accelerations are
read, :data:`BODY_SIZE` numbers for each, and for forces of contacts."""
_PER_STEP = ("drives", "solver_drives", "wrenches", "velocity_limits")
"""Names that :attr:`KernelOptions.per_step` may have."""
BODY_SIZE = 31
"""Numbers of a body, as in accelerations.h."""
_ARRAYS = *STATE, *PARAMETERS, *OUTPUTS, *READ, *_SPACES, "force_geoms"
NEWTON_IN = (
    "joint_q_in", "joint_qd_in", "joint_f", "body_f", "joint_target_q", "joint_target_qd", "controls",
    "external_wrench", "wrench_in_world", "velocity_limit",
)  # fmt: skip
"""Arrays of Newton's state and control, and of what is done in each physics step (:class:`.per_step.PerStep`). Those of
the state and control with an address are read instead of MuJoCo's arrays of the same."""
NEWTON_OUT = (
    "joint_q_out", "joint_qd_out", "joint_q_before", "joint_qd_before", "body_q", "body_qd", "efforts",
    "computed_effort", "body_qdd", "body_parent_f",
)  # fmt: skip
"""Arrays of Newton that are written where they have an address: the state after the last step of a launch, the joints
before it, forces of actuators and what their laws asked for, and accelerations and wrenches of bodies."""
NEWTON_MODEL = ("joint_X_p", "joint_X_c", "body_com", "body_flags", "dof_ref", "newton_body")
"""Arrays of Newton's model that the conversion reads; the last has the bodies of MuJoCo's."""
_ADDRESSES = (
    *(f"contact_{n}" for n in CONTACTS),
    *NEWTON_IN,
    *NEWTON_OUT,
    *NEWTON_MODEL,
    "contact_count",
    "eq_active",
    "field_size",
    "field_heights",
    "meshes",
    "hulls",
    "hidden",
    "overflow_seen",
    "overflow_told",
    "workspace",
)
_SM_BYTES = 228 * 1024
"""Shared memory of a multiprocessor of an H100 [bytes]."""
_ROOMS = (2, 16), (1, 16), (1, 8), (1, 4)
"""Blocks that a multiprocessor should have room for, and worlds of a block, the best first.

Worlds of a block go through the code together, so that few large blocks wait less for instructions than many small
ones. With two, one computes while the other waits for its slowest world. 4096 worlds are 31 for each multiprocessor.
"""
_BLOCK_BYTES = 227 * 1024
"""Shared memory that a block may have [bytes]."""
_OF_CUDA = 1024
"""Shared memory of a block that CUDA takes [bytes]."""
_SM_REGISTERS = 65536
_LIMB_THREADS, _LIMB_BLOCKS = 128, 2
"""Threads of a block in the form for a hub with limbs, and blocks for which a multiprocessor should have registers."""
_MULTIPROCESSORS, _CACHE_BYTES = 132, 100 * 1024
"""Multiprocessors of an H100, and of its memory for shared arrays what should be left as a cache [bytes]."""
_TYPICAL_ROWS, _TYPICAL_CONTACTS = 28, 8
"""Constraint rows and contacts of a world that lie in its state at least: those of a robot on four feet."""


@dataclass(frozen=True)
class KernelOptions:
    """Options of a step kernel, which are constants in it."""

    lanes: int = 1
    """Threads that share a world: 1, or 8, 16 or 32 of a warp."""
    double: bool = False
    """Double precision, to test the source against MuJoCo's C."""
    tolerance: float = 1e-6
    iterations: int = 100
    ls_iterations: int = 50
    given_contacts: bool = False
    """The caller gives contacts, beside those that the kernel finds."""
    accelerations: bool = False
    """Accelerations of bodies and wrenches of their joints can be asked for; their code takes registers of a GPU."""
    contacts: bool = False
    """MuJoCo Warp's arrays of contacts and constraint forces can be filled."""
    kinematic_bodies: bool = False
    """Bodies of Newton's model may be kinematic: the caller moves their joints."""
    contact_forces: bool = False
    """Forces and geoms of contacts can be written."""
    per_step: frozenset[str] = frozenset()
    """Names of what each physics step may have to do, see :class:`.per_step.PerStep`."""
    few_worlds: bool = False
    """In the form for a hub with limbs a multiprocessor has one block at most, see :func:`has_few_worlds`."""

    @property
    def has_drives(self) -> bool:
        """Whether the kernel takes the struct of actuators."""
        return not self.per_step.isdisjoint(("drives", "solver_drives"))

    def in_registers(self, tables: ModelTables) -> bool:
        """Whether matrices are factored in registers, with one or two rows in each lane.

        Without Jacobians a lane has one row, and a few lanes one of the short first rows, too (wrench_solve.h).
        """
        return tables.limbs is None and self.lanes > 1 and tables.model.nv <= 2 * self.lanes and not self.double


@dataclass(frozen=True)
class Layout:
    """Layout of a step kernel's memory: how much of a world is in shared memory, how many worlds share a block."""

    rows: int
    """Constraint rows in the state; those beyond are in the world's spill memory."""
    contacts: int
    world_size: int
    """Numbers of four bytes in the state."""
    spill_size: int
    """Numbers of the spill memory of a world."""
    worlds_per_block: int
    tables_size: int
    """Shared memory of a block for the tables of the topology [bytes]."""
    in_shared: bool
    """Whether the state is in shared memory; otherwise it is in the workspace."""
    num_limbs: int = 0
    """Limbs in the form for a hub with limbs, 0 in the general form."""
    searches_size: int = 0
    """Numbers of four bytes in shared memory of what the lanes of a warp search together, in that form."""
    padding: int = 0
    """Numbers of four bytes in shared memory that are not used, so that there is no room for a second block."""

    @property
    def is_limbs(self) -> bool:
        """Whether the step has the form for a hub with limbs."""
        return self.num_limbs > 0

    @property
    def workspace_size(self) -> int:
        """Numbers of the workspace that a world needs, in fours so that its matrix lies well."""
        size = self.spill_size + (0 if self.in_shared else self.world_size)
        return -(-size // 4) * 4

    def memory_size(self, lanes: int) -> int:
        """Numbers of four bytes in shared memory that a block has for its worlds, the tables and searches."""
        warps = self.worlds_per_block * lanes // _WARP
        used = self.worlds_per_block * self.world_size + self.tables_size // 4 + warps * self.searches_size
        return used + self.padding

    def block_size(self, lanes: int) -> int:
        """Shared memory that a block takes [bytes]."""
        return 4 * self.memory_size(lanes) + _of_warp(self.worlds_per_block, lanes) + _OF_CUDA

    @classmethod
    def of(cls, tables: ModelTables, options: KernelOptions) -> Layout:
        """The most worlds in a multiprocessor that leave room for the rows and contacts that a robot mostly has."""
        most = tables.max_rows, tables.max_contacts
        if tables.limbs is not None:
            size, worlds = tables.limbs.world_size, _LIMB_THREADS // options.lanes if options.lanes > 1 else 1
            searches = tables.limbs.searches_size(tables.pairs) if options.lanes > 1 else 0
            constants, limbs = tables.constants.shared_size, len(tables.limbs.limbs)
            layout = cls(0, 0, size, 0, worlds, constants, options.lanes > 1, limbs, searches)
            return replace(layout, padding=_padding(layout, options.lanes)) if options.few_worlds else layout
        if options.lanes == 1:
            return cls(*most, tables.world_size(*most, False), 0, 1, 0, False)
        registers, constants = options.in_registers(tables), tables.constants.shared_size
        least = min(_TYPICAL_ROWS, tables.max_rows), min(_TYPICAL_CONTACTS, tables.max_contacts)
        for blocks, worlds in _ROOMS:
            free = min(_BLOCK_BYTES, _SM_BYTES // blocks - _OF_CUDA) - _of_warp(worlds, options.lanes) - constants
            budget = free // worlds // 4
            if tables.world_size(*least, registers) > budget:
                continue
            rows, contacts = _most_rows(tables, *least, budget, registers)
            size = tables.world_size(rows, contacts, registers)
            return cls(rows, contacts, size, tables.spill_size(rows, contacts), worlds, constants, True)
        size = tables.world_size(*most, registers)
        return cls(*most, size, 0, 1, 0, False)


def has_few_worlds(num_worlds: int, lanes: int) -> bool:
    """Whether there is no more than a block for each multiprocessor, in the form for a hub with limbs."""
    return lanes > 1 and num_worlds <= _MULTIPROCESSORS * (_LIMB_THREADS // lanes)


def _padding(layout: Layout, lanes: int) -> int:
    """Numbers by which blocks are made larger than half of the memory for shared arrays.

    That is the same memory as the cache, where contacts of lanes are. CUDA divides it for as many blocks as there is
    room for, also where there are fewer.
    """
    size = layout.block_size(lanes)
    return max(0, (_SM_BYTES // 2 - size) // 4 + 4) if 2 * size > _SM_BYTES - _CACHE_BYTES else 0


def _most_rows(tables: ModelTables, rows: int, contacts: int, budget: int, registers: bool) -> tuple[int, int]:
    """The most rows and contacts of a world that fit into ``budget`` numbers, at least those that are given."""
    # Rows without Jacobians are so small that contacts decide, too: four rows have one.
    step = (4, 1) if tables.wrench_rows else (1, 0)
    while rows < tables.max_rows:
        more = min(rows + step[0], tables.max_rows), min(contacts + step[1], tables.max_contacts)
        if tables.world_size(*more, registers) > budget:
            break
        rows, contacts = more
    return rows, contacts


def _of_warp(worlds: int, lanes: int) -> int:
    """Shared memory that Warp has for the tiles of a block [bytes]."""
    return 4 * worlds * lanes


@dataclass(frozen=True)
class StepKernel:
    """Step kernel of a model, with a second kernel that only places its geoms."""

    kernel: wp.Kernel
    place: wp.Kernel | None
    """Kernel that only places bodies and geoms, for collision detection by others; None in the form for a hub with
    limbs, which finds all contacts itself."""
    arguments: type
    """Struct of the addresses that it takes; see :func:`step_kernel`."""
    options: KernelOptions
    layout: Layout

    @property
    def _block_dim(self) -> int:
        """Threads of a block."""
        return 256 if self.options.lanes == 1 else self.layout.worlds_per_block * self.options.lanes

    def compile_ahead(self, device: str) -> None:
        """Begin to compile the kernel, which the first launch waits for."""
        compile_ahead(self.kernel, self._block_dim, device)

    def launch(
        self,
        arguments: object,
        num_worlds: int,
        device: str,
        steps: int = 1,
        place: bool = False,
        drives: JointDrives | None = None,
    ) -> None:
        """Launch the kernel: ``steps`` time steps of ``num_worlds`` worlds, or only the placing of their geoms.

        Args:
            arguments: Addresses of the arrays.
            num_worlds: Number of worlds.
            device: Name of the device.
            steps: Number of time steps.
            place: Only place the geoms.
            drives: Actuators, if the kernel has them.
        """
        lanes, per_block = self.options.lanes, self.layout.worlds_per_block
        blocks = -(-num_worlds // per_block)
        dim = num_worlds if lanes == 1 else blocks * per_block * lanes
        kernel = self.place if place else self.kernel
        inputs = [arguments, num_worlds, steps]
        if not place and self.options.has_drives:
            inputs.append(drives or JointDrives())
        wait_for(kernel)
        wp.launch(kernel, dim=dim, inputs=inputs, device=device, block_dim=self._block_dim)


def step_kernel(tables: ModelTables, options: KernelOptions) -> StepKernel:
    """Make the step kernel of a model; with a layout of Newton's it can read and write Newton's state.

    Its argument is a struct. For each array of the state and of :data:`PARAMETERS` it has the address ``name`` (uint64)
    and the stride from one world to the next ``name_stride`` (in numbers; 0 for one that all worlds share). The time
    step is ``dt`` [s]; if that is 0, that of the parameters.
    """
    layout = Layout.of(tables, options)
    library = _library(tables, options, layout)
    module = _module(_python_source(library, options, layout))
    place = getattr(module, "place_worlds", None)
    return StepKernel(module.step_worlds, place, module.Arguments, options, layout)


def _library(tables: ModelTables, options: KernelOptions, layout: Layout) -> str:
    folder = Path(stripe_kernels.__file__).parent / "fused"
    names = _SOURCES if tables.limbs is None else _LIMB_SOURCES
    sources = {name: (folder / name).read_text() for name in names}
    exact, share = (1e-14, 1e-12) if options.double else (1e-6, 1e-2)
    head = [
        *(["#define FUSED_DOUBLE"] if options.double else []),
        f"#define LANES {options.lanes}",
        # Lanes that search for touches together; in the form for a hub with limbs see limb_search.h.
        f"#define SEARCH_LANES {options.lanes if tables.limbs is None else 1}",
        f"#define IN_REGISTERS {int(options.in_registers(tables))}",
        f"#define IN_SHARED {int(layout.in_shared)}",
        f"#define WORLDS_PER_BLOCK {layout.worlds_per_block}",
        f"#define LIMBS {int(tables.limbs is not None)}",
        f"#define WARP_SEARCHES_SIZE {layout.searches_size}",
        *([] if tables.limbs else [f"#define LD {tables.row_of_matrix(options.in_registers(tables))}"]),
        f"#define SEARCHES {min(tables.searches(layout.rows), options.lanes)}",
        f"#define TOUCHES {TOUCHES}",
        f"#define TOLERANCE ((real){options.tolerance!r})",
        f"#define MAX_ITERATIONS {options.iterations}",
        f"#define LINE_STEPS {options.ls_iterations}",
        f"#define ACCELERATIONS {int(options.accelerations)}",
        f"#define CONTACTS {int(options.contacts)}",
        f"#define CONTACT_FORCES {int(options.contact_forces)}",
        f"#define KINEMATIC_BODIES {int(options.kinematic_bodies)}",
        f"#define GIVEN_CONTACTS {int(options.given_contacts)}",
        *(f"#define {name.upper()} {int(name in options.per_step)}" for name in _PER_STEP),
        *(f"#define OVERFLOW_{name} {int(bit)}" for name, bit in _OVERFLOW.items()),
        f"#define NOTHING ((real){share * options.tolerance!r})",
        f"#define LINE_TOLERANCE ((real){exact!r})",
    ]
    constants = tables.source(layout.rows, layout.contacts)
    parts = ["\n".join(head) + "\n", sources["algebra.h"], constants, _parameters_source()]
    parts += [sources[n] for n in names[1:]]
    parts.append(f'static_assert(sizeof(fused::World) <= sizeof(real) * {layout.world_size}, "size of World");\n')
    if layout.in_shared:
        parts.append(f'static_assert(sizeof(fused::Tables) <= {layout.tables_size}, "size of Tables");\n')
    return "".join(parts)


def _parameters_source() -> str:
    """The parameters of a world, from the struct of the arguments.

    Addresses are computed where they are used, from what a GPU has at hand as constants: all together they would fill
    the registers.
    """
    kinds = dict.fromkeys(PARAMETERS, "const real*") | dict.fromkeys((*STATE, *READ, *_SPACES), "real*")
    kinds |= dict.fromkeys((*OUTPUTS, "force_geoms"), "int*") | {"qfrc_actuator": "real*"}
    methods = [
        f"    FN_METHOD {kind} {n}() const {{ return ({kind})m.{n} + (long long)id * m.{n}_stride; }}"
        for n, kind in kinds.items()
    ]
    methods.append("    FN_METHOD real step_size() const { return m.dt > 0 ? (real)m.dt : timestep()[0]; }")
    body = [f"    const {_STRUCT}& m;", "    const int id, num_worlds;", *methods]
    return "\n".join(["namespace fused {", "struct Parameters {", *body, "};", "}", ""])


def _python_source(source: str, options: KernelOptions, layout: Layout) -> str:
    fields = [f"    {name}: wp.uint64\n    {name}_stride: int\n" for name in _ARRAYS]
    fields += [f"    {name}: wp.uint64\n" for name in _ADDRESSES] + ["    dt: float\n"]
    # The body of a native function stands in braces: the first one closes them, and so makes room for a library.
    library = f"}}\n{source}\nstatic CUDA_CALLABLE inline void fused_library_end() {{\n"
    bounds = ""
    if layout.in_shared:  # as many registers as leave room for all blocks whose worlds fit into the shared memory
        threads = layout.worlds_per_block * options.lanes
        blocks = min(_SM_BYTES // layout.block_size(options.lanes), _SM_REGISTERS // (64 * threads))
        bounds = f", launch_bounds=({threads}, {_LIMB_BLOCKS if layout.is_limbs else max(1, blocks)})"
    return "\n".join(
        [
            "import warp as wp",
            "from stripe_kernels.actuators import JointDrives, ask_solver_joint",
            "from stripe_kernels.actuators import drive_explicit_joint, feed_solver_joint, solver_drive, solver_feed",
            "@wp.struct",
            "class Arguments:",
            *fields,
            f"@wp.func_native({library!r}.replace({_STRUCT!r}, Arguments.native_name))",
            "def library(): ...",
            *_kernel("step", advance(options), options, layout, bounds, options.per_step),
            *([] if layout.is_limbs else _kernel("place", PLACING, options, layout, bounds)),
            "",
        ]
    )


def _kernel(
    name: str,
    work: list[str],
    options: KernelOptions,
    layout: Layout,
    bounds: str,
    per_step: frozenset[str] = frozenset(),
) -> list[str]:
    body = "\n".join(["", *find_world(options, layout), *work, ""])
    memory = []
    if layout.in_shared:  # a tile, as it makes Warp ask for so much; it is the only one and thus at the start
        size = layout.memory_size(options.lanes)
        memory = [f"    memory = wp.tile_empty(shape=({size},), dtype=float, storage='shared')"]
    # Native code calls these functions. Warp emits one only where a kernel calls it, and ahead of what is called later.
    called = ["        drive_explicit_joint(0, 0, 0.0, 0.0, drives)"] if "drives" in per_step else []
    if "solver_drives" in per_step:
        called += ["        feed_solver_joint(0, 0, drives)", "        ask_solver_joint(0, 0, 0.0, 0.0, drives)"]
        called += ["        solver_feed(False, 0, 0.0, 0.0, 0.0, 0.0)", f"        solver_drive(0{', 0.0' * 7})"]
    more, given = (", drives: JointDrives", ", drives") if called else ("", "")
    called = ["    if steps < 0:", *called] if called else []
    return [
        f"@wp.func_native({body!r})",
        f"def {name}_world(tid: int, m: Arguments, num_worlds: int, steps: int{more}): ...",
        f"@wp.kernel(enable_backward=False{bounds})",
        f"def {name}_worlds(m: Arguments, num_worlds: int, steps: int{more}):",
        "    library()",
        *called,
        *memory,
        f"    {name}_world(wp.tid(), m, num_worlds, steps{given})",
    ]


def _module(text: str) -> ModuleType:
    """The text as a module. Warp reads the source of kernels from a file, and caches what it compiled by content."""
    name = f"stripe_fused_{hashlib.sha256(text.encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    path = write_generated(f"{name}.py", text)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module
