# SPDX-License-Identifier: Apache-2.0
"""Memory of a chain: values of its operations by their addresses, and which of them must be written in the end.

Each address that a row reads or writes is a *cell*. A cell that has been written, or read once, has a value in a
register. So views and writes in place need no rules of their own: operations run in their order on the cells.

Threads run side by side, without waiting for each other. So where a chain writes to a piece of memory, no two threads
may touch the same address of it. That is checked for each operation; one that would break it begins the next chain.
"""

from __future__ import annotations

import itertools
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import torch
from torch.multiprocessing.reductions import StorageWeakRef

from .rows import Unsupported, View
from .source import C_TYPES, Source, Value

__all__ = ["Access", "Hazard", "Indexed", "Memory", "Region", "Store"]


class Hazard(Exception):
    """An operation cannot be part of a chain with the operations before it."""


@dataclass(frozen=True)
class Access:
    """Elements of a tensor that an operation reads or writes, in each row."""

    tensor: torch.Tensor
    view: View
    writes: bool = False


@dataclass(frozen=True)
class Indexed:
    """Elements of a tensor whose places depend on indices that a row has read.

    Attributes:
        access: The elements for indices of zero.
        steps: For each indexed dimension the number of its indices among the inputs, the bytes from one index to the
            next, and the size, which counts negative indices from the end.
    """

    access: Access
    steps: tuple[tuple[int, int, int], ...]


@dataclass(frozen=True)
class Store:
    """A value that is written at the end of a chain."""

    place: str
    value: Value
    first_row_only: bool


@dataclass(eq=False)
class Region:
    """Memory of one storage, or of several that overlap.

    Attributes:
        number: Number of the region in its chain.
        start: Address of the first byte.
        end: Address after the last one.
        origin: Address that offsets in the source code count from.
        weak: Of a storage that the chain has made: expires when nobody refers to it.
        storages: Storages that are kept alive until the chain has been launched.
        touched: Addresses of row 0 that are read from memory or written, by the distance between rows.
        dirty: Cells that have been written.
        values: Values of cells by pitch and address.
        dtypes: Types that its memory is read and written as.
        gathered: Whether elements are read whose places depend on indices.
        scattered: Elements that are written at such places: the place and the value.
        scatters: Addresses for indices of zero, by the indices.
    """

    number: int
    start: int
    end: int
    origin: int
    weak: StorageWeakRef | None = None
    storages: list[torch.UntypedStorage] = field(default_factory=list)
    touched: dict[int, set[int]] = field(default_factory=lambda: defaultdict(set))
    dirty: dict[tuple[int, int], None] = field(default_factory=dict)
    values: dict[tuple[int, int], Value] = field(default_factory=dict)
    dtypes: set[torch.dtype] = field(default_factory=set)
    gathered: bool = False
    scattered: list[tuple[str, Value]] = field(default_factory=list)
    scatters: dict[tuple[object, ...], set[int]] = field(default_factory=dict)

    def alive(self) -> list[torch.UntypedStorage]:
        """Its storages, none if nobody refers to the tensor that the chain has made."""
        if self.weak is None:
            return self.storages
        storage = torch.UntypedStorage._new_with_weak_ptr(self.weak.cdata)
        return [storage] if storage is not None else []


