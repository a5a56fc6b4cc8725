"""What a model is fitted to: shape generators of bodies one by one, in frames or without, and the checks of both."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import arguments, frames, voxel_transform
from .backends.base import Backend
from .errors import ArgumentError, OutsideBoxError, ShapeError, ShapegenError
from .far_field import Body, far_field
from .geometry import Frame, VoxelGrid
from .nodes import FourierLattice, Nodes

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Generators:
    """What a model is fitted to, one row for each body.

    Attributes
    ----------
    u : array, shape (total, *nodes.shape)
        Shape generators, of the bodies in their frames.
    bounds : float64, shape (total, 2, dim)
        Bounding boxes [m]; NaN for an empty body.
    frames : (centres, scales), two float64 arrays of shape (total, dim), or None
        c [m] and σ.
    """

    u: NDArray[Any]
    bounds: Floats
    frames: tuple[Floats, Floats] | None = None

    def frames_on(self, shape: tuple[int, ...]) -> tuple[Floats, Floats] | None:
        """The frames with the training grid's axes in front."""
        if self.frames is None:
            return None
        centres, scales = self.frames
        return centres.reshape(*shape, -1), scales.reshape(*shape, -1)


def body_generators(
    bodies: Iterable[Body],
    total: int,
    nodes: Nodes,
    *,
    rule: frames.Rule | None,
    place: Callable[[int], str],
    eps: float,
    dtype: np.dtype[Any],
    backend: str | Backend | None,
    progress: Callable[[int, int], object] | None,
) -> Generators:
    """Shape generators of exactly `total` single bodies, consumed one by one.

    Without a rule for frames the bodies are passed through once. With one they are passed through twice, since the
    scales are relative to the largest: an iterator, which can be passed through once, is kept in memory. `place` is
    what messages call a body.
    """
    options = {"eps": eps, "dtype": dtype, "backend": backend}
    if rule is None:
        u, bounds = _transform(bodies, total, nodes, None, options, progress)
        return Generators(u, bounds)
    if iter(bodies) is bodies:
        bodies = list(bodies)

    def first_half(done: int, of: int) -> None:
        if progress is not None:
            progress(done, 2 * of)

    def second_half(done: int, of: int) -> None:
        if progress is not None:
            progress(of + done, 2 * of)

    centres, scales = _survey(bodies, total, nodes, rule, place, first_half)
    chosen = [Frame(c, s) for c, s in zip(centres.tolist(), scales.tolist(), strict=True)]
    u, bounds = _transform(bodies, total, nodes, chosen, options, second_half)
    return Generators(u, bounds, (centres, scales))


def _survey(
    bodies: Iterable[Body],
    total: int,
    nodes: Nodes,
    rule: frames.Rule,
    place: Callable[[int], str],
    progress: Callable[[int, int], object],
) -> tuple[Floats, Floats]:
    """Centres and scales of all bodies, each of which fits into the lattice's box in its frame."""
    found, bounds = [], np.empty((total, 2, nodes.dim))
    for index, body in _counted(bodies, total):
        try:
            found.append(frames.frame_of(body, rule))
        except ShapegenError as error:
            raise type(error)(place(index), f"{error.subject} {error.problem}", error.remedy) from error
        if body.dim != nodes.dim:
            raise ShapeError(place(index), f"is {body.dim}-D, the nodes are {nodes.dim}-D", "give both the same")
        bounds[index] = frames.bounds_of(body)
        progress(index + 1, total)
    centres, scales = frames.normalised(found)
    if isinstance(nodes, FourierLattice):
        reach = (bounds - centres[:, None]) / scales[:, None]
        half = np.array(nodes.box.lengths) / 2
        outside = np.argwhere(np.abs(reach).max(axis=1) > half * (1 + voxel_transform.BOX_SLACK))
        if len(outside):
            index, axis = (int(i) for i in outside[0])
            low, high = reach[index, :, axis]
            raise OutsideBoxError(
                place(index),
                f"reaches from {low:.6g} to {high:.6g} m on axis {axis} of its frame, outside the lattice's box "
                f"±{half[axis]:.6g} m",
                "use a larger box, or another frame",
            )
    return centres, scales


