"""Pages that trace rays on the visitor's own GPU, by WebGPU and the shaders of `graphics`."""

from raystream.web.export import export_page

__all__ = ["export_page"]
