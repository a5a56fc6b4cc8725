"""Tensor-product cubic splines over characteristic values: bases, prefilter, weights at queries.

The interpolant of Li, Liu, Tsui and Wang (2020) through data on a tensor grid is linear in the data,
T(Λ) = Σ_t w_t(Λ) c_t. This package makes the coefficients c (`prefilter`) and the weights w (`tensor_terms`); the
sum over t, for all nodes at once, is the backends' `spline_contract`. Nothing here knows of bodies or physics.
"""

from __future__ import annotations

from .axis import CARDINAL_KNOTS, SplineAxis
from .tensor import prefilter, tensor_terms

__all__ = ["CARDINAL_KNOTS", "SplineAxis", "prefilter", "tensor_terms"]
