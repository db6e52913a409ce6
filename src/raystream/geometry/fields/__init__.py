"""Height fields: their trees, and where rays meet their cells."""
