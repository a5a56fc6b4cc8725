"""Closed meshes → shape generators on the lattice, zero node included."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

import accel_shapegen as asg
from accel_shapegen import Frame, TriangleMesh, mesh_transform
from accel_shapegen.backends.base import Backend
from accel_shapegen.mesh_far_field import MeshFarFieldPlan, exact

from ..contest import Array, Case, Contender, Run, Settings, Work, aligned_zeros, relative_l2
from ..rivals import surface_nufft
from . import own
from .bodies import box

NAME = "mesh_far_field"
BATCH, QUICK_BATCH = 8, 3
# Asked of all: what the package's meshes are meant for, and a float64 accuracy that others reach too.
EPS = {"float32": 2e-6, "float64": 1e-10}
IDENTITY = Frame((0.0, 0.0, 0.0), 1.0)


def cases(settings: Settings) -> Iterator[Case]:
    """One case: human bodies of 1.5 to 1.9 m and mixed weight; balls when it must be quick."""
    lattice = asg.FourierLattice(box(), settings.order)
    batch = settings.batch or (QUICK_BATCH if settings.quick else BATCH)
    meshes = [_mesh(settings.quick, t) for t in np.linspace(0, 1, batch)]
    out = aligned_zeros((batch, *lattice.shape), settings.complex_dtype)
    eps = settings.eps or EPS[settings.dtype]

    def prepare(backend: Backend) -> Run:
        if "mesh_transform" in backend.operations:
            return lambda: np.stack([exact(mesh, lattice, IDENTITY, backend) for mesh in meshes]).astype(out.dtype)
        frames = [IDENTITY] * batch
        plan = MeshFarFieldPlan(meshes, lattice, frames, eps=eps, dtype=out.dtype, batch=1, backend=backend)
        return lambda: plan.apply(meshes, out=out)

    # Its cost is that of the sum over all nodes.
    ours, skipped = own.contenders(NAME, settings, prepare, batch, lattice.size, eps)
    kind = "balls" if settings.quick else "humans"
    faces = len(meshes[0].faces)
    yield Case(
        name=NAME,
        detail=f"{kind}, {faces} triangles to {'×'.join(map(str, lattice.shape))} nodes",
        shape={"faces": [faces], "nodes": list(lattice.shape)},
        batch=batch,
        dtype=settings.dtype,
        per="body",
        contenders=[*ours, *_rivals(lattice, meshes, out, eps)],
        out=out,
        error=_Error(lattice, meshes),
        work=Work(meshes[0].vertices.nbytes + meshes[0].faces.nbytes, out[0].nbytes),
        skipped=skipped,
    )


def _mesh(quick: bool, t: float) -> TriangleMesh:
    if quick:
        return asg.bodies.ellipsoid(0.6 + 0.1 * t, 0.7, 0.5, subdivisions=2)
    return asg.bodies.human(1.5 + 0.4 * t, 0.6 + 0.8 * ((3 * t) % 1.0))


def _rivals(lattice: asg.FourierLattice, meshes: Sequence[TriangleMesh], out: Array, eps: float) -> list[Contender]:
    rivals = []
    for kind, every in (("one component", False), ("three components", True)):
        points = [_points(lattice, mesh, eps, every) for mesh in meshes]
        ways = surface_nufft.variants(kind, lattice, points, out, eps)
        rivals.append(Contender(f"finufft-type1, {kind}", ways, len(meshes), eps))
    return rivals


def _points(lattice: asg.FourierLattice, mesh: TriangleMesh, eps: float, every: bool) -> surface_nufft.Points:
    """The points that this package uses at the same accuracy; more of them where every component has to be right."""
    greatest = mesh_transform.greatest_kappa(lattice)
    axis = 2  # that of a standing body's least area
    places, flux = mesh_transform.quadrature_points(mesh.vertices, mesh.faces, greatest, None if every else axis, eps)
    return surface_nufft.Points(places, flux, axis)


class _Error:
    """Against converged quadrature over the slots ξ ≠ 0; the zero node counts where it is worse."""

    def __init__(self, lattice: asg.FourierLattice, meshes: Sequence[TriangleMesh]) -> None:
        self._slot = lattice.zero_slot
        # A human takes the reference half a minute: the first, which all contenders compute, and the last.
        items = sorted({0, len(meshes) - 1})
        self._exact = {item: exact(meshes[item], lattice, IDENTITY, own.reference()) for item in items}

    def __call__(self, result: Array) -> float:
        errors = []
        for item, right in self._exact.items():
            if item < len(result):
                errors.append(abs(complex(result[item][self._slot]) / right[self._slot] - 1))
                others = result[item].copy(), right.copy()
                for array in others:
                    array[self._slot] = 0
                errors.append(relative_l2(*others))
        return max(errors)
