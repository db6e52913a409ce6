"""A machine that runs PTX, to see what compilers make of kernels where no GPU is."""
