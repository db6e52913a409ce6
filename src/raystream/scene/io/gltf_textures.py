"""glTF textures: images of materials, with their samplers and coordinates."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from raystream.scene.io.gltf_file import GltfFile, Node
from raystream.scene.io.gltf_texcoords import Texcoords, shared_texcoords
from raystream.scene.io.partial import warn_partial
from raystream.scene.io.text import shown
from raystream.scene.texture import Affine, Texture, Wrap, Wraps

_REPEAT = 10497

#: Behaviour outside [0, 1] by ``wrapS`` and ``wrapT``; unknown ones repeat.
_WRAPS: dict[int, Wrap] = {33071: "clamp", 33648: "mirror", _REPEAT: "repeat"}


class TextureReader:
    """Makes textures, one per image, behaviour outside [0, 1] and transform.

    Parameters
    ----------
    file : GltfFile
    """

    def __init__(self, file: GltfFile) -> None:
        self.file = file
        self._missing: list[str] = []
        self._left_out: Counter[str] = Counter()
        self._made: dict[tuple[int, Wraps, Affine | None], Texture | None] = {}
        self._alphas: dict[int, Texture] = {}

    def textures(self, uses: Mapping[str, Node]) -> tuple[dict[str, Texture], Texcoords]:
        """Make the textures of a material.

        Parameters
        ----------
        uses : mapping of str to dict
            The file's ``...Texture`` entries by role, the most important first; empty for none.

        Returns
        -------
        textures : dict of str to Texture
            By role.
        texcoords : Texcoords
            Of the meshes with this material.
        """
        places = {role: Texcoords.of(self.file, use) for role, use in uses.items() if use}
        shared = shared_texcoords(places)
        found: dict[str, Texture] = {}
        for role, place in places.items():
            if place.number != shared.number:
                self._left_out[f"for {role}, with their own texture coordinates"] += 1
                continue
            texture = self._texture(uses[role], place.seen_from(shared))
            if texture is not None:
                found[role] = texture
        return found, shared

    def leave_out(self, name: str) -> None:
        """Count a ``...Texture`` entry that is not supported."""
        self._left_out[name] += 1

    def alpha(self, texture: Texture) -> Texture:
        """Return the alpha channel of a texture; cached."""
        if id(texture) not in self._alphas:
            self._alphas[id(texture)] = texture.alpha()
        return self._alphas[id(texture)]

    def report(self) -> None:
        """Warn about missing images, and about textures that are not supported."""
        if self._missing:
            warn_partial(self.file.path, f"images not found: {', '.join(self._missing[:5])}")
        if self._left_out:
            counts = (f"{count:,} {name}" for name, count in self._left_out.items())
            warn_partial(self.file.path, f"textures left out: {', '.join(counts)}")

    def _texture(self, use: Node, transform: Affine | None) -> Texture | None:
        file = self.file
        entry = file.entry("textures", file.integer(use, "index"))
        webp = file.extension(entry, "EXT_texture_webp")
        image = file.index(entry, "source")
        image = file.index(webp, "source") if webp else image
        if image is None:
            return None
        sampler = file.index(entry, "sampler")
        modes = {} if sampler is None else file.entry("samplers", sampler)
        along_u, along_v = (
            _WRAPS.get(file.integer(modes, name, _REPEAT), "repeat") for name in ("wrapS", "wrapT")
        )
        key = (image, (along_u, along_v), transform)
        if key not in self._made:
            self._made[key] = self._image(*key)
        return self._made[key]

    def _image(self, index: int, wrap: Wraps, transform: Affine | None) -> Texture | None:
        file = self.file
        entry = file.entry("images", index)
        name = str(entry.get("name", "")) or f"image {index}"
        view = file.index(entry, "bufferView")
        source = None
        if view is not None:
            source = bytes(file.view(view)[0])
        elif (uri := file.uri(entry)).startswith("data:"):
            source = file.decoded(uri)
        if source is not None:
            return Texture(source, name=name, wrap=wrap, transform=transform)
        found = file.sibling(uri)
        if found is None:
            self._missing.append(shown(uri.encode()))
            return None
        return Texture(found, wrap=wrap, transform=transform)
