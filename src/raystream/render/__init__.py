"""Renderers: lists of stages over streams of paths; sums of samples, colour encoding, images.

The room is callable: ``raystream.render(scene)`` is `raystream.render.picture.render`. (A
package cannot have a function and a subpackage of one name side by side: importing the one
would hide the other.)
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import Any

from raystream.render.image import Image
from raystream.render.picture import MODES, render

__all__ = ["MODES", "Image", "render"]


class _CallableRoom(ModuleType):
    def __call__(self, *arguments: Any, **options: Any) -> Image:
        return render(*arguments, **options)

    def __reduce__(self) -> tuple[Any, ...]:  # so that pools of processes can be given it
        return importlib.import_module, (self.__name__,)


_CallableRoom.__call__.__doc__ = render.__doc__
_CallableRoom.__call__.__wrapped__ = render  # type: ignore[attr-defined]
sys.modules[__name__].__class__ = _CallableRoom
