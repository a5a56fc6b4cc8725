"""Optional libraries: the module, or an error with the command that installs it."""

from __future__ import annotations

import importlib
from typing import Any

from .errors import MissingDependencyError


def require(purpose: str, module: str, extra: str) -> Any:
    """The module `module`, for what `purpose` names in the plural; `MissingDependencyError` naming the extra if it is
    not there. Called before the work that needs it, not after.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        command = f'run pip install "accel-shapegen[{extra}]"'
        raise MissingDependencyError(purpose, f"need {module} ({error})", command) from error
