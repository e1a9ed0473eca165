"""Numba decorators: single core, results equal to the bit from run to run, cached on disk.

Numba takes a kernel from the disk while its own file is unchanged. A kernel also contains what it calls and the
constants that it uses, so here it is compiled again when one of these has changed, in any file.
"""

import os
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core.caching import IndexDataCacheFile
from numba.core.dispatcher import Dispatcher

F = TypeVar("F", bound=Callable[..., object])
_FOUND: dict[str, list[Any]] = {}  # sources by module


def kernel(function: F) -> F:
    """Compiles a function with numba, without `parallel` and `fastmath`; keeps its type.

    Division by zero gives infinity, as in numpy: a loop that can raise is not vectorised.
    """
    return cast(F, _cached(numba.njit(cache=True, nogil=True, error_model="numpy")(function)))


def inline_kernel(function: F) -> F:
    """Compiles a function into each calling kernel: a call would pass every array as seven values."""
    return cast(F, _cached(numba.njit(cache=True, error_model="numpy", inline="always")(function)))


def _cached(compiled: Any) -> Any:
    if not cast(Any, numba.config).DISABLE_JIT:
        cache, index = compiled._cache, cast(Any, _Index)  # numba has no types
        cache._cache_file = index(cache.cache_path, cache._impl.filename_base, compiled.py_func.__globals__)
    return compiled


class _Index(IndexDataCacheFile):
    """Index of the compiled forms of a kernel, valid for the sources of all kernels that it may call.

    Sources and constants are found when they are first needed: by then all modules are loaded.
    """

    _names: dict[str, Any]

    @property
    def _source_stamp(self) -> list[Any]:
        name = self._names["__name__"]
        if name not in _FOUND:
            _FOUND[name] = _sources(self._names)
        return _FOUND[name]

    @_source_stamp.setter
    def _source_stamp(self, names: dict[str, Any]) -> None:
        self._names = names


def _sources(names: dict[str, Any]) -> list[Any]:
    """File, size and time of the module with these names and of those whose kernels it has, and their constants."""
    modules, waiting = {names["__name__"]: names}, [names]
    while waiting:
        for value in waiting.pop().values():
            if isinstance(value, Dispatcher):
                others = value.py_func.__globals__
                if others["__name__"] not in modules:
                    modules[others["__name__"]] = others
                    waiting.append(others)
    stamps = []
    for name, module in sorted(modules.items()):
        found = os.stat(module["__file__"])
        constants = sorted((key, repr(v)) for key, v in module.items() if isinstance(v, int | float | tuple))
        stamps.append((name, found.st_mtime_ns, found.st_size, constants))
    return stamps
