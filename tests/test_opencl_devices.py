"""What the OpenCL backend finds, and what it says about drivers that fail quietly."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyopencl as cl
import pytest

from accel_shapegen import backends
from accel_shapegen.backends.base import Backend, DeviceInfo
from accel_shapegen.backends.opencl import OpenCLBackend, devices
from accel_shapegen.backends.opencl.runtime import Runtime, aligned_empty, program_text
from accel_shapegen.errors import BackendError, DeviceMemoryError

POCL = "Portable Computing Language"


def fake_device(kind: Any, **changes: Any) -> SimpleNamespace:
    known = {
        "name": " fake ",
        "type": kind,
        "available": True,
        "compiler_available": True,
        "extensions": "cl_khr_fp64 cl_khr_icd",
        "driver_version": "7.0",
        "max_compute_units": 4096,
        "global_mem_size": 2**50,
    }
    return SimpleNamespace(**(known | changes))


def fake_platform(name: str, version: str, found: list[Any] | Exception) -> SimpleNamespace:
    def get_devices() -> list[Any]:
        if isinstance(found, Exception):
            raise found
        return found

    return SimpleNamespace(name=name, version=version, get_devices=get_devices)


@pytest.fixture
def pretend(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Let pyopencl find these platforms, in an environment without variables that drivers read."""
    for name in ("OCL_ICD_VENDORS", "POCL_CACHE_DIR", "POCL_DEVICES", "POCL_AFFINITY"):
        monkeypatch.delenv(name, raising=False)

    def platforms(*found: SimpleNamespace) -> list[DeviceInfo]:
        monkeypatch.setattr(cl, "get_platforms", lambda: list(found))
        return list(OpenCLBackend.probe())

    return platforms


def test_real_devices_are_reported(opencl: Backend) -> None:
    info = opencl.info
    assert info.usable and info.name == info.name.strip() != ""
    assert info.memory_bytes > 0 and info.compute_units > 0
    assert info.version in info.label


def test_pocl_is_reported_by_its_version(pretend: Any) -> None:
    cpu = cl.device_type.CPU
    found = pretend(
        fake_platform(POCL, "OpenCL 3.0 PoCL 3.1+debian  Linux, None+Asserts", [fake_device(cpu)]),
        fake_platform(POCL, "OpenCL 3.0 PoCL 3.0-rc2  Linux, Release", [fake_device(cpu)]),
    )
    assert [info.version for info in found] == ["PoCL 3.1+debian", "PoCL 3.0-rc2"]
    for info in found:
        assert any("PoCL 3.0-rc2 and PoCL 3.1+debian share the platform name" in line for line in info.problems)
        assert any(f"ACCEL_SHAPEGEN_DEVICE='{info.version}'" in line for line in info.problems)


def test_an_installed_pocl_goes_before_the_embedded_one(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "version", lambda name: "3.0")
    cpu = cl.device_type.CPU
    embedded, installed = pretend(
        fake_platform(POCL, "OpenCL 3.0 PoCL 3.0-rc2  Linux", [fake_device(cpu)]),
        fake_platform(POCL, "OpenCL 3.0 PoCL 3.1  Linux", [fake_device(cpu)]),
    )
    assert installed.preference > embedded.preference
    assert any("wheel" in line for line in embedded.problems)
    assert not any("wheel" in line for line in installed.problems)

    def not_there(name: str) -> str:
        raise PackageNotFoundError(name)

    monkeypatch.setattr(devices, "version", not_there)
    lone, _ = pretend(
        fake_platform(POCL, "OpenCL 3.0 PoCL 3.0-rc2  Linux", [fake_device(cpu)]),
        fake_platform(POCL, "OpenCL 3.0 PoCL 3.1  Linux", [fake_device(cpu)]),
    )
    assert not any("wheel" in line for line in lone.problems)


def test_a_gpu_goes_before_a_cpu(pretend: Any) -> None:
    cpu, gpu = pretend(
        fake_platform(POCL, "OpenCL 3.0 PoCL 3.1  Linux", [fake_device(cl.device_type.CPU)]),
        fake_platform("Vendor", "OpenCL 3.0 CUDA", [fake_device(cl.device_type.GPU, extensions="cl_khr_icd")]),
    )
    assert (cpu.kind, gpu.kind) == ("cpu", "gpu") and gpu.preference > cpu.preference
    assert gpu.version == "OpenCL 3.0 CUDA, driver 7.0" and gpu.usable
    assert any("float64" in line for line in gpu.problems)


def test_a_device_without_compiler_is_unusable(pretend: Any) -> None:
    (info,) = pretend(
        fake_platform("Vendor", "OpenCL 1.2", [fake_device(cl.device_type.GPU, compiler_available=False)])
    )
    assert not info.usable and "compiler" in info.problems[0]


def test_an_empty_platform_is_reported_not_raised(pretend: Any) -> None:
    cpu = fake_device(cl.device_type.CPU)
    error = cl.RuntimeError(cl._cl._ErrorRecord(msg="DEVICE_NOT_FOUND", code=-1, routine="clGetDeviceIDs"))
    found = pretend(
        fake_platform("Vendor", "OpenCL 3.0", error),
        fake_platform(POCL, "OpenCL 3.0 PoCL 3.1  Linux", [cpu]),
    )
    # Devices keep the first numbers, whatever platforms are empty.
    assert [(info.index, info.usable, info.platform) for info in found] == [(0, True, POCL), (1, False, "Vendor")]
    assert "DEVICE_NOT_FOUND" in found[1].problems[0]