def _transform(
    bodies: Iterable[Body],
    total: int,
    nodes: Nodes,
    chosen: Sequence[Frame] | None,
    options: dict[str, Any],
    progress: Callable[[int, int], object] | None,
) -> tuple[NDArray[Any], Floats]:
    """Far fields (total, *nodes.shape), in frames if there are any, and bounding boxes (total, 2, dim)."""
    u, bounds = np.empty((total, *nodes.shape), dtype=options["dtype"]), np.empty((total, 2, nodes.dim))
    for index, body in _counted(bodies, total):
        if isinstance(body, VoxelGrid) and not np.any(body.values):
            spans = " × ".join(f"{length:g}" for length in body.box.lengths)
            raise ArgumentError(
                f"bodies[{index}]",
                f"is empty: no cell of its {spans} m box is occupied",
                "give finer voxels or a smaller box (are the body's lengths metres?)",
            )
        if chosen is None:
            generator = far_field(body, nodes, **options)
        else:
            generator = _framed(body, nodes, chosen[index], options)
        if generator.shape != nodes.shape:
            lead = generator.shape[: -len(nodes.shape)]
            raise ShapeError(f"bodies[{index}]", f"is a batch of shape {lead}", "give single bodies")
        u[index], bounds[index] = generator, frames.bounds_of(body)
        if progress is not None:
            progress(index + 1, total)
    return u, bounds


def _framed(body: Body, nodes: Nodes, frame: Frame, options: dict[str, Any]) -> NDArray[Any]:
    """The far field of a body in its frame; of voxels, only the occupied ones need to fit the box."""
    if isinstance(body, VoxelGrid):
        body, moved = frames.cropped(body)
        frame = Frame((np.array(frame.centre) - moved).tolist(), frame.scale)
    return far_field(body, nodes, frame=frame, **options)


def _counted(bodies: Iterable[Body], total: int) -> Iterator[tuple[int, Body]]:
    """Exactly `total` bodies, numbered."""
    done = 0
    for body in bodies:
        if done == total:
            raise ShapeError("bodies", f"has more than {total} entries", "give one body per grid point")
        yield done, body
        done += 1
    if done < total:
        raise ShapeError("bodies", f"has {done} entries", f"give {total}, one per grid point, C order")


def checked_frames(given: tuple[ArrayLike, ArrayLike], grid: tuple[int, ...], dim: int) -> Floats:
    """Centres and scales of a caller, side by side: (n_1, .., n_M, 2 dim), a copy."""
    if isinstance(given, np.ndarray) or len(arguments.sequence("frames", given, "two arrays")) != 2:
        raise ShapeError("frames", "is not a pair", "give (centres, scales)")
    parts = []
    for name, part in zip(("frames: centres", "frames: scales"), given, strict=True):
        values = arguments.real_array(name, part, np.float64)
        if values.shape != (*grid, dim):
            raise ShapeError(name, f"has shape {values.shape}", f"give {(*grid, dim)}")
        parts.append(values)
    if np.any(parts[1] <= 0):
        index = tuple(int(i) for i in np.argwhere(parts[1] <= 0)[0])
        raise ArgumentError("frames: scales", f"is {parts[1][index]} at index {index}", "give positive factors")
    return np.concatenate(parts, axis=-1)


def checked_bounds(given: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """Bounding boxes of a caller, a copy; those of empty bodies are NaN."""
    boxes = arguments.real_array("bounds", given, np.float64, check=False).copy()
    if boxes.shape != shape:
        raise ShapeError("bounds", f"has shape {boxes.shape}", f"give {shape}: the knots, then lower and upper corners")
    return boxes
