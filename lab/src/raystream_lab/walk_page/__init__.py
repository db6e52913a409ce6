"""A page that plays rays' walks in a flat scene, kernel by kernel, for teaching."""

from raystream_lab.walk_page.flat_scene import FlatScene, Outline, prisms, teaching_scene
from raystream_lab.walk_page.page import page, write_page

__all__ = ["FlatScene", "Outline", "page", "prisms", "teaching_scene", "write_page"]
