"""Sample numbers for renderers: samplers, the choice of one, and maps of the unit square."""
