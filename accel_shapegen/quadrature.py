"""Quadrature of plane waves over edges and triangles: rules, their errors, and the choice of one per piece.

For a wave exp(-iκ·y) only the phases κ·v_c at the corners v_c matter. Their largest difference x is the longest edge,
measured in phase, and a rule of degree p errs by at most c x^(p+1) of the piece's measure; c was found by trying.

Sources: the symmetric rules are those of G. Strang, G. Fix, "An Analysis of the Finite Element Method" (1973) and
D. A. Dunavant, Int. J. Numer. Methods Eng. 21 (1985); the others are Gauss's, and Stroud's conical product of Gauss
and Gauss-Jacobi rules.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache

import numpy as np
from numpy.typing import NDArray

Float = NDArray[np.float64]
Index = NDArray[np.int64]

# Up to this phase the error bounds below are checked, so no piece is larger.
LARGEST_PHASE = 12.0


@dataclass(frozen=True, eq=False)
class Rule:
    """Σ_q weights[q] f(points[q]) ≈ the mean of f over an edge or a triangle.

    Attributes
    ----------
    points : float64, shape (Q, d)
        Barycentric coordinates, one per corner.
    weights : float64, shape (Q,)
        They add up to 1.
    degree : int
        Polynomials up to this degree are integrated exactly.
    """

    points: Float
    weights: Float
    degree: int

    def error(self, phase: float) -> float:
        """Largest error of the mean of a plane wave whose phases at the corners differ by at most `phase`, sampled."""
        corners = self.points.shape[1]
        exact = _finest(corners)
        # The wave's two extreme corners may be any, and the third lies between them.
        between = np.linspace(0, 1, 9) if corners == 3 else np.zeros(1)
        ends = np.stack([np.zeros_like(between), np.ones_like(between), between][:corners])
        worst = 0.0
        for order in range(corners if corners == 3 else 1):
            phases = phase * np.roll(ends, order, axis=0)
            mean = np.exp(1j * self.points @ phases).T @ self.weights
            worst = max(worst, float(np.abs(mean - np.exp(1j * exact.points @ phases).T @ exact.weights).max()))
        return worst

    @property
    def constant(self) -> float:
        """c, the least for which error(x) ≤ c x^(degree + 1) up to `LARGEST_PHASE`."""
        return _CONSTANTS[self.points.shape[1], len(self.weights)]


# By corners and points, rounded up; the tests find them again.
_CONSTANTS = {
    (2, 1): 4.17e-2, (2, 2): 2.32e-4, (2, 3): 4.97e-7, (2, 4): 5.63e-10, (2, 5): 3.94e-13, (2, 6): 1.86e-16,
    (3, 1): 2.78e-2, (3, 3): 6.95e-4, (3, 6): 2.15e-6, (3, 12): 1.57e-9, (3, 16): 3.13e-10, (3, 25): 2.16e-13,
    (3, 36): 9.92e-17, (3, 49): 3.31e-20, (3, 64): 8.39e-24,
}  # fmt: skip


@cache
def rules(corners: int, most: int = 6) -> tuple[Rule, ...]:
    """Rules of rising degree for edges (2 corners) or triangles (3), up to `most` Gauss points per direction."""
    if corners == 2:
        return tuple(_gauss(m) for m in range(1, most + 1))
    return (*_symmetric(), *(_conical(m) for m in range(4, most + 1)))


def _gauss(m: int) -> Rule:
    t, weights = np.polynomial.legendre.leggauss(m)
    return Rule(np.stack([(1 - t) / 2, (1 + t) / 2], axis=1), weights / 2, 2 * m - 1)


def _conical(m: int) -> Rule:
    """Gauss on lines from one corner, Gauss-Jacobi for the weight 1 - t across them: degree 2m - 1."""
    t, line = np.polynomial.legendre.leggauss(m)
    # Golub and Welsch: the Jacobi matrix of the weight 1 - t on [-1, 1].
    k = np.arange(m)
    diagonal = -1 / ((2 * k + 1.0) * (2 * k + 3))
    k = np.arange(1, m)
    off = np.sqrt(k * (k + 1.0)) / (2 * k + 1)
    s, vectors = np.linalg.eigh(np.diag(diagonal) + np.diag(off, 1) + np.diag(off, -1))
    across = vectors[0] ** 2
    a = np.repeat((1 + s) / 2, m)
    b = (1 - a) * np.tile((1 + t) / 2, m)
    return Rule(np.stack([1 - a - b, a, b], axis=1), np.outer(across, line / 2).ravel(), 2 * m - 1)


def _symmetric() -> tuple[Rule, ...]:
    def orbit(weight: float, a: float, b: float | None = None) -> tuple[Float, Float]:
        c = 1 - a - (a if b is None else b)
        corners = [(a, a, c)] if b is None else [(a, b, c), (b, a, c)]
        points = np.array([np.roll(corner, shift) for corner in corners for shift in range(3)])
        return points, np.full(len(points), weight)

    def rule(degree: int, *orbits: tuple[Float, Float]) -> Rule:
        points, weights = (np.concatenate(part) for part in zip(*orbits, strict=True))
        return Rule(points, weights / weights.sum(), degree)

    return (
        Rule(np.full((1, 3), 1 / 3), np.ones(1), 1),
        rule(2, orbit(1 / 3, 1 / 6)),
        rule(4, orbit(0.223381589678011, 0.445948490915965), orbit(0.109951743655322, 0.091576213509771)),
        rule(
            6,
            orbit(0.116786275726379, 0.249286745170910),
            orbit(0.050844906370207, 0.063089014491502),
            orbit(0.082851075618374, 0.053145049844817, 0.310352451033784),
        ),
    )


@cache
def _finest(corners: int) -> Rule:
    return _gauss(24) if corners == 2 else _conical(24)


@dataclass(frozen=True, eq=False)
class Pieces:
    """A surface, or the edges of polygons, cut into pieces that each have a rule.

    Attributes
    ----------
    vertices : float64, shape (V, d)
        Corners: those given, then middles of edges.
    simplices : int64, shape (T, d)
        Which corners a piece has.
    rule : uint8, shape (T,)
        Which of the rules it gets.
    flux : float64, shape (T,)
        Integral of the outward normal's component along the axis that pieces were chosen for; without one, 1 shared
        out among a piece's parts.
    parents : list of int64 arrays, each (M, 2)
        Of the middles, in order: the ends of the edge.
    """

    vertices: Float
    simplices: Index
    rule: NDArray[np.uint8]
    flux: Float
    parents: list[Index] = field(default_factory=list)


def choose(
    vertices: Float, simplices: Index, available: tuple[Rule, ...], greatest: Float, tolerance: float, axis: int | None
) -> Pieces:
    """The rule of fewest points for each piece, after halving those that no rule is good enough for.

    Parameters
    ----------
    vertices, simplices : arrays, shapes (V, d) and (T, d)
        Corners, and the edges or triangles between them.
    available : tuple of Rule
        Of rising degree.
    greatest : float64, shape (d,)
        Waves have |κ_j| ≤ greatest[j].
    tolerance : float
        Without an axis: error allowed to the mean of a wave over each piece.
    axis : int, optional
        With one only ∮ n_axis exp(-iκ·y) dS counts. Of `tolerance` times ∮ |n_axis| dS each piece may err by an equal
        share, so that small ones get cheap rules, and pieces along the axis are left out.
    """
    through = np.ones(len(simplices))
    if axis is not None:
        through = flux(vertices, simplices, axis)
        across = through != 0
        if not across.all():
            simplices, through = simplices[across], through[across]
        tolerance *= float(np.abs(through).sum()) / max(len(through), 1)
    done: list[tuple[Index, NDArray[np.uint8], Float]] = []
    parents: list[Index] = []
    while True:
        lengths = _edge_phases(vertices, simplices, greatest)
        allowed = tolerance if axis is None else tolerance / np.abs(through)
        rule = _cheapest(np.maximum.reduce(lengths), allowed, available)
        large = rule == len(available)
        if not large.any():
            break
        done.append((simplices[~large], rule[~large], through[~large]))
        vertices, simplices, middles = _halved(vertices, simplices[large], np.argmax(lengths, axis=0)[large])
        through = np.tile(through[large] / 2, 2)
        parents.append(middles)
    done.append((simplices, rule, through))
    pieces, rule, through = done[0] if len(done) == 1 else map(np.concatenate, zip(*done, strict=True))
    return Pieces(vertices, pieces, rule, through, parents)


def _cheapest(phase: Float, allowed: Float | float, available: tuple[Rule, ...]) -> NDArray[np.uint8]:
    """The first rule for which c x^(p+1) is allowed, or the number of rules where there is none."""
    rule = np.full(len(phase), len(available), dtype=np.uint8)
    log_phase, log_allowed = np.log(np.maximum(phase, 1e-30)), np.log(allowed)
    for number in reversed(range(len(available))):
        power = available[number].degree + 1
        rule[power * log_phase + np.log(available[number].constant) <= log_allowed] = number
    rule[phase > LARGEST_PHASE] = len(available)
    return rule


def flux(vertices: Float, simplices: Index, axis: int) -> Float:
    """Integral of the outward normal's component over each edge [m] or triangle [m²], shape (T,)."""
    if vertices.shape[1] == 2:
        # The normal of an edge (dx, dy) that has the body on its left is (dy, -dx).
        other = np.ascontiguousarray(vertices[:, 1 - axis])
        along = other[simplices[:, 1]] - other[simplices[:, 0]]
        return along if axis == 0 else -along
    u, v = (np.ascontiguousarray(vertices[:, (axis + k) % 3]) for k in (1, 2))
    a, b, c = np.ascontiguousarray(simplices.T)
    ua, va = u[a], v[a]
    return ((u[b] - ua) * (v[c] - va) - (v[b] - va) * (u[c] - ua)) / 2


