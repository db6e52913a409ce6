"""CUDA driver errors explained, in a line each with what to do."""

from __future__ import annotations

import re
from collections.abc import Mapping
from types import MappingProxyType

#: The driver's error codes in messages of Numba and cuda.core.
_CODE = re.compile(r"CUDA_ERROR_([A-Z][A-Z_]*[A-Z])")

#: Messages of cuda.bindings and Numba about a function that the driver lacks.
_ABSENT = re.compile(r'Function "cu\w+" not found|Driver missing function')

_NO_DRIVER = "there is no NVIDIA driver"
_NEW_DRIVER = "install a newer one, or the cuda-toolkit of its version"
_LOST = "CUDA can no longer be used in this process, but CPU tracers can; start a new process"

#: Longest unknown message that is quoted; compilers' are much longer.
_MAX_LENGTH = 300

#: Explanations by error code.
_MEANINGS: Mapping[str, str] = MappingProxyType(
    {
        "NO_DEVICE": "there is no NVIDIA GPU that this process may use (CUDA_VISIBLE_DEVICES "
        "hides those that it does not list)",
        "STUB_LIBRARY": f"{_NO_DRIVER}, only the stub library of the toolkit",
        "UNSUPPORTED_PTX_VERSION": "the driver is older than the compiler that made the kernel; "
        + _NEW_DRIVER,
        "INSUFFICIENT_DRIVER": f"the driver is too old; {_NEW_DRIVER}",
        "SYSTEM_DRIVER_MISMATCH": "the driver's library and its kernel module have different "
        "versions; restart the machine after an update",
        "COMPAT_NOT_SUPPORTED_ON_DEVICE": "the driver is too old for this GPU's compatibility "
        f"package; {_NEW_DRIVER}",
        "OUT_OF_MEMORY": "there is no memory for it; trace a smaller scene, or fewer rays at once "
        "(rays_at_once)",
        "LAUNCH_OUT_OF_RESOURCES": "the kernel needs more registers than a block has",
        "LAUNCH_TIMEOUT": "it ran longer than allowed on a GPU that also drives a display, and "
        f"was stopped; trace fewer rays at once (rays_at_once). {_LOST}",
        "ILLEGAL_ADDRESS": f"it accessed an invalid address, and was stopped. {_LOST}",
        "MISALIGNED_ADDRESS": f"it accessed a misaligned address, and was stopped. {_LOST}",
        "LAUNCH_FAILED": f"it was stopped. {_LOST}",
        "ILLEGAL_INSTRUCTION": f"it was stopped. {_LOST}",
        "HARDWARE_STACK_ERROR": f"it was stopped. {_LOST}",
        "ECC_UNCORRECTABLE": f"the GPU's memory failed. {_LOST}",
        "CONTEXT_IS_DESTROYED": f"the device was reset. {_LOST}",
    }
)


def driver_code(error: BaseException) -> str:
    """The driver's code in an error, such as ``"OUT_OF_MEMORY"``, or an empty string."""
    found = _CODE.search(str(error))
    return found[1] if found else ""


def explain(error: BaseException) -> str:
    """Explain a driver error in a line."""
    text = " ".join(str(error).split()).rstrip(":. ")
    code = driver_code(error)
    if code in _MEANINGS:
        return f"{_MEANINGS[code]} (CUDA_ERROR_{code})"
    if "driver library cannot be found" in text:
        return _NO_DRIVER
    if _ABSENT.search(text):
        return f"the driver is too old; {_NEW_DRIVER} ({text})"
    if len(text) > _MAX_LENGTH:
        text = f"{text[:_MAX_LENGTH]}..."
    return text or type(error).__name__
