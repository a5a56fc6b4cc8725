"""Bodies to far-field shape generators, a model over characteristic values, and back to bodies.

    body → far field → model → prediction → synthesis → surface

Importing this loads NumPy and nothing heavier: device, mesh and plotting libraries load where they are first used.
Method: J. Li, H. Liu, W.-Y. Tsui, X. Wang, "An inverse scattering approach for geometric body generation: a machine
learning perspective" (2020).
"""

from __future__ import annotations

from typing import Any

from . import backends, bodies, errors, metrics
from .errors import ShapegenError
from .far_field import FarFieldPlan, far_field, plan_far_field
from .geometry import Box, Frame, Grid, Polygons, TriangleMesh, VoxelGrid
from .model import ShapeModel
from .nodes import FourierLattice, ScatteredNodes, far_field_constant, order_from_noise
from .noise import add_noise
from .surface import extract_surface
from .synthesis import SynthesisPlan, fourier_coefficients, plan_synthesis, synthesize
from .voxelize import voxelize

__all__ = [
    "Box",
    "FarFieldPlan",
    "FourierLattice",
    "Frame",
    "Grid",
    "Polygons",
    "ScatteredNodes",
    "ShapeModel",
    "ShapegenError",
    "SynthesisPlan",
    "TriangleMesh",
    "VoxelGrid",
    "add_noise",
    "backends",
    "bodies",
    "errors",
    "extract_surface",
    "far_field",
    "far_field_constant",
    "fourier_coefficients",
    "metrics",
    "order_from_noise",
    "plan_far_field",
    "plan_synthesis",
    "synthesize",
    "voxelize",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        # Reading the metadata takes milliseconds, which every import would pay for.
        from importlib.metadata import version

        return version("accel-shapegen")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
