"""The graph of sectors: boxes that tile space, each linked to those behind its faces."""
