"""The experiments of the Rayforce poster of 2013: render modes, multi-hit, and cost per ray."""
