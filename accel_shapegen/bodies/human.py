"""Human bodies by height and relative weight, from MakeHuman's macro targets.

The skin is a base mesh plus targets, piecewise multilinear in the sliders: linear between the knots 0, 1/2 and 1 of
weight and of height, linear in gender, at muscle 1/2 or 0, age 25, the mean of MakeHuman's three races and no
proportions target. Half of it is stored; the other half is its mirror image.
"""

from __future__ import annotations

import math
import numbers
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import arguments
from ..errors import ArgumentError
from ..geometry import TriangleMesh
from .human_basis import TARGET_UNIT, TEMPLATE_UNIT, HumanBasis, load_basis

KINDS = ("slider", "mass")
DENSITY = 985.0
"""Mean density of a body [kg/m³], with which a mass becomes a volume."""
MUSCLE_OF = {"mass": 0, "slider": 1}
"""Which muscle corner of the basis a kind stands on: minimum or average."""
WEIGHT_SLACK = 0.05
"""How far past its ends [0, 1] the weight slider may be continued linearly to meet a mass."""


def human(height: float, rw: float, kind: str = "slider", gender: float = 0.5) -> TriangleMesh:
    """A closed human skin of exactly the given height, in MakeHuman's resting pose, arms half raised.

    Parameters
    ----------
    height : float
        Height of the mesh [m], for which MakeHuman's height slider is solved: 1.30 to 2.38 at gender 1/2, 1.23 to
        2.31 for a woman, 1.37 to 2.45 for a man.
    rw : float
        Relative weight. With `kind="slider"` it is MakeHuman's "Weight" read-out, rw = 1/2 + weight slider, from 0.5
        to 1.5, at muscle 1/2; it moves the volume by about ±10 %. With `kind="mass"` it is a true ratio of masses,
        985 kg/m³ · volume = rw · 0.9 kg · (height/cm - 100) (Broca), at muscle 0: the weight slider is solved for
        it and may be continued linearly by 0.05 past its ends. 0.6 to 1.4 is reached from 1.5 m to 1.9 m.
    kind : {"slider", "mass"}
        What `rw` means.
    gender : float
        From 0 (female) to 1 (male).

    Returns
    -------
    TriangleMesh
        12,440 vertices [m] and 24,876 triangles, closed, outward, an exact mirror image of itself in x = 0, centred
        at its bounding box; x = span (to the body's left), y = depth (to the back), z = height. Eye sockets and
        mouth are sealed. The triangles are the same for all bodies.

    Raises
    ------
    ArgumentError
        Where an argument is not a finite real number or lies outside what the model reaches.

    Notes
    -----
    Targets: MakeHuman community, CC0. Equal arguments give equal bits on one machine.
    """
    stature = _number("height", height)
    relative = _number("rw", rw)
    kind = arguments.choice("kind", kind, KINDS)
    sex = _number("gender", gender)
    if not 0 <= sex <= 1:
        raise ArgumentError("gender", f"is {sex}", "give a number from 0 (female) to 1 (male)")
    model = _model(sex, MUSCLE_OF[kind])
    if kind == "slider":
        if not 0.5 <= relative <= 1.5:
            raise ArgumentError("rw", f"is {relative}", 'give 0.5 to 1.5 with kind="slider", the ends of its slider')
        half = model.body(relative - 0.5, stature)
    else:
        half = model.body_of_mass(relative, stature)
    return TriangleMesh(_whole(half, model.midline), _whole_faces(load_basis()))


def broca_mass(height: float) -> float:
    """Broca's reference weight [kg] of a height [m]: 0.9 · (height in cm - 100)."""
    return 0.9 * (100 * height - 100)


