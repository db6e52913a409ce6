"""glTF extensions: those that are supported, and what happens to the others."""

from __future__ import annotations

from collections.abc import Iterable

#: Read, or without effect on images.
_SUPPORTED = frozenset(
    {
        "EXT_mesh_gpu_instancing",
        "EXT_meshopt_compression",
        "EXT_texture_webp",
        "KHR_draco_mesh_compression",
        "KHR_lights_punctual",
        "KHR_materials_clearcoat",
        "KHR_materials_emissive_strength",
        "KHR_materials_ior",
        "KHR_materials_sheen",
        "KHR_materials_specular",
        "KHR_materials_transmission",
        "KHR_materials_unlit",
        "KHR_materials_variants",  # the default variant
        "KHR_materials_volume",
        "KHR_mesh_quantization",
        "KHR_meshopt_compression",
        "KHR_texture_transform",
        "KHR_xmp_json_ld",
    }
)

#: Compressions of buffer views. Files that do not require them have the same data uncompressed.
COMPRESSED = frozenset({"EXT_meshopt_compression", "KHR_meshopt_compression"})

#: Their materials are shown without them.
_OF_MATERIALS = "KHR_materials_"


def can_read(name: str) -> bool:
    """Whether a file that requires an extension can be read without misreading its geometry."""
    return name in _SUPPORTED or name.startswith(_OF_MATERIALS)


def lost_extensions(used: Iterable[str]) -> list[str]:
    """Those of a file's extensions that are ignored, although they may affect images."""
    return sorted({name for name in used if name not in _SUPPORTED})
