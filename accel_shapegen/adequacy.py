"""Whether a training set is dense enough: leave-one-out errors, and how far faces move between neighbours.

Both are measured where the spline works: on the generators as they are learned, which with frames are those of bodies
in their frames y.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .adequacy_report import Adequacy, AliasingWarning, AxisError, FaceMove
from .nodes import FourierLattice
from .splines import SplineAxis

if TYPE_CHECKING:
    from .model import ShapeModel

__all__ = ["BANDS", "Adequacy", "AliasingWarning", "AxisError", "FaceMove", "assess"]

# Wavenumber bands, equal in width from 0 to the largest |κ|.
BANDS = 8

Floats = NDArray[np.float64]


def assess(model: ShapeModel, *, bands: int = BANDS) -> Adequacy:
    """Leave-one-out errors per characteristic value and wavenumber band, and the half-wavelength rule.

    For every knot of an axis but its two ends, the spline is fitted without the bodies at that knot and predicts them;
    ends are kept, since a spline is not asked to go beyond them. The spacing there is twice what it is in use, so the
    errors are above those to expect between the bodies - for smooth data by far, for aliased data hardly.

    Errors are relative L2 norms over the nodes; on a lattice the slot ξ = 0 is left out, as everywhere.

    The rule: where a face of the bounding box moves by Δ on axis j, its part of the far field turns by κ_j Δ. From one
    body to the next that must stay below half a turn, Δ ≤ π/max|κ_j|, or the data no longer say which way it turned.

    Parameters
    ----------
    model : ShapeModel
    bands : int
        Wavenumber bands, equal in width.
    """
    shape = tuple(len(knots) for knots in model.knots)
    u = _at_knots(model).reshape(*shape, -1)
    edges, band_of = _bands(model, bands)
    return Adequacy(
        names=model.names,
        framed=model.framed,
        axes=tuple(_leave_one_out(model, j, u, band_of, bands) for j in range(len(shape))),
        band_edges=edges,
        band_energy=_energy(u.reshape(-1, u.shape[-1]), band_of, bands),
        faces=None if model.bounds is None else _face_moves(model, shape, model.bounds),
    )


def _at_knots(model: ShapeModel) -> NDArray[Any]:
    """The data that the model was fitted to: its coefficients, or else its predictions at the knots."""
    if all(axis.form == "cardinal" for axis in model.axes):
        return model.coefficients
    return model.predict(model.grid_points)


def _bands(model: ShapeModel, count: int) -> tuple[Floats, NDArray[np.int64]]:
    """Edges [rad/m], and the band of every node; the zero slot has the band `count`, which nobody looks at."""
    size = np.asarray(model.nodes.wavenumbers).ravel()
    edges = np.linspace(0, float(size.max()), count + 1)
    band = np.minimum(np.searchsorted(edges, size, side="right") - 1, count - 1)
    if isinstance(model.nodes, FourierLattice):
        band[np.ravel_multi_index(model.nodes.zero_slot, model.nodes.shape)] = count
    return edges, band


def _leave_one_out(model: ShapeModel, axis: int, u: NDArray[Any], band_of: NDArray[np.int64], bands: int) -> AxisError:
    knots, name = model.knots[axis], model.names[axis]
    lines = np.moveaxis(u, axis, -2)
    others = lines.shape[:-2]
    lines = lines.reshape(-1, *lines.shape[-2:])
    left_out = np.arange(1, len(knots) - 1)
    if not len(left_out):
        return AxisError(name, knots[:0], np.zeros((0, len(lines))), np.zeros(bands), float("nan"), ())
    weights = _residual_weights(model.axes[axis])
    # The spline is separable, and exact at the knots of the other axes: left out bodies are predicted line by line.
    wrong, whole = np.zeros((2, len(left_out), len(lines), bands))
    for index, line in enumerate(lines):
        data = line.astype(np.complex128)
        wrong[:, index] = _band_sums(weights @ data, band_of, bands)
        whole[:, index] = _band_sums(data[left_out], band_of, bands)
    errors = _quotient(wrong.sum(axis=-1), whole.sum(axis=-1))
    knot, line_index = np.unravel_index(int(errors.argmax()), errors.shape)
    place = np.unravel_index(line_index, others) if others else ()
    at = [float(k[i]) for k, i in zip((k for j, k in enumerate(model.knots) if j != axis), place, strict=True)]
    at.insert(axis, float(knots[left_out[knot]]))
    per_band = _quotient(wrong.sum(axis=(0, 1)), whole.sum(axis=(0, 1)))
    return AxisError(name, knots[left_out], errors, per_band, float(errors[knot, line_index]), tuple(at))


def _quotient(wrong: Floats, whole: Floats) -> Floats:
    """√(wrong/whole); of nothing it is 0 where nothing is wrong, and infinite elsewhere."""
    nothing = whole == 0
    return np.where(nothing & (wrong > 0), np.inf, np.sqrt(wrong / np.where(nothing, 1, whole)))


def _residual_weights(axis: SplineAxis) -> Floats:
    """R, (k, n): R times the data of a line is each inner body less what the spline without it predicts."""
    count = len(axis.knots)
    result = np.zeros((count - 2, count))
    for row, knot in enumerate(range(1, count - 1)):
        rest = SplineAxis(np.delete(axis.knots, knot), axis.boundary, name=axis.name, form="cardinal")
        result[row] = -np.insert(rest.weights(axis.knots[[knot]])[1][0], knot, -1.0)
    return result


def _band_sums(rows: NDArray[Any], band_of: NDArray[np.int64], bands: int) -> Floats:
    """Σ|·|² of each row within each band, (rows, bands)."""
    squares = rows.real**2 + rows.imag**2
    return np.stack([np.bincount(band_of, weights=row, minlength=bands + 1)[:bands] for row in squares])


def _energy(rows: NDArray[Any], band_of: NDArray[np.int64], bands: int) -> Floats:
    total = np.zeros(bands)
    for row in rows:
        total += _band_sums(row.astype(np.complex128)[None], band_of, bands)[0]
    return total / total.sum() if total.sum() else total


def _face_moves(model: ShapeModel, shape: tuple[int, ...], bounds: Floats) -> tuple[FaceMove, ...]:
    dim = model.nodes.dim
    centres, scales = (part.reshape(*shape, 1, dim) for part in model.frames(model.grid_points))
    faces = (bounds - centres) / scales
    with np.errstate(divide="ignore"):  # receivers that all look along one axis bound nothing on the others
        limits = np.pi / np.abs(np.asarray(model.nodes.kappa).reshape(-1, dim)).max(axis=0)
    moves = []
    for j, name in enumerate(model.names):
        step = np.abs(np.diff(faces, axis=j)).max(axis=-2)
        for axis in range(dim):
            # An empty body has no faces; a move to or from it says nothing.
            along = np.where(np.isnan(step[..., axis]), -1.0, step[..., axis])
            start = np.unravel_index(int(along.argmax()), along.shape)
            end = tuple(i + (m == j) for m, i in enumerate(start))
            pair = tuple(tuple(float(k[i]) for k, i in zip(model.knots, at, strict=True)) for at in (start, end))
            moves.append(FaceMove(name, axis, float(step[..., axis][start]), float(limits[axis]), (pair[0], pair[1])))
    return tuple(moves)