def test_fewer_cores_than_the_machine_has(pretend: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: range(8), raising=False)
    monkeypatch.setenv("POCL_AFFINITY", "1")
    cpu = fake_device(cl.device_type.CPU, max_compute_units=3)
    (info,) = pretend(fake_platform(POCL, "OpenCL 3.0 PoCL 3.1  Linux", [cpu]))
    assert any("3 of 8 cores" in line for line in info.problems)
    assert any("POCL_AFFINITY" in line for line in info.problems)


def test_memory_of_a_cpu_is_the_machines(pretend: Any) -> None:
    version = "OpenCL 3.0 PoCL 3.1  Linux"
    cpu, gpu = pretend(
        fake_platform(POCL, version, [fake_device(cl.device_type.CPU, global_mem_size=1)]),
        fake_platform("Vendor", "OpenCL 3.0", [fake_device(cl.device_type.GPU, global_mem_size=2**30)]),
    )
    assert cpu.memory_bytes >= 2**28 and gpu.memory_bytes == 2**30


def probe_with(tmp_path: Path, **environment: str | None) -> str:
    """What a fresh process says under these variables: problems of each device, or the error."""
    code = """
from accel_shapegen.backends.opencl import OpenCLBackend
from accel_shapegen.errors import BackendError
try:
    for info in OpenCLBackend.probe():
        print("usable" if info.usable else "unusable", info.version, *info.problems, sep=" | ")
except BackendError as error:
    print("error", error, sep=" | ")
"""
    env = {name: value for name, value in (os.environ | environment).items() if value is not None}
    done = subprocess.run(
        [sys.executable, "-c", code], env=env, cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def require_pocl() -> None:
    if not any(info.version.startswith("PoCL") for info in OpenCLBackend.probe()):
        pytest.skip("no PoCL here")


@pytest.mark.parametrize(
    ("variables", "says"),
    [
        ({"POCL_CACHE_DIR": "{file}/below"}, "cannot keep kernels in {file}/below"),
        ({"POCL_CACHE_DIR": "{file}"}, "cannot keep kernels in {file}"),
        ({"POCL_CACHE_DIR": None, "XDG_CACHE_HOME": None, "HOME": "{file}"}, "cannot keep kernels in {file}/.cache"),
        ({"POCL_DEVICES": "nonsense"}, "POCL_DEVICES='nonsense' names none"),
    ],
)
def test_a_pocl_that_hides_its_devices(tmp_path: Path, variables: dict[str, str | None], says: str) -> None:
    require_pocl()
    file = tmp_path / "file"
    file.write_text("")
    filled = {name: value and value.format(file=file) for name, value in variables.items()}
    said = [line for line in probe_with(tmp_path, **filled).splitlines() if "PoCL" in line]
    assert said and all(line.startswith("unusable") and says.format(file=file) in line for line in said)


def test_an_empty_cache_variable_is_an_error_not_an_abort(tmp_path: Path) -> None:
    assert probe_with(tmp_path, POCL_CACHE_DIR="").startswith("error | POCL_CACHE_DIR: is set but empty")


def test_no_platform_at_all_names_the_variable(tmp_path: Path) -> None:
    said = probe_with(tmp_path, OCL_ICD_VENDORS=str(tmp_path / "missing"))
    assert said.startswith("error") and "OCL_ICD_VENDORS" in said and "unset it" in said


def test_a_chosen_vendor_folder_is_mentioned(tmp_path: Path) -> None:
    said = probe_with(tmp_path, OCL_ICD_VENDORS=str(tmp_path))
    assert f"OCL_ICD_VENDORS={tmp_path}" in said


def test_a_device_that_is_gone_is_an_error(opencl: Backend) -> None:
    with pytest.raises(BackendError, match="not a usable device"):
        OpenCLBackend(DeviceInfo("opencl", 999, "gone", "cpu"))


def runtime_of(backend: Backend) -> Runtime:
    assert isinstance(backend, OpenCLBackend)
    return backend.runtime


def test_programs_are_built_once(opencl: Backend) -> None:
    runtime = runtime_of(opencl)
    first = runtime.kernels("tensor_nodes", np.dtype("float32"), {"DIM": 3, "LANES": 8, "SHIFTED": 0})
    again = runtime.kernels("tensor_nodes", np.dtype("float32"), {"SHIFTED": 0, "LANES": 8, "DIM": 3})
    assert again is first and "combine" in first


def test_a_build_that_fails_says_why(opencl: Backend) -> None:
    with pytest.raises(BackendError, match=r"cannot build tensor_nodes\.cl"):
        runtime_of(opencl).kernels("tensor_nodes", np.dtype("float32"), {"LANES": 5})


def test_headers_are_put_in() -> None:
    text = program_text("tensor_transform")
    assert "#include" not in text and "typedef float8 real8" in text


def test_more_than_the_memory_is_refused(opencl: Backend) -> None:
    runtime = runtime_of(opencl)
    with pytest.raises(DeviceMemoryError, match=r"^transform: needs .*; do less$"):
        runtime.require("transform", runtime.memory_bytes + 1, 1, "do less")
    with pytest.raises(DeviceMemoryError, match="in one piece"):
        runtime.require("transform", 1, int(runtime.device.max_mem_alloc_size) + 1, "do less")
    runtime.require("transform", 1, 1, "do less")


def test_aligned_arrays_start_on_a_page() -> None:
    for shape in ((1,), (3, 5), (0, 4)):
        array = aligned_empty(shape, "complex64")
        assert array.shape == shape and array.flags.c_contiguous and array.flags.writeable
        assert array.ctypes.data % 4096 == 0 or array.size == 0


def test_the_registry_lists_what_was_found(opencl: Backend) -> None:
    assert opencl.info in backends.available()
