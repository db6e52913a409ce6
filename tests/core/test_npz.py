import io
import pickle
import struct
import zipfile

import numpy as np
import pytest

from raystream.core.errors import FileFormatError
from raystream.core.npz import read_npz, write_npz


def test_round_trip(tmp_path):
    arrays = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(True), "c": np.zeros((0, 3), "i4")}
    path = tmp_path / "x.npz"
    write_npz(path, arrays)
    back = read_npz(path)
    assert back.keys() == arrays.keys()
    for name, array in arrays.items():
        assert back[name].dtype == array.dtype
        np.testing.assert_array_equal(back[name], array)


def test_compressed_and_fortran_and_foreign_byte_order(tmp_path):
    path = tmp_path / "x.npz"
    fortran = np.asfortranarray(np.arange(12).reshape(3, 4))
    np.savez_compressed(path, f=fortran, big=np.arange(3, dtype=">f4"))
    back = read_npz(path)
    np.testing.assert_array_equal(back["f"], fortran)
    assert back["big"].dtype == np.float32
    assert back["big"].tolist() == [0, 1, 2]


def test_writing_replaces_as_a_whole(tmp_path, monkeypatch):
    path = tmp_path / "x.npz"
    write_npz(path, {"a": np.zeros(3)})
    before = path.read_bytes()

    def fail(*arguments, **options):
        raise OSError("no space left")

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(OSError, match="no space"):
        write_npz(path, {"a": np.ones(3)})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]
    with pytest.raises(ValueError, match=r"must end in \.npz"):
        write_npz(tmp_path / "x.txt", {})


def archive_of(path, content: bytes):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a.npy", content)
    return path


def npy_header(shape: str, dtype: str = "<f8") -> bytes:
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text.encode()


def test_claims_are_checked_before_anything_is_allocated(tmp_path):
    for shape in ("(10**15,)", "(1000000000000000,)", "(3,)", "(2, -1)", "'x'"):
        path = archive_of(tmp_path / "x.npz", npy_header(shape) + b"\0" * 16)
        with pytest.raises(FileFormatError, match=r"x\.npz"):
            read_npz(path)


def test_nothing_is_unpickled(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (pytest.fail, ("unpickled",))

    path = archive_of(tmp_path / "x.npz", npy_header("(1,)", "|O") + pickle.dumps([Bomb()]))
    with pytest.raises(FileFormatError, match="expected numbers"):
        read_npz(path)


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04" + b"\0" * 50])
def test_foreign_files(tmp_path, content):
    path = tmp_path / "x.npz"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match=r"x\.npz: is "):
        read_npz(path)


def test_missing_files_and_folders(tmp_path):
    with pytest.raises(FileFormatError, match="no such file"):
        read_npz(tmp_path / "none.npz")
    with pytest.raises(FileFormatError, match="folder"):
        read_npz(tmp_path)


def test_every_damage_is_one_clear_error(tmp_path):
    """Cut off anywhere, or with any byte changed: an error, or numbers, never a crash."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, a=np.arange(50.0), b=np.arange(9, dtype=np.int32).reshape(3, 3))
    whole = buffer.getvalue()
    rng = np.random.default_rng(0)
    path = tmp_path / "x.npz"
    lines = []
    for k in range(300):
        damaged = bytearray(whole)
        if k % 2:
            del damaged[rng.integers(0, len(whole)) :]
        else:
            damaged[rng.integers(0, len(whole))] ^= 1 << rng.integers(0, 8)
        path.write_bytes(damaged)
        try:
            read_npz(path)
        except FileFormatError as error:
            lines.append(str(error).count("\n"))
    assert len(lines) > 200
    assert not any(lines)
