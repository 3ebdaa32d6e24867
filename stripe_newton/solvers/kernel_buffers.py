# SPDX-License-Identifier: Apache-2.0
"""Kernel buffers: device memory of the fused step beside the arrays of MuJoCo Warp and Newton."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco_warp
import warp as wp

from stripe_kernels.fused_contacts import FIELDS, GIVEN_SIZE, list_contacts, sort_contacts

from .step_kernel import BODY_SIZE

__all__ = ["ContactForces", "GivenContacts", "KernelBuffers"]


@dataclass
class ContactForces:
    """Forces of the contacts of the last step. Each world has a row, in which its contacts come first.

    Other arrays take the place of these when the solver's buffers are enlarged.
    """

    geoms: wp.array
    """The two geoms of MuJoCo's model, ``wp.vec2i``, shape ``(num_worlds, places)``; -1 in the first place without a
    contact, behind which nothing is valid."""
    forces: wp.array
    """Forces on the second geom in the world frame [N], ``wp.vec3``, shape ``(num_worlds, places)``."""


class GivenContacts:
    """Contacts that other collision detection finds, in the order and layout in which the kernel reads them.

    Attributes:
        count: Contacts of each world, int32, shape ``(num_worlds,)``.
        rows: Numbers of each contact, float32, shape ``(num_worlds, max_contacts, GIVEN_SIZE)``.
    """

    def __init__(self, num_worlds: int, max_contacts: int, device: wp.Device):
        """Allocate the contacts of all worlds."""
        self.count = wp.zeros(num_worlds, dtype=int, device=device)
        self.rows = wp.zeros((num_worlds, max_contacts, int(GIVEN_SIZE)), dtype=float, device=device)
        self._found = wp.zeros((num_worlds, max_contacts), dtype=int, device=device)

    def launch(self, data: mujoco_warp.Data) -> None:
        """Sort the contacts in MuJoCo Warp's arrays by world, and by geoms within it.

        Atomics have written them in any order, and sums of floats depend on the order.
        """
        contact, device = data.contact, self.count.device
        self.count.zero_()
        wp.launch(
            list_contacts,
            dim=data.naconmax,
            inputs=[data.nacon, contact.worldid, contact.type, contact.dist, contact.includemargin],
            outputs=[self.count, self._found],
            device=device,
        )
        fields = [getattr(contact, name) for name in FIELDS]
        inputs = [self.count, self._found, *fields]
        wp.launch(sort_contacts, self._found.shape, inputs, [self.rows], device=device)


class KernelBuffers:
    """Device memory of the kernel: its workspace, and buffers for results that are read.

    Attributes:
        workspace: What of a world's state has no place in shared memory, float32; None before the first kernel.
        given: Contacts that other collision detection finds; None where the kernel finds all.
        bodies: Intermediate results for accelerations of bodies, float32, shape ``(num_worlds, BODY_SIZE * nbody)``;
            None where nobody reads accelerations.
        contact_forces: Forces of contacts; None where nobody reads them.
        fills_contacts: Whether the kernel fills MuJoCo Warp's arrays of contacts and constraint forces.
        overflow_bits: Overflow bits of all worlds so far, and a copy in the host's memory of those that are new, each
            int32 of shape ``(1,)``; None if nobody collects them.
    """

    def __init__(self, data: mujoco_warp.Data, device: wp.Device):
        """Allocate nothing yet.

        Args:
            data: MuJoCo Warp's data, whose sizes apply.
            device: Device of the model.
        """
        self._data, self._device = data, device
        self.workspace: wp.array | None = None
        self._workspaces: list[wp.array] = []  # recorded graphs hold the addresses of all of them
        self.given: GivenContacts | None = None
        self.bodies: wp.array | None = None
        self.contact_forces: ContactForces | None = None
        self.fills_contacts = False
        self.overflow_bits: tuple[wp.array, wp.array] | None = None

    @property
    def max_contacts(self) -> int:
        """Contacts for which a world has room."""
        return max(1, int(self._data.naconmax) // int(self._data.nworld))

    def allocate(self, workspace_size: int, given_contacts: bool) -> None:
        """Allocate what a new kernel needs and the last one did not.

        Args:
            workspace_size: Numbers of the workspace, of all worlds.
            given_contacts: Whether other collision detection finds contacts.
        """
        if self.workspace is None or self.workspace.size < workspace_size:
            self.workspace = wp.empty(workspace_size, dtype=wp.float32, device=self._device)
            self._workspaces.append(self.workspace)
        if given_contacts and self.given is None:
            self.given = GivenContacts(self._data.nworld, self.max_contacts, self._device)

    def add_bodies(self, num_bodies: int) -> bool:
        """Allocate :attr:`bodies`; return whether they were not there before."""
        if self.bodies is not None:
            return False
        self.bodies = wp.empty((self._data.nworld, BODY_SIZE * num_bodies), dtype=float, device=self._device)
        return True

    def add_contact_forces(self) -> bool:
        """Allocate :attr:`contact_forces`; return whether they were not there before."""
        if self.contact_forces is not None:
            return False
        self.contact_forces = self._make_contact_forces()
        return True

    def enlarge(self) -> None:
        """Take other sizes of MuJoCo Warp's buffers."""
        self.workspace = self.given = None
        if self.fills_contacts:
            self.mark_contacts_filled()
        if self.contact_forces is not None:
            other = self._make_contact_forces()
            self.contact_forces.geoms, self.contact_forces.forces = other.geoms, other.forces

    def sort_given_contacts(self) -> None:
        """Take over what other collision detection has found."""
        assert self.given is not None, "the kernel finds all contacts"
        self.given.launch(self._data)
        if self.fills_contacts:
            self.mark_contacts_filled()

    def mark_contacts_filled(self) -> None:
        """Say that all places for contacts are in use: worlds have their own, empty ones have geoms of -1."""
        self._data.nacon.fill_(self._data.naconmax)

    def _make_contact_forces(self) -> ContactForces:
        shape = self._data.nworld, self._data.naconmax // self._data.nworld
        geoms = wp.full(shape, value=wp.vec2i(-1, -1), dtype=wp.vec2i, device=self._device)
        return ContactForces(geoms, wp.zeros(shape, dtype=wp.vec3, device=self._device))
