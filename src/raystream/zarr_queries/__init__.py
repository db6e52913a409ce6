"""Queries of rays in Zarr stores: block by block, in bounded memory, and to be gone on with.

``pip install raystream[zarr]``. `query_zarr` reads a block of rays while another is traced and
the hits of a third are written, and records what is done, so that a query that was broken off
at any moment goes on to the same bits.
"""

from raystream.zarr_queries.errors import StoreWritingError, require_zarr
from raystream.zarr_queries.progress_file import progress_beside
from raystream.zarr_queries.query import QUERIES, QueryReport, query_zarr

__all__ = [
    "QUERIES",
    "QueryReport",
    "StoreWritingError",
    "progress_beside",
    "query_zarr",
    "require_zarr",
]
