"""How the kernels are compiled: by Numba, where it is installed."""

from collections.abc import Callable
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])


def jit(function: Function) -> Function:
    """The function as machine code, made when first called and built into what calls it.

    Without Numba the function itself: the module can then be read and imported, and NumbaPipeline
    refuses to run it, for it would take a thousand times longer.
    """
    return _compiled(function, cache=False)


def kept_on_disk(function: Function) -> Function:
    """The same for the outermost function, whose machine code is kept on disk beside its source.

    Numba compiles anew when that one file changes, and knows of no other. So the name under which
    the code is kept says what all files of this folder hold; it is not found by any other version.
    """
    sources = sorted(Path(__file__).parent.glob("*.py"))
    digest = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    function.__qualname__ = f"{function.__qualname__}_{digest[:12]}"
    try:
        return _compiled(function, cache=True)
    except RuntimeError:
        # neither the package nor the user's cache folder can be written: compiled in every process
        return _compiled(function, cache=False)


def _compiled(function: Function, *, cache: bool) -> Function:
    try:
        import numba
    except ImportError:
        return function
    njit: Any = numba.njit
    compiled: Function = njit(
        function,
        cache=cache,
        nogil=True,
        error_model="numpy",
        # arguments are tuples of arrays, which take longer to hand over than a timestep to compute
        forceinline=True,
        # no arrays are made, so none are counted; what would allocate does not compile
        _nrt=False,
    )
    return compiled
