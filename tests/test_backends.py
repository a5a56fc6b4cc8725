"""The registry: who is chosen, what overrides, how a refusal reads; and the reference's own adjoints."""

from __future__ import annotations

import pickle
import subprocess
import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest

import accel_shapegen as asg
from accel_shapegen import backends, errors
from accel_shapegen.backends.base import Backend, DeviceInfo, SplineSpec
from accel_shapegen.errors import ArgumentError, BackendError, ShapegenError
from accel_shapegen.testing import dot_test


def test_best_device_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("ACCEL_SHAPEGEN_BACKEND", raising=False)
    monkeypatch.delenv("ACCEL_SHAPEGEN_DEVICE", raising=False)
    devices = backends.available()
    usable = [info for info in devices if info.usable]
    assert usable == sorted(usable, key=lambda info: -info.preference)
    assert {"opencl", "reference"} <= {info.backend for info in usable}
    assert backends.get(operation="tensor_transform").info == usable[0]
    assert backends.get(operation="polygon_transform").name == "reference"
    assert backends.get() is backends.get()


def test_environment_overrides(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ACCEL_SHAPEGEN_BACKEND", "reference")
    assert backends.get(operation="tensor_transform").name == "reference"
    assert backends.get("opencl").name == "opencl"
    monkeypatch.setenv("ACCEL_SHAPEGEN_BACKEND", "opencl")
    monkeypatch.setenv("ACCEL_SHAPEGEN_DEVICE", "pocl")
    assert backends.get(operation="tensor_transform").name == "opencl"
    # A wish for all calls gives way where the operation is missing; an explicit one does not.
    assert backends.get(operation="polygon_transform").name == "reference"
    with pytest.raises(BackendError, match="'opencl' has no polygon_transform"):
        backends.get("opencl", operation="polygon_transform")
    monkeypatch.setenv("ACCEL_SHAPEGEN_DEVICE", "no such device")
    with pytest.raises(BackendError, match="'no such device' matches none; there are 0 = opencl"):
        backends.get()
    monkeypatch.setenv("ACCEL_SHAPEGEN_BACKEND", "warped")
    with pytest.raises(BackendError, match="'warped' is not registered; there are opencl, reference"):
        backends.get()


def test_a_missing_library_is_named_with_the_install_command(monkeypatch: pytest.MonkeyPatch) -> None:
    point = EntryPoint("opencl", "accel_shapegen.backends.not_there:Backend", backends.GROUP)
    monkeypatch.setattr(backends, "_registered", lambda: {"opencl": point, "reference": backends._OWN["reference"]})
    for cached in (backends._load, backends._probe):
        cached.cache_clear()
    try:
        with pytest.raises(BackendError, match=r"cannot be imported.*pip install \"accel-shapegen\[pocl\]\""):
            backends.get("opencl")
        listed = {info.backend: info for info in backends.available()}
        assert not listed["opencl"].usable
        assert "cannot be imported" in listed["opencl"].problems[0]
        assert listed["reference"].usable
    finally:
        for cached in (backends._load, backends._probe):
            cached.cache_clear()


def test_backend_objects_pass_through(reference: Backend) -> None:
    assert backends.get(reference) is reference
    with pytest.raises(ArgumentError, match="operation: is 'fft'"):
        backends.get(operation="fft")


def test_protocol(opencl: Backend, reference: Backend) -> None:
    for backend in (opencl, reference):
        assert isinstance(backend, Backend)
        assert isinstance(backend.info, DeviceInfo)
        assert backend.operations <= set(backends.OPERATIONS)


@pytest.mark.parametrize("kind", ["lattice", "scattered"])
@pytest.mark.parametrize("dim", [2, 3])
def test_reference_adjoints(dim: int, kind: str, rng: np.random.Generator) -> None:
    box = asg.Box((1.0, 1.2, 0.8)[:dim])
    lattice = asg.FourierLattice(box, (2, 1, 3)[:dim], mu=0.3)
    nodes = lattice if kind == "lattice" else asg.ScatteredNodes(np.eye(dim), [1.0, 20.0, 3.0][:dim])
    plan = asg.plan_far_field(asg.Grid(box, (5, 1, 4)[:dim]), nodes, batch=2, dtype="complex128", backend="reference")
    values = rng.normal(size=(3, *plan.grid.shape))
    u = rng.normal(size=(3, *nodes.shape)) + 1j * rng.normal(size=(3, *nodes.shape))
    assert dot_test(plan.apply(values), u, values, plan.adjoint(u)) < 20 * np.finfo(float).eps


def test_reference_spline_adjoint(reference: Backend, rng: np.random.Generator) -> None:
    plan = reference.plan_spline_contract(SplineSpec(rng.normal(size=(7, 5)), np.dtype("float64")))
    columns, weights = rng.integers(7, size=(4, 3)).astype(np.int32), rng.normal(size=(4, 3))
    cotangent = rng.normal(size=(4, 5))
    left = (plan.forward(columns, weights) * cotangent).sum()
    assert abs(left - (plan.spec.coefficients * plan.adjoint(columns, weights, cotangent)).sum()) < 1e-14 * abs(left)


@pytest.mark.parametrize(
    "error", [value for value in vars(errors).values() if isinstance(value, type) and issubclass(value, ShapegenError)]
)
def test_errors_read_well_and_survive_pickling(error: type[ShapegenError]) -> None:
    raised = error("knots", "fall at index 3", "sort them")
    assert str(raised) == "knots: fall at index 3; sort them"
    again = pickle.loads(pickle.dumps(raised))
    assert (type(again), str(again), again.subject) == (error, str(raised), "knots")


def test_a_forked_child_is_refused_not_left_waiting() -> None:
    """The driver's threads stay in the parent; the child would wait for them for ever."""
    code = """
import os, sys
import numpy as np
import accel_shapegen as asg
grid, lattice = asg.Grid(asg.Box((1, 1)), 4), asg.FourierLattice(asg.Box((1, 1)), 2)
plan = asg.plan_far_field(grid, lattice, backend="opencl")
plan.apply(np.ones((4, 4)))
child = os.fork()
if child == 0:
    refused = 0
    for call in (lambda: plan.apply(np.ones((4, 4))), lambda: asg.plan_far_field(grid, lattice, backend="opencl")):
        try:
            call()
        except asg.errors.BackendError as error:
            refused += "before this process was forked" in str(error)
    os._exit(refused)
print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.split() == ["2"], done.stderr


def test_wishes_that_are_no_names_or_numbers() -> None:
    with pytest.raises(ArgumentError, match="backend: is a list"):
        backends.get(["opencl"])  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match=r"device: is 1\.5"):
        backends.get("opencl", device=1.5)  # type: ignore[arg-type]
    with pytest.raises(BackendError, match="'²' matches none"):
        backends.get("opencl", device="²")
