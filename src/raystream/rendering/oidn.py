"""Open Image Denoise: Intel's denoising neural network, through the package pyoidn.

References
----------
Áfra, "Intel Open Image Denoise", https://www.openimagedenoise.org.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raystream.core.errors import RaystreamError
from raystream.jit.threads import thread_count
from raystream.rendering.guide_layers import Layers, finite, guide_layer

#: The command that installs it.
OIDN_REMEDY = "pip install 'raystream[denoise]'"


@cache
def has_oidn() -> bool:
    """Whether Open Image Denoise is installed, and runs on this processor."""
    try:
        import pyoidn

        return bool(pyoidn.Device.is_cpu_available())
    except (ImportError, OSError):  # the package, or a library that it loads
        return False


def filter_with_oidn(
    layers: Layers, light: NDArray[np.float32], is_fast: bool = False
) -> NDArray[np.float32]:
    """Filter the light of an image with Open Image Denoise, on the CPU.

    Parameters
    ----------
    layers : mapping of str to ndarray
        Of the image; ``"albedo"`` and ``"normal"`` are guides: both, albedo alone, or none.
    light : ndarray of shape (H, W, 3), float32
        Linear RGB without emission, finite; negative values count as 0.
    is_fast : bool
        Whether to use a smaller network.

    Returns
    -------
    ndarray of shape (H, W, 3), float32
        The change of light.

    Raises
    ------
    ImportError
        If it is not installed.
    ValueError
        If a layer has the wrong shape.
    RaystreamError
        If it fails.
    """
    if not has_oidn():
        raise ImportError(f"method 'oidn' needs Open Image Denoise: {OIDN_REMEDY}")
    planes = {"color": np.maximum(light, 0.0), "output": np.empty_like(light)}
    if "albedo" in layers:
        planes["albedo"] = np.clip(
            finite(guide_layer(layers, "albedo", light.shape, 0.0)), 0.0, 1.0
        )
        if "normal" in layers:
            planes["normal"] = np.clip(
                finite(guide_layer(layers, "normal", light.shape, 0.0)), -1.0, 1.0
            )
    _run(planes, is_fast)
    return planes["output"] - light


def _run(planes: dict[str, NDArray[np.float32]], is_fast: bool) -> None:
    """Run its filter for rendered images; ``planes["output"]`` is written."""
    import pyoidn

    with pyoidn.Device(pyoidn.OIDN_DEVICE_TYPE_CPU) as device:
        _check(device)
        device.set_int("numThreads", thread_count())
        device.set_bool("setAffinity", False)  # other threads of this process use the cores, too
        device.commit()
        _check(device)
        neural = pyoidn.Filter(device, pyoidn.OIDN_FILTER_TYPE_RT)
        try:  # its context manager would hide errors
            for name, plane in planes.items():
                neural.set_image(name, plane, pyoidn.OIDN_FORMAT_FLOAT3)
            neural.set_bool("hdr", True)
            if is_fast:
                neural.set_int("quality", pyoidn.OIDN_QUALITY_FAST)
            neural.commit()
            neural.execute()
            _check(device)
        finally:
            neural.release()


def _check(device: Any) -> None:
    message = device.get_error()
    if message is not None:
        raise RaystreamError(f"Open Image Denoise failed: {message}")
