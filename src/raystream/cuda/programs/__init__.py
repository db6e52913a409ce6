"""Programs on CUDA: users' functions in kernels of their own, over hits in device memory."""

from raystream.cuda.programs.restrictions import reason_against

__all__ = ["reason_against"]
