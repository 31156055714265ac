"""Libraries that only some strategies need, loaded when these run."""

from __future__ import annotations

import importlib
from typing import Any

from sysid import InvalidInput


def required(module: str, package: str, strategy: str) -> Any:
    """The module. Raises InvalidInput where its package is not installed."""
    try:
        return importlib.import_module(module)
    except ImportError:
        raise InvalidInput(
            f"{strategy} needs the package {package}, which is not installed: pip install 'gapfinder[strategies]'"
        ) from None
