"""Every error this package raises on purpose.

Each names its subject (the argument, file or device), says what was wrong, and says what would do:

    lambdas: query 3 has height 2.05, outside [1.5, 1.9]; stay inside or pass extrapolate="linear"

All derive from `ShapegenError` and from the builtin a caller would expect to catch.
"""

from __future__ import annotations


class ShapegenError(Exception):
    """Base of all errors of this package.

    Parameters
    ----------
    subject : str
        The argument, file, device or backend at fault, as the caller spells it.
    problem : str
        What was wrong, with the offending value and its first index.
    remedy : str
        What would do instead.
    """

    def __init__(self, subject: str, problem: str, remedy: str) -> None:
        # All three go to Exception so that the error survives pickling between processes.
        super().__init__(subject, problem, remedy)
        self.subject = subject
        self.problem = problem
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.subject}: {self.problem}; {self.remedy}"


class ArgumentError(ShapegenError, ValueError):
    """An argument has a value that makes no sense here."""


class ShapeError(ArgumentError):
    """An array argument has the wrong shape."""


class NonFiniteError(ArgumentError):
    """An array argument holds a NaN or an infinity."""


class DtypeError(ShapegenError, TypeError):
    """An array or dtype argument is of a kind that would have to be cast in silence."""


class KnotError(ArgumentError):
    """Knots are too few, unsorted, repeated, or not equidistant where they must be."""


class QueryRangeError(ArgumentError):
    """A query lies outside the range of the characteristic values."""


class TableError(ArgumentError):
    """A table of characteristic values is not a full tensor grid."""


class MeshError(ArgumentError):
    """A mesh or polygon is open, inward, or otherwise bounds no body."""


class OutsideBoxError(ArgumentError):
    """A body reaches outside the box that must contain it."""


class SurfaceError(ArgumentError):
    """A field has no surface at the asked level, or one that the grid's wall cuts."""


class BodyFileError(ShapegenError, ValueError):
    """A body file is damaged, of an unknown kind, or holds no body."""


class ModelFileError(ShapegenError, ValueError):
    """A saved model is damaged, incomplete, or of a newer format."""


class MissingFileError(ShapegenError, FileNotFoundError):
    """A file that was asked for does not exist."""

    def __str__(self) -> str:  # FileNotFoundError would print the three parts as errno fields
        return ShapegenError.__str__(self)


class MissingDependencyError(ShapegenError, ImportError):
    """An optional dependency is not installed; the remedy is the install command."""

    def __str__(self) -> str:
        return ShapegenError.__str__(self)


class BackendError(ShapegenError, RuntimeError):
    """A backend or device asked for is missing, unusable, or lacks the operation."""


class DeviceMemoryError(BackendError, MemoryError):
    """A plan needs more device memory than there is."""