class BodyModel:
    """The half bodies of one gender and one muscle corner, over weight and height.

    Parameters
    ----------
    basis : HumanBasis
        The packaged targets.
    gender : float
        From 0 (female) to 1 (male).
    muscle : int
        0 for minimum, 1 for average muscle.

    Attributes
    ----------
    middle : (3, H, 3)
        Vertices [m] at the three weight knots, height slider 1/2.
    reach : (2, 3, H, 3)
        What minimum and maximum height add [m], per weight knot.
    """

    def __init__(self, basis: HumanBasis, gender: float, muscle: int) -> None:
        mix = np.array([1 - gender, gender])
        people = np.tensordot(mix, basis.people, axes=1) / 3
        build = np.tensordot(mix, basis.build[:, muscle], axes=1)
        extra = np.tensordot(mix, basis.stature_extra[:, muscle], axes=1)
        self.middle = basis.template * TEMPLATE_UNIT + (people + build) * TARGET_UNIT
        self.reach = (basis.stature[:, None] + extra.swapaxes(0, 1)) * TARGET_UNIT
        self.midline = basis.midline
        self._faces = basis.faces.astype(np.int64)

    def vertices(self, weight: float, stature: float) -> NDArray[np.float64]:
        """Half vertices [m], not centred, of the two sliders (each 0..1 with its kink at 1/2), shape (H, 3)."""
        side, step = (0, 1 - 2 * stature) if stature < 0.5 else (1, 2 * stature - 1)
        return np.asarray(np.tensordot(_knots(weight), self.middle + step * self.reach[side], axes=1))

    def body(self, weight: float, height: float) -> NDArray[np.float64]:
        """Half vertices [m] of a weight slider and a height [m]; `ArgumentError` where no height slider gives it."""
        mix = _knots(weight)
        middle = np.tensordot(mix, self.middle, axes=1)
        side = int(height >= np.ptp(middle[:, 2]))
        reach = np.tensordot(mix, self.reach[side], axes=1)
        step = _step_to_height(middle[:, 2], reach[:, 2], height)
        if step is None:
            low, high = (np.ptp(self.vertices(weight, end)[:, 2]) for end in (0.0, 1.0))
            raise ArgumentError(
                "height",
                f"is {height} m, which no height slider gives this body",
                f"give {_inside(low, high)} m",
            )
        return np.asarray(middle + step * reach)

    def body_of_mass(self, rw: float, height: float) -> NDArray[np.float64]:
        """Half vertices [m] whose volume times the density is `rw` times Broca's weight; sets the weight slider."""
        from scipy.optimize import brentq

        reference = broca_mass(height)

        def excess(weight: float) -> float:
            return DENSITY * self.volume(self.body(weight, height)) / reference - rw

        # One kink, at the middle weight: on either side of it the excess is smooth and rises.
        knots = (-WEIGHT_SLACK, 0.5, 1 + WEIGHT_SLACK)
        at = [excess(knot) for knot in knots]
        if not at[0] <= 0 <= at[2]:
            raise ArgumentError(
                "rw",
                f"is {rw}, a mass that no weight slider gives at {height} m",
                f'give {_inside(at[0] + rw, at[2] + rw)} here, or kind="slider"',
            )
        below, above = (knots[0], knots[1]) if at[1] >= 0 else (knots[1], knots[2])
        return self.body(float(brentq(excess, below, above, xtol=1e-14, rtol=1e-14)), height)

    def volume(self, half: NDArray[np.float64]) -> float:
        """Volume [m³] of the whole body: twice the flux of (x, 0, 0) through the half; the plane x = 0 adds none."""
        a, b, c = half[self._faces[:, 0]], half[self._faces[:, 1]], half[self._faces[:, 2]]
        normal = (b[:, 1] - a[:, 1]) * (c[:, 2] - a[:, 2]) - (b[:, 2] - a[:, 2]) * (c[:, 1] - a[:, 1])
        return float(np.sum((a[:, 0] + b[:, 0] + c[:, 0]) * normal)) / 3


def _knots(weight: float) -> NDArray[np.float64]:
    """Hat functions of the knots 0, 1/2, 1, continued linearly past the ends, shape (3,)."""
    if weight < 0.5:
        return np.array([1 - 2 * weight, 2 * weight, 0.0])
    return np.array([0.0, 2 - 2 * weight, 2 * weight - 1])


def _step_to_height(middle: NDArray[Any], reach: NDArray[Any], height: float) -> float | None:
    """The step in [0, 1] at which middle + step · reach has extent `height`, or None.

    The extent is a maximum of linear functions of the step, so Newton's method lands on the piece that holds the
    root after a few steps. A piece that comes back has the root, or ties with the one that has it.
    """
    step, seen = 0.0, set[tuple[int, int]]()
    while True:
        z = middle + step * reach
        top, bottom = int(z.argmax()), int(z.argmin())
        if (top, bottom) in seen:
            return step if 0 <= step <= 1 else None
        seen.add((top, bottom))
        step = float((height - (middle[top] - middle[bottom])) / (reach[top] - reach[bottom]))


def _whole(half: NDArray[np.float64], midline: int) -> NDArray[np.float64]:
    """Both halves, centred at the bounding box: midline, left, right."""
    low, high = half.min(axis=0), half.max(axis=0)
    centred = half - np.array([0.0, (low[1] + high[1]) / 2, (low[2] + high[2]) / 2])
    return np.concatenate([centred, centred[midline:] * (-1.0, 1.0, 1.0)])


@lru_cache(maxsize=1)
def _whole_faces(basis: HumanBasis) -> NDArray[np.int64]:
    """Triangles of both halves; a reflection turns their sense, so the mirrored ones run backwards."""
    left = basis.faces.astype(np.int64)
    side = len(basis.template) - basis.midline
    right = np.where(left < basis.midline, left, left + side)[:, ::-1]
    return np.concatenate([left, right])


@lru_cache(maxsize=8)
def _model(gender: float, muscle: int) -> BodyModel:
    return BodyModel(load_basis(), gender, muscle)


def _number(name: str, value: Any) -> float:
    """A finite real number, refused otherwise: booleans, strings, complex numbers and arrays are not cast."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, numbers.Real):
        raise ArgumentError(name, f"is {value!r}", "give a real number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise ArgumentError(name, f"is {value}", "give a finite number")
    return number


def _inside(low: float, high: float) -> str:
    """A range rounded inward, so that its printed ends are themselves allowed."""
    return f"{math.ceil(low * 1e3) / 1e3:.3f} to {math.floor(high * 1e3) / 1e3:.3f}"
