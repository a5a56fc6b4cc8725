"""The two cubic B-spline bases: Model I on any knots, Model II on equidistant ones.

Both are evaluated cell by cell: in cell c, between knots c and c+1, exactly the functions c..c+3 are not zero.
Only elementwise products and sums are used, so that a query's values do not depend on its neighbours in a batch.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DEGREE = 3
SUPPORT = DEGREE + 1

Reals = NDArray[np.float64]
Integers = NDArray[np.int64]

# β³(u+1), β³(u), β³(u-1), β³(u-2) for 0 ≤ u ≤ 1: the rows hold the factors of 1, u, u², u³.
_UNIFORM_PIECES = np.array([[1, -3, 3, -1], [4, 0, -6, 3], [1, 3, 3, -3], [0, 0, 0, 1]]) / 6


def cox_de_boor(knots: Reals, cells: Integers, points: Reals, derivative: int = 0) -> Reals:
    """Model I: cubic B-splines on arbitrary knots, the end knots taken with full multiplicity.

    B_{i,p}(λ) = (λ-t_i)/(t_{i+p}-t_i) B_{i,p-1}(λ) + (t_{i+p+1}-λ)/(t_{i+p+1}-t_{i+1}) B_{i+1,p-1}(λ)
    (C. de Boor, "A Practical Guide to Splines", 1978, chapter X); the last `derivative` steps are replaced by
    B'_{i,p} = p (B_{i,p-1}/(t_{i+p}-t_i) - B_{i+1,p-1}/(t_{i+p+1}-t_{i+1})).

    Parameters
    ----------
    knots : float64, shape (k,)
        Strictly increasing.
    cells : int, shape (Q,)
        The cell of each point, 0..k-2; its polynomials are used even where the point lies outside it.
    points : float64, shape (Q,)
        λ.
    derivative : int
        0..3.

    Returns
    -------
    float64, shape (Q, 4)
        Values of the basis functions cells..cells+3, of k+2 in all.
    """
    ends = np.full(DEGREE, knots[0]), np.full(DEGREE, knots[-1])
    extended = np.concatenate([ends[0], knots, ends[1]])
    x = points[:, None]
    values = np.ones((len(points), 1))
    for degree in range(1, SUPPORT):
        # Function r of the degree below lives between these two knots, which are never the same one.
        high_index = (cells + DEGREE + 1)[:, None] + np.arange(degree)
        low, high = extended[high_index - degree], extended[high_index]
        scaled = values / (high - low)
        rising, falling = (x - low) * scaled, (high - x) * scaled
        if degree > DEGREE - derivative:
            rising, falling = degree * scaled, -degree * scaled
        values = np.zeros((len(points), degree + 1))
        values[:, :-1] = falling
        values[:, 1:] += rising
    return values


def uniform(knots: Reals, cells: Integers, points: Reals, derivative: int = 0) -> Reals:
    """Model II: L_g(λ) = β³((λ-a)/h - (g-2)), g = 1..k+2, with a the first knot and h the spacing of k knots.

    β³ is the centred cardinal cubic B-spline. The formula printed by Li, Liu, Tsui and Wang (2020) lacks the
    shift a and the scale h. Parameters and result as in `cox_de_boor`.
    """
    step = (knots[-1] - knots[0]) / (len(knots) - 1)
    pieces = _UNIFORM_PIECES
    for _ in range(derivative):
        pieces = pieces[:, 1:] * np.arange(1, pieces.shape[1]) / step
    u = ((points - knots[cells]) / (knots[cells + 1] - knots[cells]))[:, None]
    values = np.zeros((len(points), SUPPORT))
    for factors in pieces.T[::-1]:
        values = values * u + factors
    return values


def equidistant(knots: Reals) -> bool:
    """Whether knots are a + i h to their own rounding, and that rounding is nothing beside h."""
    line = np.linspace(knots[0], knots[-1], len(knots))
    # Typed decimals and np.arange are off by an ulp or two of the largest knot; where an ulp is a visible part of
    # the spacing (seconds since 1970, say), the knots that were given are not those of Model II.
    slack = min(4 * np.finfo(np.float64).eps * np.abs(knots).max(), 1e-9 * (knots[-1] - knots[0]) / (len(knots) - 1))
    return bool(np.all(np.abs(knots - line) <= slack))
