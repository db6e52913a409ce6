import array

import numpy as np
import pytest

from raystream.core.rays import RayBatch


def test_leading_shapes_broadcast():
    batch = RayBatch(np.zeros(3), np.ones((4, 5, 3)), t_min=np.arange(5), t_max=[[1]] * 4)
    assert batch.shape == (4, 5)
    assert batch.origins.shape == (20, 3)
    np.testing.assert_array_equal(batch.t_min, np.tile(np.arange(5), 4))
    np.testing.assert_array_equal(batch.t_max, np.ones(20))
    assert RayBatch(np.zeros((4, 1, 3)), np.ones((1, 6, 3))).shape == (4, 6)
    assert RayBatch([0, 0, 0], [1, 1, 1]).shape == ()


@pytest.mark.parametrize(
    ("dtype", "kept"),
    [("f2", "f4"), ("f4", "f4"), (">f4", "f8"), ("f8", "f8"), ("i4", "f8"), ("u1", "f8")],
)
def test_dtypes(dtype, kept):
    batch = RayBatch(np.zeros((2, 3), dtype), np.ones((2, 3), dtype))
    assert batch.origins.dtype == np.dtype(kept)


def test_mixed_dtypes_keep_the_precise_one():
    batch = RayBatch(np.full((1, 3), 1e7 + 0.1), np.ones((1, 3), np.float32))
    assert batch.origins[0, 0] == 1e7 + 0.1


def test_no_copy_of_what_fits():
    origins = np.zeros((10, 3), np.float32)
    assert np.shares_memory(RayBatch(origins, origins).origins, origins)


class Exporter:
    """Exports by DLPack alone."""

    def __init__(self, values):
        self._array = np.asarray(values)

    def __dlpack__(self, **options):
        return self._array.__dlpack__(**options)

    def __dlpack_device__(self):
        return self._array.__dlpack_device__()


class OnGpu:
    def __dlpack__(self, **options):
        raise AssertionError("must not be asked for")

    def __dlpack_device__(self):
        return (2, 0)


class CudaArray:
    __cuda_array_interface__ = {"shape": (1, 3)}  # noqa: RUF012


class Interface:
    def __init__(self, values):
        self._array = np.asarray(values)
        self.__array_interface__ = self._array.__array_interface__


@pytest.mark.parametrize("wrap", [Exporter, Interface, memoryview, np.asarray])
def test_array_likes(wrap):
    values = np.arange(6.0).reshape(2, 3)
    np.testing.assert_array_equal(RayBatch(wrap(values), wrap(values)).origins, values)


def test_buffers():
    assert RayBatch(array.array("d", [1, 2, 3]), [1, 0, 0]).origins.tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("values", [OnGpu(), CudaArray()])
def test_gpu_arrays_are_refused_with_advice(values):
    with pytest.raises(TypeError, match=r"origins: .*on a GPU.*copy"):
        RayBatch(values, [1, 0, 0])


@pytest.mark.parametrize(
    ("arguments", "error", "words"),
    [
        (([0, 0], [1, 0, 0]), ValueError, "origins: expected shape"),
        ((0.0, [1, 0, 0]), ValueError, "origins: expected shape"),
        (([0, 0, 0], np.ones((2, 4))), ValueError, "directions: expected shape"),
        ((np.zeros((2, 3)), np.ones((3, 3))), ValueError, "do not broadcast"),
        (([0, 0, 0], [1, 0, 0], [0, 1]), ValueError, "t_min: shape"),
        ((["a", "b", "c"], [1, 0, 0]), TypeError, "origins: expected real"),
        (([0, 0, 0], [1j, 0, 0]), TypeError, "directions: expected real"),
        (([0, 0, 0], [1, 0, 0], 0, "far"), TypeError, "t_max: expected real"),
        (([0, 0, 0], [[1, 0, 0], [1, 0]]), TypeError, "directions: cannot be read"),
        (([0, 0, 0], [None, 0, 0]), TypeError, "directions: expected real"),
    ],
)
def test_bad_arguments_are_named(arguments, error, words):
    with pytest.raises(error, match=words):
        RayBatch(*arguments)
