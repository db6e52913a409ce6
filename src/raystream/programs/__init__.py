"""Programs: users' functions that run at hits, and filter hits or end rays.

They run over the hits of queries, a bounded number at a time, on every structure and machine.
"""

from raystream.programs.decisions import Decision
from raystream.programs.filters import Bound
from raystream.programs.hits import Hit

__all__ = ["Bound", "Decision", "Hit"]
