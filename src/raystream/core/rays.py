"""RayBatch: origins, directions and intervals from any array library, validated, without a copy."""

from __future__ import annotations

import contextlib
import enum
import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from raystream.core.libraries import advice_about

#: DLPack device types whose memory NumPy can read: kDLCPU, kDLCUDAHost, kDLROCMHost.
_HOST_DEVICE_TYPES = (1, 3, 11)


class RayStatus(enum.IntEnum):
    """Whether a ray was traced.

    Attributes
    ----------
    VALID
        It was traced.
    INVALID
        It was not traced, and misses: its direction is zero, or one of its numbers is NaN,
        infinite or, for a coordinate of the origin, beyond 2**200.
    """

    VALID = 0
    INVALID = 1


#: The same for kernels.
VALID, INVALID = np.uint8(RayStatus.VALID), np.uint8(RayStatus.INVALID)


class RayArrays(NamedTuple):
    """Rays as the caller gave them, of which at least one array is on a GPU; nothing is checked.

    `worlds` is None in a scene whose instances are in no worlds, and `mask` for all bits.
    """

    origins: Any
    directions: Any
    t_min: Any
    t_max: Any
    worlds: Any = None
    mask: Any = None

    def is_on_gpu(self) -> bool:
        """Whether at least one of the arrays says that it is in a GPU's memory."""
        return any(map(is_on_gpu, self))


class RayBatch:
    """Rays of any leading shape, flattened.

    Parameters
    ----------
    origins, directions : array_like of shape (..., 3), real
        World space; the two shapes are broadcast against each other. Directions need not be
        unit length.
    t_min, t_max : float or array_like that broadcasts to the leading shape
        Closed interval, in direction lengths; rounded to float32.

    Attributes
    ----------
    shape : tuple of int
        The leading shape.
    origins, directions : ndarray of shape (N, 3), float32 or float64
        Views of the caller's arrays where that is possible.
    t_min, t_max : ndarray of shape (N,), float32, or float64 of rays in float64
    limits : tuple of two ndarray of shape (N,) or (1,), float32
        The same, not repeated where one value serves all rays.
    near : ndarray of shape (N,), int32, or None
        The number of a sector near the start of each ray, -1 for none; see `Tracer.first_hit`.
    worlds : ndarray of shape (N,), int32, or None
        The world of each ray, in a scene whose instances have worlds; see `Scene.instances`.
    masks : ndarray of shape (N,) or (1,), uint32, or None
        The mask of each ray; None for all bits. See `Tracer.first_hit`.

    Raises
    ------
    ValueError
        If shapes disagree.
    TypeError
        If an array does not hold real numbers.
    """

    #: Bytes per ray of copies that are made of the caller's arrays.
    copied_bytes: ClassVar[int] = 0

    shape: tuple[int, ...]
    origins: NDArray[Any]
    directions: NDArray[Any]
    near: NDArray[np.int32] | None = None
    worlds: NDArray[np.int32] | None = None
    masks: NDArray[np.uint32] | None = None

    def __init__(
        self, origins: Any, directions: Any, t_min: Any = 0.0, t_max: Any = np.inf
    ) -> None:
        origins = as_vectors("origins", origins)
        directions = as_vectors("directions", directions)
        shape = origins.shape
        if shape != directions.shape:
            try:
                shape = np.broadcast_shapes(shape, directions.shape)
            except ValueError:
                raise ValueError(
                    f"origins and directions: shapes {origins.shape} and {directions.shape} "
                    "do not broadcast against each other"
                ) from None
        self.shape = shape[:-1]
        self._count = math.prod(self.shape)
        self.origins = _rows(origins, shape)
        self.directions = _rows(directions, shape)
        self.limits = self._limits(t_min, t_max, np.float32)

    def _limits(
        self, t_min: Any, t_max: Any, number: type[np.floating[Any]]
    ) -> tuple[NDArray[Any], NDArray[Any]]:
        """The limits, rounded to a type of number."""
        low = _limit("t_min", t_min, self.shape, number)
        return low, _limit("t_max", t_max, self.shape, number)

    @property
    def exact_limits(self) -> Sequence[NDArray[Any]]:
        """The limits as single rays are traced with them: `limits`, or the same in float64."""
        return self.limits

    @property
    def t_min(self) -> NDArray[Any]:
        """Where each ray's interval begins."""
        return np.broadcast_to(self.exact_limits[0], self._count)

    @property
    def t_max(self) -> NDArray[Any]:
        """Where each ray's interval ends."""
        return np.broadcast_to(self.exact_limits[1], self._count)

    def __len__(self) -> int:
        return self._count


def as_vectors(name: str, values: Any) -> NDArray[Any]:
    """View values as an array of shape (..., 3); for errors, see `RayBatch`."""
    array = as_real_array(name, values)
    if array.ndim == 1 and array.size == 0:
        array = array.reshape(0, 3)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ValueError(f"{name}: expected shape (..., 3), got {array.shape}")
    return array


