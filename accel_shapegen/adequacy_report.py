"""What an assessment of a training set found, as data, as text and as JSON."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class AliasingWarning(UserWarning):
    """Neighbouring training bodies differ by more than the band can tell apart."""


@dataclass(frozen=True)
class AxisError:
    """Leave-one-out errors along one characteristic value.

    Attributes
    ----------
    name : str
        The characteristic value.
    knots : float64, shape (k,)
        Those that were left out, one at a time: all but the two ends.
    errors : float64, shape (k, n)
        Relative L2 error of each body, n being the bodies that share a knot.
    bands : float64, shape (bands,)
        Relative L2 error within each wavenumber band, over all of these bodies; 0 in a band that is empty.
    worst : float
        The largest of `errors`; NaN where nothing could be left out.
    worst_at : tuple of float
        Characteristic values of that body.
    """

    name: str
    knots: Floats = field(repr=False)
    errors: Floats = field(repr=False)
    bands: Floats = field(repr=False)
    worst: float
    worst_at: tuple[float, ...]

    @property
    def typical(self) -> float:
        """Root mean square of `errors`."""
        return float(np.sqrt(np.mean(self.errors**2))) if self.errors.size else float("nan")


@dataclass(frozen=True)
class FaceMove:
    """The farthest that a face of the bounding box moves between bodies that are neighbours in one value.

    Attributes
    ----------
    name : str
        The characteristic value.
    axis : int
        The axis of space on which the face moves.
    move : float
        How far [m], in the frame if there is one.
    limit : float
        Half the shortest wavelength along that axis, π/max|κ_j| [m]; on a lattice a_j/(2N_j).
    between : two tuples of float
        The characteristic values of the two bodies.
    """

    name: str
    axis: int
    move: float
    limit: float
    between: tuple[tuple[float, ...], tuple[float, ...]]

    @property
    def exceeds(self) -> bool:
        """Whether the phase at the face turns by more than half a turn somewhere in the band."""
        return self.move > self.limit


@dataclass(frozen=True)
class Adequacy:
    """What `ShapeModel.adequacy` reports; `print` it, or `to_dict` it for a program.

    Attributes
    ----------
    names : tuple of str
        The characteristic values.
    framed : bool
        Whether bodies are learned in reference frames.
    axes : tuple of AxisError
        One per characteristic value.
    band_edges : float64, shape (bands + 1,)
        [rad/m].
    band_energy : float64, shape (bands,)
        Share of ‖u‖² in each band, over the training set.
    faces : tuple of FaceMove, or None
        One per characteristic value and axis of space; None for a model that was not fitted from bodies.
    """

    names: tuple[str, ...]
    framed: bool
    axes: tuple[AxisError, ...]
    band_edges: Floats = field(repr=False)
    band_energy: Floats = field(repr=False)
    faces: tuple[FaceMove, ...] | None

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line for each characteristic value whose bodies are too far apart."""
        lines = []
        for name in self.names:
            beyond = [face for face in self.faces or () if face.name == name and face.exceeds]
            if beyond:
                face = max(beyond, key=lambda one: one.move / one.limit)
                start, end = (self._point(values) for values in face.between)
                lines.append(
                    f"{name}: between {start} and {end} a face of the bounding box moves by {face.move:.3g} m on axis "
                    f"{face.axis}{' of the frame' if self.framed else ''}, more than half the shortest wavelength "
                    f"({face.limit:.3g} m): put bodies between them, lower the order, or learn in a frame"
                )
        return tuple(lines)

    def _point(self, values: tuple[float, ...]) -> str:
        return "(" + ", ".join(f"{n}={v:g}" for n, v in zip(self.names, values, strict=True)) + ")"

    def __str__(self) -> str:
        lines = ["Leave-one-out error of the training set (relative L2, ends kept)"]
        for axis in self.axes:
            if not axis.errors.size:
                lines.append(f"  {axis.name}: two knots, none can be left out")
                continue
            lines.append(f"  {axis.name}: {axis.typical:.2e}, worst {axis.worst:.2e} at {self._point(axis.worst_at)}")
            lines.append("    by wavenumber: " + " ".join(f"{error:.1e}" for error in axis.bands))
        lines.append(f"  bands end at {' '.join(f'{edge:.3g}' for edge in self.band_edges[1:])} rad/m")
        if self.faces is None:
            return "\n".join([*lines, "Half-wavelength rule: not checked, the model came without bodies or bounds"])
        lines.append("Farthest move of a face between neighbours / half the shortest wavelength")
        for name in self.names:
            moves = (
                f"axis {f.axis}: {f.move:.3g} / {f.limit:.3g} m{' !' if f.exceeds else ''}"
                for f in self.faces
                if f.name == name
            )
            lines.append(f"  {name}: {', '.join(moves)}")
        return "\n".join(lines + [f"Warning: {text}" for text in self.warnings])

    def to_dict(self) -> dict[str, Any]:
        """Everything as numbers, lists and texts, ready for JSON: what is not finite is None."""
        faces = None if self.faces is None else [_face_dict(face) for face in self.faces]
        return {
            "framed": self.framed,
            "band_edges_rad_per_m": self.band_edges.tolist(),
            "band_energy": self.band_energy.tolist(),
            "leave_one_out": [_axis_dict(axis) for axis in self.axes],
            "faces": faces,
            "warnings": list(self.warnings),
        }


def _axis_dict(axis: AxisError) -> dict[str, Any]:
    return {
        "value": axis.name,
        "knots": axis.knots.tolist(),
        "typical": _number(axis.typical),
        "worst": _number(axis.worst),
        "worst_at": list(axis.worst_at),
        "errors": [[_number(error) for error in row] for row in axis.errors],
        "bands": [_number(error) for error in axis.bands],
    }


def _face_dict(face: FaceMove) -> dict[str, Any]:
    return {
        "value": face.name,
        "axis": face.axis,
        "move_m": _number(face.move),
        "limit_m": _number(face.limit),
        "exceeds": face.exceeds,
        "between": [list(point) for point in face.between],
    }


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
