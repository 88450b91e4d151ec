"""The compiler of runtime.native_kernels: Numba's, where it is installed."""

from collections.abc import Callable
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])


def jit(function: Function) -> Function:
    """The function as machine code, made when first called and kept on disk beside the source.

    Without Numba the function itself: the module can then be read and imported, and runtime.backend
    refuses to run it, for it would take a thousand times longer.
    """
    try:
        import numba
    except ImportError:
        return function
    njit: Any = numba.njit
    options = {
        "nogil": True,
        "error_model": "numpy",
        # arguments are tuples of arrays, which take longer to hand over than a tick to compute
        "forceinline": True,
        # no arrays are made, so none are counted; what would allocate does not compile
        "_nrt": False,
    }
    try:
        compiled: Function = njit(function, cache=True, **options)
    except RuntimeError:
        # neither the package nor the user's cache folder can be written: compiled in every process
        compiled = njit(function, **options)
    return compiled
