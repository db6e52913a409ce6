"""The version of raystream, read by the build and by ``raystream.__version__``."""

__version__ = "0.1.0"
