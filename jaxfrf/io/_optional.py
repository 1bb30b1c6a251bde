"""Libraries that only some functions need."""

import importlib
import types


def require(module: str, extra: str) -> types.ModuleType:
    """Import `module`, or say which extra of jaxfrf brings it."""
    try:
        return importlib.import_module(module)
    except ImportError as missing:
        raise ImportError(
            f"{module} is not installed; it comes with an extra of jaxfrf: pip install 'jaxfrf[{extra}]'"
        ) from missing
