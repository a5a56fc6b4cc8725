"""One OpenCL context and queue per device, program builds, and buffers that share host memory where they can."""

from __future__ import annotations

import os
import re
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import pyopencl as cl
from numpy.typing import NDArray

from accel_shapegen import kernels

from ...errors import ArgumentError, BackendError, DeviceMemoryError, DtypeError, ShapeError
from .devices import memory_bytes

ALIGNMENT = 4096  # a page: some CPU drivers work in place only on memory that starts on one
_INCLUDE = re.compile(r'^#include "([\w.]+)"$', flags=re.MULTILINE)


class Runtime:
    """Context, in-order queue and program cache of one device; shared by all plans on it.

    Attributes
    ----------
    shares_host_memory : bool
        CPU devices work in place on host arrays; others get copies.
    lock : threading.RLock
        Held while kernels of one call are enqueued: kernel objects hold their arguments and plans their scratch, so
        two threads' calls must not interleave there. The queue is in order, so waiting happens outside.
    """

    def __init__(self, device: cl.Device) -> None:
        self.device = device
        self.context = cl.Context([device])
        self.queue = cl.CommandQueue(self.context)
        self.shares_host_memory = bool(device.type & cl.device_type.CPU)
        self.compute_units = int(device.max_compute_units)
        self.memory_bytes = memory_bytes(device, "cpu" if self.shares_host_memory else "gpu")
        self._programs: dict[tuple[Any, ...], dict[str, cl.Kernel]] = {}
        self.lock = threading.RLock()
        self._process = os.getpid()

    def kernels(
        self, name: str, dtype: np.dtype[Any], defines: Mapping[str, int] | None = None
    ) -> dict[str, cl.Kernel]:
        """The kernels of `kernels/opencl/<name>.cl` built for a real dtype and these `-D` options."""
        # Only CPU compilers are known to take under-aligned vector types; vload is right everywhere.
        defines = {"REAL_BITS": dtype.itemsize * 8, "USE_VLOAD": int(not self.shares_host_memory), **(defines or {})}
        if dtype == np.float64 and "cl_khr_fp64" not in self.device.extensions:
            raise BackendError(self.device.name, "has no float64", 'ask for dtype="complex64"')
        key = (name, *sorted(defines.items()))
        self.require_own_process()
        with self.lock:
            if key not in self._programs:
                self._programs[key] = self._build(name, defines)
            return self._programs[key]

    def _build(self, name: str, defines: Mapping[str, int]) -> dict[str, cl.Kernel]:
        options = [f"-D{key}={value}" for key, value in defines.items()] + ["-cl-std=CL1.2"]
        try:
            program = build_program(self.context, program_text(name), options)
        except cl.RuntimeError as error:
            raise BackendError(self.device.name, f"cannot build {name}.cl: {error}", "report this device") from error
        # Each kernel object is fetched once and kept: a second `program.name` makes another one.
        return {kernel.function_name: kernel for kernel in program.all_kernels()}

    def launch(
        self, kernel: cl.Kernel, size: tuple[int, ...], *arguments: Any, group: tuple[int, ...] | None = None
    ) -> None:
        """Enqueue a kernel over `size` work-items; integers among the arguments become 32-bit ones."""
        self.require_own_process()
        with self.lock:
            kernel.set_args(*(np.int32(a) if isinstance(a, int) else a for a in arguments))
            cl.enqueue_nd_range_kernel(self.queue, kernel, size, group)

    def require_own_process(self) -> None:
        """Refuse to work in a forked child: the driver's threads stayed in the parent, and a wait would never end."""
        if os.getpid() != self._process:
            raise BackendError(
                self.device.name,
                "was opened before this process was forked",
                'start workers by "spawn" or "forkserver", or touch OpenCL first in the worker',
            )

    def require(self, subject: str, nbytes: int, largest: int, remedy: str) -> None:
        """Refuse a plan that cannot fit before anything is allocated: `nbytes` in all, `largest` in one buffer."""
        available, single = self.memory_bytes, int(self.device.max_mem_alloc_size)
        if nbytes > available or largest > single:
            raise DeviceMemoryError(
                subject,
                f"needs {nbytes / 2**20:.0f} MiB, {largest / 2**20:.0f} MiB in one piece, on {self.device.name} "
                f"({available / 2**20:.0f} MiB, {single / 2**20:.0f} MiB)",
                remedy,
            )

    def constant(self, array: NDArray[Any]) -> cl.Buffer:
        """A device copy of a table that a plan owns."""
        flags = cl.mem_flags.READ_ONLY | cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, flags, hostbuf=np.ascontiguousarray(array))

    def scratch(self, nbytes: int) -> cl.Buffer:
        """Device memory that a plan keeps between calls."""
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size=max(nbytes, 1))

    def input(self, array: NDArray[Any]) -> cl.Buffer:
        """A buffer that holds a C-contiguous host array for kernels to read; keeps the array alive."""
        share = cl.mem_flags.USE_HOST_PTR if self.shares_host_memory else cl.mem_flags.COPY_HOST_PTR
        return cl.Buffer(self.context, cl.mem_flags.READ_ONLY | share, hostbuf=array)

    def output(self, array: NDArray[Any]) -> cl.Buffer:
        """A buffer for kernels to fill; `fetch` then makes `array` hold it."""
        if self.shares_host_memory:
            return cl.Buffer(self.context, cl.mem_flags.READ_WRITE | cl.mem_flags.USE_HOST_PTR, hostbuf=array)
        return cl.Buffer(self.context, cl.mem_flags.READ_WRITE, size=array.nbytes)

    def in_chunks(
        self, chunk: int, enqueue: Callable[..., None], sources: Sequence[NDArray[Any]], out: NDArray[Any]
    ) -> NDArray[Any]:
        """Fill `out`, `chunk` bodies at a time, by enqueue(part, *inputs, output); `part` is the slice of bodies."""
        self.require_own_process()
        with self.settled():
            starts = range(0, len(out), chunk)
            parts = [slice(start, min(start + chunk, len(out))) for start in starts]
            # In place, one wait at the end is enough; devices with memory of their own hold one chunk at a time.
            pending = [self._start(part, enqueue, sources, out[part]) for part in parts]
            for output, part in zip(pending, parts, strict=True):
                if output is not None:
                    self.fetch(output, out[part])
        return out

    def _start(
        self, part: slice, enqueue: Callable[..., None], sources: Sequence[NDArray[Any]], out: NDArray[Any]
    ) -> cl.Buffer | None:
        """Enqueue one chunk; its output, unless it is home already."""
        inputs, output = [self.input(source[part]) for source in sources], self.output(out)
        with self.lock:
            enqueue(part, *inputs, output)
        if self.shares_host_memory:
            return output
        self.fetch(output, out)
        return None

    @contextmanager
    def settled(self) -> Iterator[None]:
        """Leaves nothing running when an exception, such as a keyboard interrupt, ends the block.

        Kernels may be working in host arrays that are about to be freed.
        """
        try:
            yield
        except BaseException:
            self.queue.finish()
            raise

    def fetch(self, buffer: cl.Buffer, array: NDArray[Any]) -> None:
        """Wait for what was enqueued so far and bring an output home."""
        if self.shares_host_memory:
            mapped, _ = cl.enqueue_map_buffer(
                self.queue, buffer, cl.map_flags.READ, 0, array.shape, array.dtype, is_blocking=True
            )
            # Not `finish`: that would wait for other threads' calls too.
            mapped.base.release(self.queue).wait()
        else:
            cl.enqueue_copy(self.queue, array, buffer, is_blocking=True)


