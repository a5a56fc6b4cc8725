"""The registry: which backends and devices there are, and which one a call gets.

`backend=None` takes the best usable device that has the operation: an OpenCL GPU, an OpenCL CPU, then NumPy.
`ACCEL_SHAPEGEN_BACKEND` and `ACCEL_SHAPEGEN_DEVICE` (a number, or part of a device's label) override that, but for
operations that the device named there lacks: polygons are transformed by the reference. A backend asked for by name
in a call and missing is an error, never a silent fallback.
"""

from __future__ import annotations

import importlib
import os
from functools import cache
from importlib.metadata import EntryPoint, entry_points

from ..errors import ArgumentError, BackendError
from .base import Backend, DeviceInfo

GROUP = "accel_shapegen.backends"
OPERATIONS = (
    "tensor_transform",
    "scattered_transform",
    "mesh_spread",
    "spline_contract",
    "polygon_transform",
    "mesh_transform",
)
# Known even where the package is not installed and so has no entry points.
_OWN = {
    name: EntryPoint(name, value, GROUP)
    for name, value in (
        ("opencl", "accel_shapegen.backends.opencl:OpenCLBackend"),
        ("reference", "accel_shapegen.backends.reference:ReferenceBackend"),
    )
}
_INSTALL = {"opencl": 'pip install "accel-shapegen[pocl]"'}


@cache
def _registered() -> dict[str, EntryPoint]:
    found = dict(_OWN)
    for point in entry_points(group=GROUP):
        found.setdefault(point.name, point)
    return found


@cache
def _load(name: str) -> type[Backend]:
    registered = _registered()
    if name not in registered:
        raise BackendError("backend", f"{name!r} is not registered", "there are " + ", ".join(sorted(registered)))
    module, _, attribute = registered[name].value.partition(":")
    try:
        loaded: type[Backend] = getattr(importlib.import_module(module), attribute)
    except ImportError as error:
        raise BackendError("backend", f"{name!r} cannot be imported ({error})", _hint(name)) from error
    return loaded


@cache
def _probe(name: str) -> tuple[DeviceInfo, ...]:
    return tuple(_load(name).probe())


@cache
def _instance(info: DeviceInfo) -> Backend:
    return _load(info.backend)(info)


def _hint(name: str) -> str:
    command = _INSTALL.get(name)
    others = [other for other in sorted(_registered()) if other != name]
    return (f"run {command}, or " if command else "") + "use one of " + ", ".join(others)


def available() -> list[DeviceInfo]:
    """Every device that every registered backend found, best first; unusable ones and their problems included."""
    devices: list[DeviceInfo] = []
    for name in _registered():
        try:
            devices += _probe(name)
        except BackendError as error:
            devices.append(
                DeviceInfo(
                    name, 0, "none", "none", usable=False, preference=-1, problems=(f"{error.problem}; {error.remedy}",)
                )
            )
    return sorted(devices, key=lambda info: (not info.usable, -info.preference))


def get(name: str | Backend | None = None, *, operation: str | None = None, device: int | str | None = None) -> Backend:
    """The backend that a call with these wishes gets, bound to its device.

    Parameters
    ----------
    name : str or Backend, optional
        A registered name; None lets `ACCEL_SHAPEGEN_BACKEND`, then the devices' order of preference, decide.
        A backend object is returned as it is.
    operation : str, optional
        The operation it must have, one of `OPERATIONS`.
    device : int or str, optional
        Index among the backend's devices, or a part of a device's label, case ignored; None lets
        `ACCEL_SHAPEGEN_DEVICE`, then preference, decide.

    Raises
    ------
    BackendError
        Naming what is there and the install command, when nothing fits.
    """
    if operation is not None and operation not in OPERATIONS:
        raise ArgumentError("operation", f"is {operation!r}", "give one of " + ", ".join(OPERATIONS))
    if device is not None and (isinstance(device, bool) or not isinstance(device, (int, str))):
        raise ArgumentError("device", f"is {device!r}", "give an index, or a part of a device's label")
    if name is not None and not isinstance(name, str):
        if isinstance(name, type) or not isinstance(name, Backend):
            raise ArgumentError("backend", f"is a {type(name).__name__}", "give a registered name or a Backend")
        return _with_operation(name, operation)
    named = name or os.environ.get("ACCEL_SHAPEGEN_BACKEND") or None
    if not name and named is not None and named not in _registered():
        there = "there are " + ", ".join(sorted(_registered()))
        raise BackendError("ACCEL_SHAPEGEN_BACKEND", f"{named!r} is not registered", f"{there}; correct or unset it")
    wanted = device if device is not None else os.environ.get("ACCEL_SHAPEGEN_DEVICE") or None
    if named is None and wanted is None:
        return _instance(_best(operation))
    pool = list(_probe(named)) if named is not None else available()
    chosen = _match(pool, wanted, named)
    # The environment's device is a wish for all calls: where the operation is missing it gives way. An explicit one
    # does not.
    if name is None and device is None and operation is not None and operation not in _load(chosen.backend).operations:
        return _instance(_best(operation))
    return _with_operation(_instance(chosen), operation)


def _best(operation: str | None) -> DeviceInfo:
    for info in available():
        if info.usable and (operation is None or operation in _load(info.backend).operations):
            return info
    raise BackendError("backend", f"no usable device has {operation}", "see accel-shapegen devices")


def _match(pool: list[DeviceInfo], wanted: int | str | None, named: str | None) -> DeviceInfo:
    subject = "device" if wanted is not None else "backend"
    usable = sorted((info for info in pool if info.usable), key=lambda info: -info.preference)
    if not usable:
        problems = "; ".join(problem for info in pool for problem in info.problems) or "no device was found"
        raise BackendError(subject, f"{named!r} has no usable device: {problems}", _hint(named or ""))
    if wanted is None:
        return usable[0]
    if isinstance(wanted, int) or wanted.isdecimal():
        matching = [info for info in usable if info.index == int(wanted)]
    else:
        matching = [info for info in usable if wanted.lower() in f"{info.platform} {info.label}".lower()]
    if not matching:
        there = ", ".join(f"{info.index} = {info.label}" for info in usable)
        raise BackendError("device", f"{wanted!r} matches none", f"there are {there}")
    return matching[0]


def _with_operation(backend: Backend, operation: str | None) -> Backend:
    if operation is not None and operation not in backend.operations:
        raise BackendError(
            "backend", f"{backend.name!r} has no {operation}", "it has " + ", ".join(sorted(backend.operations))
        )
    return backend
