"""Ray and hit files larger than memory: Zarr stores, queried block by block and resumable.

``pip install raystream[zarr]``. `query_zarr` reads one block of rays while another is traced and
the hits of a third are written. It records its progress, so that a query interrupted at any
moment resumes and produces the same bits.
"""

from raystream.ray_files.errors import StoreWriteError, require_zarr
from raystream.ray_files.journal import journal_path
from raystream.ray_files.query import QUERIES, QueryReport, query_zarr

__all__ = [
    "QUERIES",
    "QueryReport",
    "StoreWriteError",
    "journal_path",
    "query_zarr",
    "require_zarr",
]