class Memory:
    """All memory that a chain reads and writes."""

    def __init__(self, source: Source):
        self._source = source
        self._made: dict[int, Region] = {}
        self._regions: list[Region] = []
        self._pointers: dict[tuple[int, int], str] = {}

    # -- regions

    @property
    def size(self) -> int:
        """Number of regions."""
        return len(self._regions)

    def add_made(self, tensor: torch.Tensor) -> None:
        """Note a tensor that an operation of the chain has made."""
        storage = tensor.untyped_storage()
        start = storage.data_ptr()
        region = Region(len(self._regions), start, start + storage.nbytes(), start, StorageWeakRef(storage))
        self._regions.append(region)
        self._made[storage._cdata] = region

    def region_of(self, tensor: torch.Tensor) -> Region | None:
        """The region that a tensor lies in; None if the chain has not met it."""
        storage = tensor.untyped_storage()
        made = self._made.get(storage._cdata)
        if made is not None:
            return made
        start, end = storage.data_ptr(), storage.data_ptr() + storage.nbytes()
        found = [r for r in self._regions if r.weak is None and r.start < end and start < r.end]
        if len(found) > 1:
            raise Hazard("a tensor overlaps several others")
        return found[0] if found else None

    def _meet(self, tensor: torch.Tensor) -> Region:
        """The region that a tensor lies in, which is new if the chain has not met it."""
        storage, region = tensor.untyped_storage(), self.region_of(tensor)
        start, end = storage.data_ptr(), storage.data_ptr() + storage.nbytes()
        if region is None:
            region = Region(len(self._regions), start, end, start)
            self._regions.append(region)
        if region.weak is None:
            region.start, region.end = min(region.start, start), max(region.end, end)
            if all(s._cdata != storage._cdata for s in region.storages):
                # Kept, as torch would give its memory to tensors that the chain makes and that threads write.
                region.storages.append(storage)
        return region

    # -- hazards

    def admit(self, accesses: Iterable[Access], rows: int) -> None:
        """Check that an operation can be part of the chain.

        Raises:
            Hazard: if threads would read what others write, so that the operation must begin the next chain.
            Unsupported: if they would do so within the operation, so that no chain can hold it.
        """
        by_region: dict[int, tuple[Region, list[Access]]] = {}
        for access in accesses:
            if access.tensor.dtype not in C_TYPES:
                raise Unsupported(f"is of type {access.tensor.dtype}")
            region = self.region_of(access.tensor)
            if region is None:
                storage = access.tensor.untyped_storage()
                region = Region(-1, storage.data_ptr(), storage.data_ptr() + storage.nbytes(), 0)
                overlapping = [
                    r for r, _ in by_region.values() if r.weak is None and r.start < region.end and region.start < r.end
                ]
                region = overlapping[0] if overlapping else region
            by_region.setdefault(id(region), (region, []))[1].append(access)
        for region, own in by_region.values():
            self._admit(region, own, rows)

    def _admit(self, region: Region, accesses: Sequence[Access], rows: int) -> None:
        if region.scattered:
            raise Hazard("memory is written by indices")
        writes = bool(region.dirty) or any(a.writes for a in accesses)
        if not writes:
            return
        touched: dict[int, set[int]] = defaultdict(set)
        for access in accesses:
            touched[access.view.pitch].update(address for _, address in _places(access))
            if access.writes and access.view.pitch == 0 and region.weak is None:
                raise Unsupported("writes one place from all rows")
        item = {a.tensor.dtype for a in accesses}
        if len(item) > 1:
            raise Unsupported("reads memory as two types")
        if any(a.writes for a in accesses):
            _check_apart(touched, rows, accesses[0].tensor.element_size(), Unsupported)
        for pitch, places in region.touched.items():
            touched[pitch] |= places
        if region.gathered or len(region.dtypes | item) > 1:
            raise Hazard("memory is read in another way")
        _check_apart(touched, rows, accesses[0].tensor.element_size(), Hazard)

    # -- cells

    def read(self, access: Access) -> list[Value]:
        """Values of the elements that an operation reads."""
        region = self._meet(access.tensor)
        dtype = access.tensor.dtype
        region.dtypes.add(dtype)
        found = []
        for pitch, address in _places(access):
            region.touched[pitch].add(address)
            value = region.values.get((pitch, address))
            if value is None or value.dtype != dtype:
                value = self._load(region, pitch, address, dtype)
                region.values[pitch, address] = value
            found.append(value)
        return found

    def write(self, access: Access, values: Sequence[Value]) -> None:
        """Set the elements that an operation writes."""
        region = self._meet(access.tensor)
        region.dtypes.add(access.tensor.dtype)
        for (pitch, address), value in zip(_places(access), values, strict=True):
            region.touched[pitch].add(address)
            region.values[pitch, address] = self._source.cast(value, access.tensor.dtype)
            region.dirty[pitch, address] = None

    # -- elements whose places depend on indices

    def admit_gather(self, indexed: Indexed) -> None:
        """Check that elements can be read by indices: the chain must not write to their memory.

        Raises:
            Hazard: if it does.
        """
        region = self.region_of(indexed.access.tensor)
        if region is not None and (region.dirty or region.scattered or region.weak is not None):
            raise Hazard("memory is read by indices")

    def admit_scatter(self, indexed: Indexed, inputs: Sequence[Access], indices: Sequence[Sequence[Value]]) -> None:
        """Check that elements can be written by indices: the chain must not use their memory otherwise.

        Raises:
            Hazard: if it does.
            Unsupported: if the operation itself does.
        """
        access = indexed.access
        region = self.region_of(access.tensor)
        storage = access.tensor.untyped_storage()
        start, end = storage.data_ptr(), storage.data_ptr() + storage.nbytes()
        for other in inputs:
            memory = other.tensor.untyped_storage()
            if memory.data_ptr() < end and start < memory.data_ptr() + memory.nbytes():
                raise Unsupported("reads what it writes by indices")
        if region is None:
            return
        if region.touched or region.gathered or region.weak is not None:
            raise Hazard("memory is written by indices")
        places = {address for _, address in _places(access)}
        known = region.scatters.get(_scatter_key(indexed, indices))
        together = places | (known or set())
        reach = max(together) - min(together) + access.tensor.element_size()
        strides = [stride for _, stride, _ in indexed.steps] + [access.view.pitch] * (access.view.pitch > 0)
        if known is None or known & places or reach > min(strides) or access.tensor.dtype not in region.dtypes:
            raise Hazard("memory is written by other indices")

    def gather(self, indexed: Indexed, indices: Sequence[Sequence[Value]]) -> list[Value]:
        """Values of elements that are read by indices.

        Args:
            indexed: The elements.
            indices: Values of the inputs of the operation.
        """
        access = indexed.access
        region = self._meet(access.tensor)
        region.gathered = True
        dtype = access.tensor.dtype
        return [
            self._load(region, pitch, address, dtype, self._offset(indexed, indices, number))
            for number, (pitch, address) in enumerate(_places(access))
        ]

    def scatter(self, indexed: Indexed, indices: Sequence[Sequence[Value]], values: Sequence[Value]) -> None:
        """Write elements by indices, at the end of the chain; arguments as for :meth:`gather`."""
        access = indexed.access
        region = self._meet(access.tensor)
        dtype = access.tensor.dtype
        region.dtypes.add(dtype)
        places = region.scatters.setdefault(_scatter_key(indexed, indices), set())
        for number, (pitch, address) in enumerate(_places(access)):
            offset = self._offset(indexed, indices, number)
            place = self._place(region, pitch, address, C_TYPES[dtype], offset)
            region.scattered.append((place, self._source.cast(values[number], dtype)))
            places.add(address)

    def _offset(self, indexed: Indexed, indices: Sequence[Sequence[Value]], number: int) -> str:
        """Bytes from the element for indices of zero to that for the indices that a row has read."""
        terms = []
        for source, stride, size in indexed.steps:
            index = self._source.cast(indices[source][number], torch.int64)
            wrapped = self._source.let(torch.int64, f"{index} < 0 ? {index} + {size}ll : {index}")
            terms.append(f" + {wrapped} * {stride}ll")
        return "".join(terms)

    def _load(self, region: Region, pitch: int, address: int, dtype: torch.dtype, offset: str = "") -> Value:
        if region.weak is not None:  # no operation of a chain leaves a part of what it makes without value
            raise Hazard("a tensor is read before it is written")
        if dtype == torch.bool:  # a byte that is neither 0 nor 1 is no bool to a compiler
            place = self._place(region, pitch, address, "const unsigned char", offset)
            return self._source.let(dtype, f"{place} != 0")
        return self._source.let(dtype, self._place(region, pitch, address, f"const {C_TYPES[dtype]}", offset))

    def _place(self, region: Region, pitch: int, address: int, c_type: str, offset: str = "") -> str:
        key = region.number, pitch
        name = self._pointers.setdefault(key, f"r{len(self._pointers)}")
        return f"*reinterpret_cast<{c_type}*>({name} + {address - region.origin}{offset})"

    # -- the end of a chain

    def stores(self) -> list[Store]:
        """Writes to memory that is read after the chain."""
        found = []
        for region in self._regions:
            if not region.dirty or not region.alive():
                continue
            for pitch, address in region.dirty:
                value = region.values[pitch, address]
                found.append(Store(self._place(region, pitch, address, C_TYPES[value.dtype]), value, pitch == 0))
        return found + [Store(place, value, False) for r in self._regions for place, value in r.scattered]

    def pointers(self) -> list[tuple[str, Region, int]]:
        """Name, region and pitch of each pointer to a row."""
        return [(name, self._regions[number], pitch) for (number, pitch), name in self._pointers.items()]

    def regions_of(self, tensors: Iterable[torch.Tensor]) -> list[Region]:
        """Regions of the chain that tensors lie in."""
        found = [self.region_of(t) for t in tensors if t.numel()]
        return [region for region in found if region is not None]


