"""Settings by name, as texts for the command line's parser."""

from __future__ import annotations

import functools
import os
from typing import Any

from . import _core


def text_of(value: Any) -> str:
    """A value in the command line's syntax."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return _core.list_separator.join(text_of(one) for one in value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    return repr(value) if isinstance(value, float) else str(value)


def texts(settings: dict[str, Any]) -> dict[str, str]:
    """Settings as texts. Those that are None are left out and keep their default."""
    return {name: text_of(value) for name, value in settings.items() if value is not None}


@functools.lru_cache(maxsize=64)
def _parsed(settings: tuple[tuple[str, str], ...], where: str) -> "_core.Settings":
    return _core.Settings(dict(settings), where)


_DEFAULT: dict[str, "_core.Settings"] = {}


def insertion_settings(settings: dict[str, Any], where: str) -> "_core.Settings":
    """An insertion's settings, parsed once for each set of values. InputError for an unknown name or a value out of range."""
    if not settings:
        if where not in _DEFAULT:
            _DEFAULT[where] = _parsed((), where)
        return _DEFAULT[where]
    return _parsed(tuple(sorted(texts(settings).items())), where)