def _edge_phases(vertices: Float, simplices: Index, greatest: Float) -> list[Float]:
    """Largest phase of a wave along each edge; edge c joins corners c and c + 1."""
    # Column by column: a mesh of 25k triangles is measured for every body anew.
    columns = [np.ascontiguousarray(column) for column in simplices.T]
    pairs = [(0, 1)] if len(columns) == 2 else [(0, 1), (1, 2), (2, 0)]
    phases: list[Float] = [np.zeros(len(simplices)) for _ in pairs]
    for place, limit in zip((vertices * greatest).T, greatest, strict=True):
        if limit:
            corners = [np.ascontiguousarray(place)[column] for column in columns]
            for phase, (first, second) in zip(phases, pairs, strict=True):
                phase += np.abs(corners[second] - corners[first])
    return phases


def _halved(vertices: Float, simplices: Index, edge: Index) -> tuple[Float, Index, Index]:
    """Every piece in two, at the middle of the edge that is named; all corners, the halves, ends of those edges."""
    count, corners = simplices.shape
    turned = np.take_along_axis(simplices, (edge[:, None] + np.arange(corners)) % corners, axis=1)
    middle = len(vertices) + np.arange(count)
    halves = np.repeat(turned[None], 2, axis=0)
    halves[0, :, 1] = middle
    halves[1, :, 0] = middle
    ends = turned[:, :2].copy()
    return np.concatenate([vertices, vertices[ends].mean(axis=1)]), halves.reshape(-1, corners), ends
