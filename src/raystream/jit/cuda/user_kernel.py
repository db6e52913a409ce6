"""UserKernel: a kernel around a user's function, if that can run on the device."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core.errors import NumbaError

from raystream.jit.cpu import FLAGS, compiled
from raystream.jit.cuda.arguments import kind_of, type_of
from raystream.jit.cuda.compiler import Capability, Compiled, compile_function
from raystream.jit.cuda.range_kernel import RangeKernel
from raystream.jit.cuda.simulation import is_simulated
from raystream.jit.cuda.user_checks import CpuOnlyError, check_options

#: Numba's name of an exception's data in compiled code.
_EXCEPTION = "picklebuf"

#: Options that CUDA's compiler ignores or interprets in another way.
_OPTIONS = {name: FLAGS[name] for name in ("error_model", "fastmath", "boundscheck")}

#: Longest compiler message that is quoted.
_MOST_LETTERS = 200


class UserKernel(RangeKernel):
    """A range kernel around a user's function; see `RangeKernel`.

    Parameters
    ----------
    function : callable
        As of `RangeKernel`.
    user : callable
        The user's function in it.
    """

    def __init__(self, function: Callable[..., Any], user: Callable[..., Any]) -> None:
        # Not cached on disk: cached code does not show whether it raises an exception.
        super().__init__(compiled(getattr(function, "py_func", function)))
        self._user = user
        self._compiled: dict[Any, Compiled] = {}
        self._reasons: dict[Any, str | None] = {}

    def compiled(self, arguments: tuple[Any, ...], capability: Capability) -> Compiled:
        """PTX for arguments of such types; see `RangeKernel.compiled`.

        Raises
        ------
        CpuOnlyError
            If it does what only the CPU supports, or would have other bits than on the CPU.
        """
        key = capability, kind_of(arguments)
        if key not in self._compiled:
            types = type_of(np.uint64(0)), type_of(arguments)
            self._compiled[key] = compile_function(self._run, types, capability, is_checked=True)
        return self._compiled[key]

    def reason_against(self, arguments: tuple[Any, ...], capability: Capability) -> str | None:
        """Why it must run on the CPU; None if the device can run it."""
        key = capability, kind_of(arguments)
        if key not in self._reasons:
            self._reasons[key] = self._find_reason(arguments, capability)
        return self._reasons[key]

    def _find_reason(self, arguments: tuple[Any, ...], capability: Capability) -> str | None:
        try:
            check_options(self._user, _OPTIONS)
            if is_simulated():
                self._check_on_host(arguments)
            else:
                self.compiled(arguments, capability)
        except CpuOnlyError as error:
            return str(error)
        except NumbaError as error:
            lines = [line for line in str(error).splitlines() if line.strip()]
            return f"CUDA's compiler does not support it: {' '.join(lines)[:_MOST_LETTERS]}"
        except Exception as error:  # from inside the compiler
            return f"CUDA's compiler does not support it: {type(error).__name__} {error}"
        return None

    def _check_on_host(self, arguments: tuple[Any, ...]) -> None:
        """In the simulator: compile it for the CPU, and check that it raises nothing there."""
        dispatcher: Any = self.function
        types = tuple(map(type_of, (np.uint64(0), *arguments)))
        dispatcher.compile(types)
        if _EXCEPTION in dispatcher.inspect_llvm(types):
            raise CpuOnlyError("it may raise an exception")
