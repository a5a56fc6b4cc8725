"""This package's own contenders: every OpenCL device, and the reference where it is quick enough to take part."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from accel_shapegen import backends
from accel_shapegen.backends.base import Backend, DeviceInfo

from ..contest import Contender, Run, Settings, Skipped
from ..machine import opencl_devices

# The reference sums item by item in float64: beyond this many grid cells or nodes it would only take time.
REFERENCE_SIZE = 32**3

Prepare = Callable[[Backend], Run]


def contenders(
    case: str, settings: Settings, prepare: Prepare, items: int, size: int, eps: float | None = None
) -> tuple[list[Contender], list[Skipped]]:
    """One contender per device, the reference last, and what was left out; `size` is what one item has the most of."""
    found: list[Contender] = []
    skipped: list[Skipped] = []
    devices = opencl_devices(settings.devices)
    for info in devices:
        chosen = partial(_prepare_on, prepare, info)
        found.append(Contender(info.label, {"public API": chosen}, items, eps))
    if not devices:
        problems = [p for info in backends.available() if info.backend == "opencl" for p in info.problems]
        reason = f"no usable device matches {settings.devices}" if settings.devices else "no usable device"
        skipped.append(Skipped(case, "opencl", "; ".join([reason, *problems])))
    if size <= REFERENCE_SIZE:
        found.append(Contender("reference", {"public API": lambda: prepare(reference())}, items))
    else:
        reason = f"sums plainly in float64: takes part up to {REFERENCE_SIZE} cells or nodes, these are {size}"
        skipped.append(Skipped(case, "reference", reason))
    return found, skipped


def reference() -> Backend:
    """The float64 oracle, whatever device the environment asks for."""
    return backends.get("reference", device=0)


def _prepare_on(prepare: Prepare, info: DeviceInfo) -> Run:
    return prepare(backends.get("opencl", device=info.index))
