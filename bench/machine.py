"""What the figures were measured on."""

from __future__ import annotations

import importlib
import os
import platform
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

from accel_shapegen import backends
from accel_shapegen.backends.base import DeviceInfo

LIBRARIES = ("numpy", "scipy", "finufft", "pyopencl", "accel_shapegen")


def thread_count() -> int:
    """CPUs that this process may run on: what every contender gets."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def thread_pool() -> ThreadPoolExecutor:
    """One pool of that many threads for whatever here runs in threads of Python."""
    return ThreadPoolExecutor(thread_count())


def describe(devices: list[DeviceInfo]) -> dict[str, Any]:
    """CPU, threads, versions and devices, ready for JSON."""
    return {
        "cpu": cpu_model(),
        "threads": thread_count(),
        "load_average": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": {name: _version(name) for name in LIBRARIES},
        "blas": _blas(),
        "devices": [
            {"label": info.label, "platform": info.platform, "driver": info.version, "units": info.compute_units}
            for info in devices
        ],
    }


def cpu_model() -> str:
    """The processor's name; Python's own answer is often empty on Linux."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def opencl_devices(wanted: tuple[str, ...]) -> list[DeviceInfo]:
    """Usable OpenCL devices; with `wanted`, those whose number or part of whose label is in it."""
    found = [info for info in backends.available() if info.backend == "opencl" and info.usable]
    if not wanted:
        return found
    return [info for info in found if any(_matches(info, text) for text in wanted)]


def _matches(info: DeviceInfo, text: str) -> bool:
    return info.index == int(text) if text.isdigit() else text.lower() in f"{info.platform} {info.label}".lower()


def _version(name: str) -> str | None:
    try:
        return str(importlib.import_module(name).__version__)
    except ImportError:
        return None


def _blas() -> list[str] | None:
    try:
        from threadpoolctl import threadpool_info  # type: ignore[import-untyped]
    except ImportError:
        return None
    return [f"{p['internal_api']} {p['version']}, {p['num_threads']} threads" for p in threadpool_info()]
