"""Device code, and the only reader of it.

Installed as `accel_shapegen.kernels`. Imports nothing from the package around it, so that kernels can be
read, compiled and measured without it. One folder per backend; a file holds one operation or one stage of it.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

_ROOT = Path(__file__).resolve().parent

# What a backend's sources end in; a folder beside this file without an entry here holds Python, not source text.
_SUFFIX = {"opencl": ".cl"}


class KernelNotFoundError(LookupError):
    """A kernel source, or a backend's folder of them, that is not part of this package."""


def include_dir(backend: str = "opencl") -> Path:
    """Folder of a backend's sources and headers, for the compiler's include path.

    Parameters
    ----------
    backend : str
        A backend whose kernels are source text: "opencl".

    Returns
    -------
    pathlib.Path
        An absolute path. It may hold spaces: quote it in compiler options.

    Raises
    ------
    KernelNotFoundError
        There are no sources for that backend.
    """
    if backend not in _SUFFIX:
        raise KernelNotFoundError(f"no kernel sources for backend {backend!r}; there are some for: {_listed(_SUFFIX)}")
    return _ROOT / backend


def names(backend: str = "opencl") -> tuple[str, ...]:
    """Names that `source` accepts, sorted; raises `KernelNotFoundError` for an unknown backend."""
    folder = include_dir(backend)
    return tuple(sorted(path.stem for path in folder.glob(f"*{_SUFFIX[backend]}")))


def source(name: str, backend: str = "opencl") -> str:
    """Text of one kernel source.

    Parameters
    ----------
    name : str
        A file's name without its suffix: "tensor_transform".
    backend : str
        A backend whose kernels are source text: "opencl".

    Returns
    -------
    str
        The file as it stands; its includes are found through `include_dir`.

    Raises
    ------
    KernelNotFoundError
        No such kernel or backend; the message lists those there are.
    """
    known = names(backend)
    # Looked up, not joined to a path: "../x" or an absolute path cannot read a file outside the folder.
    if name not in known:
        raise KernelNotFoundError(f"no {backend} kernel source {name!r}; there are: {_listed(known)}")
    return (include_dir(backend) / f"{name}{_SUFFIX[backend]}").read_text(encoding="utf-8")


def _listed(items: Iterable[str]) -> str:
    return ", ".join(items) or "none"
