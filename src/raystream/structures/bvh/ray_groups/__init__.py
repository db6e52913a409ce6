"""Groups of 16 rays: how they are loaded, their leaves and their queries."""
