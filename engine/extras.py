"""Packages that an extra of the distribution brings: imported where they are used, and how to get them."""

from importlib import import_module
from types import ModuleType

from engine.errors import InputError

__all__ = ["load_extra"]


def load_extra(module: str, extra: str, purpose: str) -> ModuleType:
    """Import an optional package, for a purpose that begins the message of the InputError where that cannot be done."""
    try:
        return import_module(module)
    except (ImportError, OSError) as error:
        missing = isinstance(error, ModuleNotFoundError) and error.name == module
        why = "is not installed" if missing else f"cannot be loaded ({error})"
        raise InputError(f"{purpose} needs {module}, which {why}: pip install 'mark3dgs[{extra}]'") from None
