"""Programs on CUDA: users' functions in kernels of their own, over rows that stay there."""

from raystream.cuda.programs.device_program import DeviceProgram
from raystream.cuda.programs.from_host import HostRays
from raystream.cuda.programs.queries import ProgramQueries
from raystream.cuda.programs.restrictions import reason_against

__all__ = ["DeviceProgram", "HostRays", "ProgramQueries", "reason_against"]
