"""Programs: users' functions that run at hits, and decide what becomes of rays and hits.

They run on the rows that a tracer's queries give, a bounded number of them at a time: on every
structure and machine alike.
"""

from raystream.programs.decisions import Decision
from raystream.programs.filters import Bound
from raystream.programs.hits import Hit

__all__ = ["Bound", "Decision", "Hit"]
