"""The OpenCL backend: PoCL on CPUs, vendors' drivers on GPUs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, ClassVar

from ...errors import BackendError
from ..base import (
    DeviceInfo,
    MeshSpreadPlan,
    MeshSpreadSpec,
    ScatteredPlan,
    ScatteredSpec,
    SplinePlan,
    SplineSpec,
    TensorPlan,
    TensorSpec,
)

if TYPE_CHECKING:
    from .runtime import Runtime


class OpenCLBackend:
    """Plans on one OpenCL device."""

    name: ClassVar[str] = "opencl"
    operations: ClassVar[frozenset[str]] = frozenset(
        {"tensor_transform", "scattered_transform", "mesh_spread", "spline_contract"}
    )

    @classmethod
    def probe(cls) -> Sequence[DeviceInfo]:
        """Every OpenCL device of every platform."""
        from . import devices

        return [info for _, info in devices.find()]

    def __init__(self, info: DeviceInfo) -> None:
        from . import devices
        from .runtime import Runtime

        self.info = info
        found = {report.index: device for device, report in devices.find() if report.usable}
        if info.index not in found:
            raise BackendError(info.label, "is not a usable device", "see accel-shapegen devices")
        self.runtime: Runtime = Runtime(found[info.index])

    def plan_tensor_transform(self, spec: TensorSpec) -> TensorPlan:
        """Contraction of a tensor grid with one small matrix per axis."""
        from .tensor import OpenCLTensorPlan

        return OpenCLTensorPlan(self.runtime, self.info.label, spec)

    def plan_scattered_transform(self, spec: ScatteredSpec) -> ScatteredPlan:
        """Voxel grid to arbitrary nodes."""
        from .scattered import OpenCLScatteredPlan

        return OpenCLScatteredPlan(self.runtime, self.info.label, spec)

    def plan_mesh_spread(self, spec: MeshSpreadSpec) -> MeshSpreadPlan:
        """Closed surfaces to smooth voxels."""
        from .mesh import OpenCLMeshSpreadPlan

        return OpenCLMeshSpreadPlan(self.runtime, self.info.label, spec)

    def plan_spline_contract(self, spec: SplineSpec) -> SplinePlan:
        """Spline coefficients to queries."""
        from .spline import OpenCLSplinePlan

        return OpenCLSplinePlan(self.runtime, self.info.label, spec)
