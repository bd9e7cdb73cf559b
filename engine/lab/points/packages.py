"""Packages of the extra ``capture``, loaded where a file or a command needs them."""

import importlib
from typing import Any

from engine.errors import InputError


def load_package(module: str, package: str, purpose: str) -> Any:
    """Import a module of an optional package; InputError, naming the purpose and the extra, if that fails."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]
        why = "is not installed" if missing else f"cannot be loaded ({error})"
        raise InputError(f"{purpose} needs {package}, which {why}: pip install 'mark3dgs[capture]'") from None