def program_text(name: str) -> str:
    """A kernel source with its own headers put in: PoCL refuses include paths that hold a space."""
    folder = kernels.include_dir("opencl")

    def header(match: re.Match[str]) -> str:
        return (folder / match.group(1)).read_text(encoding="utf-8")

    return _INCLUDE.sub(header, kernels.source(name, "opencl"))


def build_program(context: cl.Context, text: str, options: list[str]) -> cl.Program:
    """Compile; also where pyopencl itself lies in a folder with a space, whose include option PoCL refuses."""
    if not any(" " in option for option in cl._DEFAULT_INCLUDE_OPTIONS):
        return cl.Program(context, text).build(options=options)
    program = cl._cl._Program(context, text)
    program.build(" ".join(options).encode())
    return cl.Program(program)


def input_array(name: str, array: Any, dtype: np.dtype[Any], shape: tuple[int | None, ...]) -> NDArray[Any]:
    """A plan's input, checked against dtype and shape (None: any length); copied only if it is not contiguous."""
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        found = f"has dtype {array.dtype}" if isinstance(array, np.ndarray) else f"is a {type(array).__name__}"
        raise DtypeError(name, found, f"give a NumPy array of {dtype}")
    _require_shape(name, array, shape)
    # Kernels index packed rows of aligned elements.
    return np.require(array, requirements=["C", "A"])


def output_array(
    out: NDArray[Any] | None, dtype: np.dtype[Any], shape: tuple[int, ...], *inputs: NDArray[Any] | None
) -> NDArray[Any]:
    """The caller's `out`, checked, or a new page-aligned array; `inputs` must not overlap it."""
    if out is None:
        return aligned_empty(shape, dtype)
    if not isinstance(out, np.ndarray) or out.dtype != dtype:
        found = f"has dtype {out.dtype}" if isinstance(out, np.ndarray) else f"is a {type(out).__name__}"
        raise DtypeError("out", found, f"give a NumPy array of {dtype}")
    _require_shape("out", out, shape)
    if not (out.flags.c_contiguous and out.flags.aligned and out.flags.writeable):
        raise ShapeError("out", "is not a writeable, C-contiguous, aligned array", "give np.empty(shape, dtype)")
    if any(array is not None and np.may_share_memory(out, array) for array in inputs):
        raise ArgumentError("out", "overlaps an input in memory", "give an array of its own")
    return out


def require_bodies(name: str, count: int, batch: int) -> None:
    """Refuse an input whose number of bodies a plan for `batch` cannot take."""
    if not 1 <= count <= batch:
        raise ShapeError(name, f"holds {count} bodies", f"give 1 to {batch}, or plan a larger batch")


def _require_shape(name: str, array: NDArray[Any], shape: tuple[int | None, ...]) -> None:
    fits = array.ndim == len(shape) and all(
        want is None or have == want for have, want in zip(array.shape, shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("any" if want is None else str(want) for want in shape)
        raise ShapeError(name, f"has shape {array.shape}", f"give ({wanted})")


def aligned_empty(shape: tuple[int, ...], dtype: Any) -> NDArray[Any]:
    """An uninitialised C-contiguous array that starts on a page."""
    dtype = np.dtype(dtype)
    nbytes = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    raw = np.empty(nbytes + ALIGNMENT, dtype=np.uint8)
    start = -raw.ctypes.data % ALIGNMENT
    return raw[start : start + nbytes].view(dtype).reshape(shape)
