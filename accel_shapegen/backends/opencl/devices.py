"""Which OpenCL devices there are, what is wrong with them, and which one is best.

Drivers fail quietly: PoCL with an unusable cache folder reports no devices and no error, a driver without its
hardware stays in the list of platforms, two PoCLs answer under one name. Each of these becomes a line in
`DeviceInfo.problems` that says what would mend it.
"""

from __future__ import annotations

import os
import re
import shutil
import tempfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from ...errors import BackendError
from ..base import DeviceInfo

GPU_PREFERENCE = 200
CPU_PREFERENCE = 100


def find() -> list[tuple[Any, DeviceInfo]]:
    """All OpenCL devices with their reports, in the driver's order; then platforms without one (device None).

    Raises
    ------
    BackendError
        pyopencl is missing, there is no platform at all, or asking would abort the process; says which environment
        variable or package is at fault.
    """
    try:
        import pyopencl as cl
    except ImportError as error:
        raise BackendError("pyopencl", f"cannot be imported ({error})", "pip install pyopencl") from error
    if os.environ.get("POCL_CACHE_DIR") == "":
        # Before any driver is asked: one PoCL then hides its devices, another aborts the process.
        raise BackendError("POCL_CACHE_DIR", "is set but empty, so PoCL has nowhere to keep kernels", "unset it")
    try:
        platforms = cl.get_platforms()
    except cl.Error as error:
        raise BackendError("OpenCL", f"has no platform ({error})", _advice_without_platform()) from error
    found: list[tuple[Any, dict[str, Any]]] = []
    empty: list[tuple[Any, dict[str, Any]]] = []
    for platform in platforms:
        try:
            devices, reason = platform.get_devices(), ""
        except cl.Error as error:  # CL_DEVICE_NOT_FOUND is how an installed driver without its hardware answers
            devices, reason = [], f" ({error})"
        found += [(device, _report(cl, platform, device)) for device in devices]
        if not devices:
            empty.append((None, _report_empty(platform, reason)))
    _tell_apart([report for _, report in found])
    return [(device, DeviceInfo(index=index, **report)) for index, (device, report) in enumerate(found + empty)]


def _report(cl: Any, platform: Any, device: Any) -> dict[str, Any]:
    kinds = {cl.device_type.GPU: "gpu", cl.device_type.CPU: "cpu"}
    kind = next((name for bit, name in kinds.items() if device.type & bit), "accelerator")
    pocl = _pocl_version(platform.version)
    usable = bool(device.available and device.compiler_available)
    problems = [] if usable else ["the driver says that the device or its compiler is not available"]
    if "cl_khr_fp64" not in device.extensions:
        problems.append("no float64 (cl_khr_fp64): complex128 requests are refused")
    preference = GPU_PREFERENCE if kind == "gpu" else CPU_PREFERENCE
    if pocl is not None:
        cache = cache_problem()
        usable = usable and cache is None
        problems += _pocl_problems(pocl, int(device.max_compute_units)) + ([cache] if cache else [])
        # An installed PoCL is the administrator's choice and usually newer than the one inside the wheel.
        preference -= 10 * _is_embedded(pocl)
    if os.environ.get("OCL_ICD_VENDORS"):
        problems.append(f"OCL_ICD_VENDORS={os.environ['OCL_ICD_VENDORS']}: drivers outside it are not seen")
    return {
        "backend": "opencl",
        "name": device.name.strip(),
        "kind": kind,
        "platform": platform.name.strip(),
        "version": f"PoCL {pocl}" if pocl else f"{platform.version.strip()}, driver {device.driver_version.strip()}",
        "memory_bytes": memory_bytes(device, kind),
        "compute_units": int(device.max_compute_units),
        "usable": usable,
        "preference": preference,
        "problems": tuple(problems),
    }