def _rows(array: NDArray[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """Broadcast to the shape, as rows of 3; one vector for all rays is not copied."""
    if array.shape != shape:
        if array.size == 3:
            return np.broadcast_to(array.reshape(1, 3), (math.prod(shape[:-1]), 3))
        array = np.broadcast_to(array, shape)
    return array if array.ndim == 2 else array.reshape(-1, 3)


def _constant(value: float, number: type[np.floating[Any]]) -> NDArray[Any]:
    array = np.full(1, value, number)
    array.flags.writeable = False
    return array


#: The default limits, by type of number and value, made once: tracing a small batch takes less time
#: than allocating them.
DEFAULT_LIMITS = {
    number: {value: _constant(value, number) for value in (0.0, math.inf)}
    for number in (np.float32, np.float64)
}


def _limit(
    name: str, values: Any, shape: tuple[int, ...], number: type[np.floating[Any]]
) -> NDArray[Any]:
    if type(values) is float and values in DEFAULT_LIMITS[number]:
        return DEFAULT_LIMITS[number][values]
    with np.errstate(over="ignore"):
        array = as_real_array(name, values).astype(number, copy=False)
    if array.ndim == 0:
        return array.reshape(1)
    return broadcast(name, array, shape).reshape(-1)


def as_host_array(name: str, values: Any) -> NDArray[Any]:
    """View an array-like object as a NumPy array.

    Accepts NumPy arrays, everything that `numpy.asarray` takes (sequences,
    ``__array_interface__``, ``__array__``, buffers) and DLPack exporters on the CPU, such as
    PyTorch and JAX arrays.

    Parameters
    ----------
    name : str
        Name of the argument, for the error.
    values : array_like

    Raises
    ------
    TypeError
        If the array is on a GPU, or cannot be read as an array.
    """
    if isinstance(values, np.ndarray):
        return values
    if is_on_gpu(values):
        raise TypeError(
            f"{name}: the array is on a GPU, where only queries of device='cuda' without counters "
            "can read it; copy it to the host first (.get(), .cpu(), "
            ".host() or copy_to_host())"
        )
    if hasattr(values, "__dlpack__") and hasattr(values, "__dlpack_device__"):
        try:
            return np.from_dlpack(values)
        except (BufferError, RuntimeError, TypeError):
            pass  # such as a PyTorch tensor that requires grad: asarray has the better error
    try:
        return np.asarray(values)
    except Exception as error:
        reason = f"{name}: cannot be read as an array ({error}){advice_about(values)}"
        raise TypeError(reason) from error


def is_on_gpu(values: Any) -> bool:
    """Whether an array is in a GPU's memory.

    It has a DLPack device that NumPy cannot read, or ``__cuda_array_interface__``.
    """
    if isinstance(values, np.ndarray | float | int):
        return False
    if hasattr(values, "__dlpack_device__"):
        try:
            if int(values.__dlpack_device__()[0]) not in _HOST_DEVICE_TYPES:
                return True
        except Exception:  # an exporter without a device: see the interface below
            pass
    try:
        return hasattr(values, "__cuda_array_interface__")
    except Exception:  # PyTorch's, of a tensor that requires grad
        return False


def as_real_array(name: str, values: Any) -> NDArray[Any]:
    """View values as an array of real numbers: float32 and float16 as float32, others as float64.

    Raises
    ------
    TypeError
        If the values are not real numbers, or not on the CPU.
    """
    array = as_host_array(name, values)
    if array.dtype == np.float32 and array.dtype.isnative:
        return array
    if array.dtype.kind not in "fiu":
        raise TypeError(f"{name}: expected real numbers, got dtype {array.dtype}")
    if array.dtype == np.float16:
        return array.astype(np.float32)
    return array.astype(np.float64, copy=False)


def as_integers(name: str, values: Any) -> NDArray[Any]:
    """View values as an array of integers; an empty one may be of any type.

    Raises
    ------
    TypeError
        If the values are not integers, or not on the CPU.
    """
    array = as_host_array(name, values)
    if array.dtype.kind in "iu":
        return array
    if array.size:
        raise TypeError(f"{name}: expected integers, got {array.dtype}")
    return array.astype(np.int64)


def broadcast(
    name: str, array: NDArray[Any], shape: tuple[int, ...], whose: str = "the rays' shape"
) -> NDArray[Any]:
    """View an array in another shape, as `numpy.broadcast_to`.

    Raises
    ------
    ValueError
        If it does not broadcast to the shape; `whose` says what has it.
    """
    try:
        return np.broadcast_to(array, shape)
    except ValueError:
        raise ValueError(
            f"{name}: shape {array.shape} does not broadcast to {whose} {shape}"
        ) from None


#: Types of numbers that `float` converts as NumPy does.
_PLAIN_NUMBERS = frozenset((float, int))


def as_vector(name: str, values: Any) -> Sequence[float]:
    """Three real numbers as Python's: the same numbers that `RayBatch` has of them.

    Parameters
    ----------
    name : str
        Name of the argument, for the error.
    values : array_like of shape (3,), real

    Returns
    -------
    sequence of three float
        The values themselves, if they are a tuple or list of floats.

    Raises
    ------
    ValueError
        If the shape is not (3,).
    TypeError
        If the values are not real numbers, or not on the CPU.
    """
    kind = type(values)
    if (kind is tuple or kind is list) and len(values) == 3:
        x, y, z = values
        if type(x) is float and type(y) is float and type(z) is float:
            return (x, y, z)
        if {type(x), type(y), type(z)} <= _PLAIN_NUMBERS:
            with contextlib.suppress(OverflowError):  # of an integer: the error is below
                return (float(x), float(y), float(z))
    array = as_real_array(name, values)
    if array.shape != (3,):
        raise ValueError(f"{name}: expected shape (3,), got {array.shape}")
    return array.tolist()


def as_number(name: str, value: Any) -> float:
    """One real number as Python's; for errors, see `as_vector`."""
    if type(value) is int:
        with contextlib.suppress(OverflowError):
            return float(value)
    array = as_real_array(name, value)
    if array.ndim:
        raise ValueError(f"{name}: expected one number, got shape {array.shape}")
    return float(array)
