"""Open Zarr stores for reading."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any

from raystream.core.errors import FileFormatError, RaystreamError
from raystream.ray_files.errors import require_zarr

#: Metadata file of an array in Zarr v3 and v2.
_ARRAY_FILES = ("zarr.json", ".zarray")


def open_arrays(path: str) -> dict[str, Any]:
    """Open the arrays of a group for reading.

    Parameters
    ----------
    path : str
        A folder, or a ``.zip`` file.

    Returns
    -------
    dict of str to zarr.Array
        All arrays directly in the group, by name; nested groups are ignored.

    Raises
    ------
    FileFormatError
        If the store does not exist or is damaged.
    """
    if not os.path.exists(path):
        raise FileFormatError(path, "no such file or folder")
    require_zarr()
    import zarr
    from zarr.storage import LocalStore, ZipStore

    store: Any
    try:
        if os.path.isfile(path):
            with zipfile.ZipFile(path) as archive:
                names = _array_names(zipfile.Path(archive))
            store = ZipStore(path, mode="r")
        else:
            names = _array_names(Path(path))
            store = LocalStore(path, read_only=True)
        group = zarr.open_group(store, mode="r", use_consolidated=False)
        nodes: dict[str, Any] = {name: group[name] for name in names}
        return {name: node for name, node in nodes.items() if isinstance(node, zarr.Array)}
    except (RaystreamError, MemoryError):
        raise
    except FileNotFoundError:
        raise FileFormatError(path, "is not a Zarr store") from None
    except zipfile.BadZipFile as error:
        raise FileFormatError(path, f"is not a complete .zip file ({error})") from None
    except Exception as error:  # damaged metadata can raise anything in Zarr
        reason = str(error).partition("\n")[0] or type(error).__name__
        raise FileFormatError(path, f"cannot be read as a Zarr store ({reason:.200})") from error


def _array_names(group: Path | zipfile.Path) -> list[str]:
    """List the folders that hold an array's metadata; Zarr skips those it does not recognize."""
    return sorted(
        entry.name
        for entry in group.iterdir()
        if any((entry / file).exists() for file in _ARRAY_FILES)
    )
