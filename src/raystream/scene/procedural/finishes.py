"""Finishes: materials that several scenes share."""

from __future__ import annotations

from raystream.scene.material import Color, Material


def polished(
    name: str, diffuse: Color, *, gloss: float, shininess: float, reflection: Color
) -> Material:
    """A surface with a grey highlight that mirrors a part of its surroundings."""
    return Material(
        name, diffuse=diffuse, specular=(gloss,) * 3, shininess=shininess, reflection=reflection
    )


MIRROR = polished("mirror", (0.03,) * 3, gloss=0.8, shininess=200.0, reflection=(0.85,) * 3)
