"""BVHs laid out for GPUs, made of the CPU's wide one, and their traversals."""