def _scatter_key(indexed: Indexed, indices: Sequence[Sequence[Value]]) -> tuple[object, ...]:
    """Key of the indices by which an operation writes: the same for two that write by the same ones."""
    used = [tuple(str(v) for v in dict.fromkeys(indices[source])) for source, _, _ in indexed.steps]
    return (indexed.access.view.pitch, *used, *(stride for _, stride, _ in indexed.steps))


def _places(access: Access) -> Iterator[tuple[int, int]]:
    """Pitch and address of each element of row 0."""
    base = access.tensor.untyped_storage().data_ptr()
    for offset in access.view.offsets:
        yield access.view.pitch, base + offset


def _check_apart(touched: dict[int, set[int]], rows: int, item: int, error: type[Exception]) -> None:
    """Check that no two rows share an address, given the addresses of row 0 by their distance from row to row."""
    if len([pitch for pitch, places in touched.items() if places]) > 1:
        raise error("rows of one memory are read and written at two distances")
    for pitch, places in touched.items():
        if pitch == 0:
            continue
        if pitch % item:
            raise error("rows lie askew")
        by_rest: dict[int, list[int]] = defaultdict(list)
        for place in places:
            by_rest[place % pitch].append(place)
        for same in by_rest.values():
            same.sort()
            if any(b - a < pitch * rows for a, b in itertools.pairwise(same)):
                raise error("rows overlap")