def memory_bytes(device: Any, kind: str) -> int:
    """What the device has [byte]; on a CPU the machine's memory, of which drivers have been seen to report a part."""
    reported = int(device.global_mem_size)
    if kind != "cpu" or not hasattr(os, "sysconf"):
        return reported
    return max(reported, os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def _report_empty(platform: Any, reason: str) -> dict[str, Any]:
    pocl = _pocl_version(platform.version)
    problem = f"the platform has no device{reason}"
    if pocl is not None:
        problem += f"; {cache_problem() or _pocl_device_advice()}"
    return {
        "backend": "opencl",
        "name": "no device",
        "kind": "none",
        "platform": platform.name.strip(),
        "version": f"PoCL {pocl}" if pocl else platform.version.strip(),
        "usable": False,
        "preference": -1,
        "problems": (problem,),
    }


def _tell_apart(reports: list[dict[str, Any]]) -> None:
    """Add a line where several devices answer under one platform name, as an installed and an embedded PoCL do."""
    for report in reports:
        namesakes = sorted({r["version"] for r in reports if r["platform"] == report["platform"]})
        if len(namesakes) > 1:
            report["problems"] += (
                f"{' and '.join(namesakes)} share the platform name {report['platform']!r}: "
                f"choose by version, ACCEL_SHAPEGEN_DEVICE={report['version']!r}",
            )


def _pocl_version(platform_version: str) -> str | None:
    """Two PoCLs carry the same platform name; only the version tells them apart."""
    found = re.search(r"PoCL (\S+)", platform_version, flags=re.IGNORECASE)
    return found.group(1) if found else None


def _is_embedded(pocl: str) -> bool:
    try:
        embedded = version("pocl-binary-distribution")
    except PackageNotFoundError:
        return False
    return pocl == embedded or pocl.startswith(embedded + "-")


def _pocl_problems(pocl: str, compute_units: int) -> list[str]:
    problems = []
    if _is_embedded(pocl):
        problems.append("the PoCL inside the pocl-binary-distribution wheel; an installed PoCL would be preferred")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if compute_units < cores:
        problems.append(f"uses {compute_units} of {cores} cores: see POCL_MAX_PTHREAD_COUNT and POCL_DEVICES")
    if os.environ.get("POCL_AFFINITY") == "1":
        problems.append("POCL_AFFINITY=1 pins PoCL's threads; it has slowed NumPy's threads in the same process")
    return problems


def _pocl_device_advice() -> str:
    if "POCL_DEVICES" in os.environ:
        return f"POCL_DEVICES={os.environ['POCL_DEVICES']!r} names none: unset it"
    return "run with POCL_DEBUG=all to see why"


def cache_folder() -> Path:
    """The folder in which PoCL keeps compiled kernels, by its own rules."""
    if os.environ.get("POCL_CACHE_DIR"):
        return Path(os.environ["POCL_CACHE_DIR"])
    if os.environ.get("XDG_CACHE_HOME"):
        return Path(os.environ["XDG_CACHE_HOME"]) / "pocl" / "kcache"
    if os.environ.get("HOME"):
        return Path(os.environ["HOME"]) / ".cache" / "pocl" / "kcache"
    return Path(tempfile.gettempdir()) / "pocl" / "kcache"


# All kernels of all plans of a session, compiled, take a few MiB.
CACHE_BYTES = 32 * 2**20


def cache_problem() -> str | None:
    """What is wrong with that folder and what would do; None when files can be made in it."""
    folder = cache_folder()
    try:
        # PoCL makes the folder itself; permission bits say little (root, read-only mounts), so try.
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            free = shutil.disk_usage(folder).free
        if free < CACHE_BYTES:
            return (
                f"PoCL keeps kernels in {folder}, where {free / 2**20:.0f} MiB are free, and aborts when it runs out: "
                "free some, or set POCL_CACHE_DIR to another folder"
            )
        return None
    except OSError as error:
        return (
            f"PoCL cannot keep kernels in {folder} ({error.strerror or error}), and then hides its devices or fails to "
            "build: set POCL_CACHE_DIR to a folder that can be written"
        )


def _advice_without_platform() -> str:
    vendors = os.environ.get("OCL_ICD_VENDORS")
    if vendors and not os.path.isdir(vendors):
        return f"OCL_ICD_VENDORS={vendors} is not a folder, which hides every driver: unset it"
    if vendors:
        return f"OCL_ICD_VENDORS={vendors} hides drivers outside it: unset it"
    return 'install a driver, or PoCL from PyPI: pip install "accel-shapegen[pocl]"'
