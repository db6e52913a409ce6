"""BVH layouts for GPUs, converted from the CPU's wide tree, and their traversals."""
