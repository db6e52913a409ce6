"""CheckedKernel: somebody else's function in a kernel, if it is one for the device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core.errors import NumbaError

from raystream.jit.cpu import FLAGS, compiled
from raystream.jit.cuda.arguments import kind_of, type_of
from raystream.jit.cuda.compiler import Capability, Compiled, compile_function
from raystream.jit.cuda.exact import UnfitError, check_options
from raystream.jit.cuda.kernels import RangeKernel
from raystream.jit.cuda.simulation import is_simulated

__all__ = ["CheckedKernel"]

#: What Numba calls an exception that compiled code holds ready.
_EXCEPTION = "picklebuf"

#: Options that CUDA's compiler would take otherwise, or not at all.
_OPTIONS = {name: FLAGS[name] for name in ("error_model", "fastmath", "boundscheck")}

#: Of a compiler's message.
_MOST_LETTERS = 200


class CheckedKernel(RangeKernel):
    """A range kernel around a user's function; see `RangeKernel`.

    Parameters
    ----------
    function : callable
        As of `RangeKernel`.
    user : callable
        The user's function in it.
    """

    def __init__(self, function: Callable[..., Any], user: Callable[..., Any]) -> None:
        # What comes from the disk does not show whether it raises anything.
        super().__init__(compiled(getattr(function, "py_func", function)))
        self._user = user
        self._compiled: dict[Any, Compiled] = {}
        self._reasons: dict[Any, str | None] = {}

    def compiled(self, arguments: tuple[Any, ...], capability: Capability) -> Compiled:
        """PTX for arguments of such types; see `RangeKernel.compiled`.

        Raises
        ------
        UnfitError
            If it does what only the CPU can do, or does with other bits.
        """
        key = capability, kind_of(arguments)
        if key not in self._compiled:
            types = type_of(np.uint64(0)), type_of(arguments)
            self._compiled[key] = compile_function(self._run, types, capability, is_checked=True)
        return self._compiled[key]

    def reason_against(self, arguments: tuple[Any, ...], capability: Capability) -> str | None:
        """Why it has to stay on the CPU; None if it runs on the device."""
        key = capability, kind_of(arguments)
        if key not in self._reasons:
            self._reasons[key] = self._look(arguments, capability)
        return self._reasons[key]

    def _look(self, arguments: tuple[Any, ...], capability: Capability) -> str | None:
        try:
            check_options(self._user, _OPTIONS)
            if is_simulated():
                self._check_on_host(arguments)
            else:
                self.compiled(arguments, capability)
        except UnfitError as error:
            return str(error)
        except NumbaError as error:
            lines = [line for line in str(error).splitlines() if line.strip()]
            return f"CUDA's compiler does not know it: {' '.join(lines)[:_MOST_LETTERS]}"
        except Exception as error:  # from inside the compiler
            return f"CUDA's compiler does not know it: {type(error).__name__} {error}"
        return None

    def _check_on_host(self, arguments: tuple[Any, ...]) -> None:
        """In the simulator: whether it compiles for the CPU, and raises nothing there."""
        dispatcher: Any = self.function
        types = tuple(map(type_of, (np.uint64(0), *arguments)))
        dispatcher.compile(types)
        if _EXCEPTION in dispatcher.inspect_llvm(types):
            raise UnfitError("it may raise an exception")
