"""`devices`: what there is to compute on, what a call would get and why, and what is wrong with it."""

from __future__ import annotations

import os
from dataclasses import asdict
from typing import Any

from .. import backends
from ..backends.base import DeviceInfo
from ..backends.opencl.devices import cache_folder
from ..errors import ShapegenError
from . import output
from .options import AsJson, Debug

# Variables that decide what is found or chosen, and what each does.
VARIABLES = {
    "ACCEL_SHAPEGEN_BACKEND": "the backend to use, as --backend",
    "ACCEL_SHAPEGEN_DEVICE": "the device to use, as --device: a number, or a part of a name or version",
    "OCL_ICD_VENDORS": "folder of the OpenCL drivers to load instead of the system's; PoCL's wheel appears even so",
    "OCL_ICD_FILENAMES": "OpenCL drivers to load besides those",
    "POCL_CACHE_DIR": "PoCL's folder for compiled kernels; if it cannot be written, PoCL shows no device",
    "POCL_DEVICES": "PoCL's devices; cpu if not set",
    "POCL_MAX_PTHREAD_COUNT": "PoCL's threads; all cores if not set",
    "POCL_AFFINITY": "1 ties PoCL's threads to cores, which can slow NumPy's threads in the same process",
}
ORDER = "an OpenCL GPU, then an OpenCL CPU (an installed PoCL before the wheel's), then NumPy"


def devices(as_json: AsJson = False, debug: Debug = False) -> int:
    """List devices, what would be chosen and why, and what is wrong with what was found."""
    found = survey()
    if as_json:
        output.print_json(found)
    else:
        _show(found)
    errors = [choice["error"] for choice in found["chosen"].values() if choice["error"]]
    return 2 if errors else 0


def survey() -> dict[str, Any]:
    """Devices, the choice for each operation, the environment and remarks, ready for JSON."""
    infos = backends.available()
    listed = [_describe(info) for info in infos]
    return {
        "devices": listed,
        "order": ORDER,
        "chosen": {operation: _choice(operation, listed) for operation in backends.OPERATIONS},
        "environment": _environment(),
        "remarks": _remarks(infos),
    }


def _describe(info: DeviceInfo) -> dict[str, Any]:
    """A device, with the operations it has when it can be opened, and why it cannot among its problems."""
    described = {**asdict(info), "label": info.label, "operations": [], "problems": list(info.problems)}
    if info.usable:
        try:
            opened = backends.get(info.backend, device=info.index)
            described["operations"] = [name for name in backends.OPERATIONS if name in opened.operations]
        except ShapegenError as error:
            described |= {"usable": False, "problems": [*info.problems, str(error)]}
    return described


def _choice(operation: str, listed: list[dict[str, Any]]) -> dict[str, Any]:
    try:
        info = backends.get(operation=operation).info
    except ShapegenError as error:
        return {"backend": None, "index": None, "label": None, "why": "", "error": str(error)}
    able = [device for device in listed if device["usable"] and operation in device["operations"]]
    return {
        "backend": info.backend,
        "index": info.index,
        "label": info.label,
        "why": _reason(info, able),
        "error": None,
    }


def _reason(info: DeviceInfo, able: list[dict[str, Any]]) -> str:
    asked = {name: os.environ.get(name) for name in ("ACCEL_SHAPEGEN_BACKEND", "ACCEL_SHAPEGEN_DEVICE")}
    set_ones = " and ".join(f"{name}={value}" for name, value in asked.items() if value)
    if set_ones and (not asked["ACCEL_SHAPEGEN_BACKEND"] or asked["ACCEL_SHAPEGEN_BACKEND"] == info.backend):
        wanted = asked["ACCEL_SHAPEGEN_DEVICE"]
        if wanted is None or wanted == str(info.index) or wanted.lower() in f"{info.platform} {info.label}".lower():
            return f"asked for by {set_ones}"
    lacking = f"what {set_ones} asks for lacks it; " if set_ones else ""
    if len(able) == 1:
        return lacking + "the only device that has it"
    return lacking + f"preference {info.preference}, the highest of the {len(able)} that have it"


def _environment() -> dict[str, str | None]:
    others = sorted(
        name for name in os.environ if name.startswith(("POCL_", "ACCEL_SHAPEGEN_")) and name not in VARIABLES
    )
    return {name: os.environ.get(name) for name in (*VARIABLES, *others)}


def _remarks(infos: list[DeviceInfo]) -> list[str]:
    """Traps that no single device knows of."""
    if not any("PoCL" in info.version for info in infos):
        return []
    return [
        f"should a run abort without a message, delete PoCL's kernel cache {cache_folder()}: a damaged one does that, "
        "and many first runs at once have damaged it"
    ]


def _show(found: dict[str, Any]) -> None:
    screen = output.console()
    rows = [
        [
            _number(device),
            f"{device['name']}{'' if device['usable'] else ' (not usable)'}\n{device['platform']}",
            device["version"],
            device["kind"],
            f"{device['memory_bytes'] / 2**30:.1f} GiB" if device["memory_bytes"] else "–",
            str(device["compute_units"] or "–"),
            str(device["preference"]),
        ]
        for device in found["devices"]
    ]
    columns = ["", "device, platform", "version", "kind", "memory", "units", "preference"]
    screen.print(output.table("Devices", columns, rows, numbers=3))
    choices = [_choice_row(operation, choice, found["devices"]) for operation, choice in found["chosen"].items()]
    screen.print(output.table("Chosen", ["operation", "had by", "chosen", "why"], choices))
    screen.print(f"By default: {found['order']}.\n", markup=False)
    variables = [[name, value or "not set", VARIABLES.get(name, "")] for name, value in found["environment"].items()]
    screen.print(output.table("Environment", ["variable", "value", "what it does"], variables))
    for remark in _problems(found["devices"]) + found["remarks"]:
        screen.print(f"! {remark}", markup=False)


def _problems(listed: list[dict[str, Any]]) -> list[str]:
    """Each problem once, after the devices that have it."""
    having: dict[str, list[dict[str, Any]]] = {}
    for device in listed:
        for problem in device["problems"]:
            having.setdefault(problem, []).append(device)
    return [f"{_numbers(devices)}: {problem}" for problem, devices in having.items()]


def _choice_row(operation: str, choice: dict[str, Any], listed: list[dict[str, Any]]) -> list[str]:
    able = _numbers([device for device in listed if operation in device["operations"]])
    chosen = "none" if choice["error"] else _number(choice)
    return [operation, able or "–", chosen, choice["error"] or choice["why"]]


def _number(device: dict[str, Any]) -> str:
    return f"{device['backend']} {device['index']}"


def _numbers(listed: list[dict[str, Any]]) -> str:
    """Briefly, as in `opencl 0 1, reference 0`."""
    indices: dict[str, list[str]] = {}
    for device in listed:
        indices.setdefault(device["backend"], []).append(str(device["index"]))
    return ", ".join(f"{backend} {' '.join(numbers)}" for backend, numbers in indices.items())
