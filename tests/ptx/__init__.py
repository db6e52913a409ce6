"""A PTX interpreter, to test compiled kernels without a GPU."""
