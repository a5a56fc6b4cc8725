"""Devices that tests run on: every usable OpenCL device found (the PoCL wheel, a system PoCL, GPUs)."""

from __future__ import annotations

import numpy as np
import pytest

from accel_shapegen import backends
from accel_shapegen.backends.base import Backend, DeviceInfo


def opencl_devices() -> list[DeviceInfo]:
    return [info for info in backends.available() if info.backend == "opencl" and info.usable]


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "opencl" in metafunc.fixturenames:
        devices = opencl_devices()
        # A run without any device must not pass by having nothing to run.
        params = devices or [None]
        metafunc.parametrize(
            "opencl", params, indirect=True, ids=lambda info: info.version.replace(" ", "-") if info else "none"
        )


@pytest.fixture
def opencl(request: pytest.FixtureRequest) -> Backend:
    """An OpenCL backend, once per device."""
    assert request.param is not None, 'no OpenCL device: pip install "accel-shapegen[pocl]"'
    return backends.get("opencl", device=request.param.index)


@pytest.fixture
def reference() -> Backend:
    """The NumPy oracle."""
    return backends.get("reference")


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A generator seeded by the test's name: reproducible, different from test to test."""
    return np.random.default_rng(list(request.node.name.encode()))
