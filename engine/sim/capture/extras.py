"""Programs of others that only capture needs: installed by the extra ``capture``, looked for when called."""

import importlib
from typing import Any

from engine.errors import InputError

__all__ = ["load_extra"]


def load_extra(module: str, package: str, purpose: str) -> Any:
    """Import a module of an optional distribution; InputError, naming the purpose, where that cannot be done."""
    try:
        return importlib.import_module(module)
    except ImportError as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == module.partition(".")[0]
        why = "is not installed" if missing else f"cannot be loaded ({error})"
        message = f"{purpose} needs {package}, which {why}: pip install 'mark3dgs[capture]'"
        raise InputError(message) from None
