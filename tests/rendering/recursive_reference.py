"""Whitted's ray tracer as in textbooks: recursive, in float64, with NumPy.

It uses none of raystream's shading. A `Reference` finds hits by itself, with Plücker coordinates
in float64 (`Lines`), or queries a tracer (`Traced`), so that it follows the same rays to the last
bit; the light from each surface is computed independently in both cases.

The rules are those of docs/renderers.rst: lights count as one place each, ambient light is not
blocked, clear surfaces reflect by Fresnel's formula.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

#: Triangles tested together: neighbours in the scene's order, in one bounding sphere.
BLOCK = 64

#: Hits nearer than this many scene sizes are on the edge of the surface left.
NEAREST = 1e-11

#: How far float32 may move a ray, in the scene's sizes, for origins as large as those: `Hits.spawn`
#: moves origins by at most 28 halves of the last bit, the rounding of hits adds less than 6.
MOVED = 34 * 2.0**-24

#: How far in front of an area light shadow rays end that a tracer looks at, in the scene's sizes.
LIFTED = 16 * 2.0**-24

#: The part of that due to hits, and to directions, which are rounded to float32.
HITS, DIRECTIONS = 6 / 34, 1 / 34


def dot(a, b):
    """Scalar products of rows, as a column."""
    return np.einsum("...k,...k->...", a, b)[..., None]


def unit(a):
    return a / np.sqrt(dot(a, a))


class Rays(NamedTuple):
    """Rays, and the triangles that they leave: -1 for none."""

    origins: np.ndarray
    directions: np.ndarray
    left: np.ndarray

    def __getitem__(self, rows):
        return Rays(*(array[rows] for array in tuple(self)))

    def __len__(self):
        return len(self.left)


class Lines:
    """Triangles in float64: a ray hits where it passes all three edges on the same side.

    Parameters
    ----------
    corners : ndarray of shape (F, 3, 3)
    moved : float
        Rays are moved by so much of the scene's size, to see what depends on it.
    """

    def __init__(self, corners, moved=0.0, seed=0):
        self.corners, self.moved = corners, moved
        self.size = np.abs(corners).max()
        self.numbers = np.random.default_rng(seed)
        ends = np.roll(corners, -1, axis=1)
        lines = np.concatenate([np.cross(corners, ends), ends - corners], axis=2)
        self.edges = [np.ascontiguousarray(lines[:, k].T) for k in range(3)]
        self.normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    def start(self, origins, directions):
        """Rays from the eye, whose origins and directions are exact: only their hits move."""
        away = self.numbers.uniform(-1, 1, origins.shape) * self.moved * HITS * self.size
        return Rays(origins + away, directions, np.full(len(directions), -1))

    def leave(self, found, directions):
        """Rays from hits."""
        count = len(directions)
        away = self.numbers.uniform(-1, 1, (2, count, 3)) * self.moved
        # Farther from the surface only, on the side that the ray leaves to.
        normals = unit(self.normals[found.prims])
        push = np.abs(dot(away[0], normals)) * np.sign(dot(normals, directions)) * normals
        moved = away[0] - dot(away[0], normals) * normals + push
        origins = found.points + moved * self.size
        return Rays(origins, directions + away[1] * DIRECTIONS, found.prims)

    def pairs(self, rays, t_max):
        """All hits below t_max: ray, triangle, t, and weights of vertices 1 and 2."""
        moments = np.cross(rays.origins, rays.directions)
        lines = np.concatenate([rays.directions, moments], axis=1)
        lengths = np.sqrt(dot(rays.directions, rays.directions))[:, 0]
        parts = []
        for first in range(0, len(self.corners), BLOCK):
            points = self.corners[first : first + BLOCK].reshape(-1, 3)
            middle = (points.min(axis=0) + points.max(axis=0)) / 2
            radius = np.sqrt(dot(points - middle, points - middle).max())
            past = moments - np.cross(middle, rays.directions)
            near = np.sqrt(dot(past, past))[:, 0] <= radius * lengths * (1 + 1e-9)
            rows = np.flatnonzero(near)
            parts.append(self._pairs(rays, lines, lengths, rows, first, t_max))
        return [np.concatenate(column) for column in zip(*parts, strict=True)]

    def _pairs(self, rays, lines, lengths, rows, first, t_max):
        """The same of some rays and the block of triangles that begins there."""
        sides = [lines[rows] @ edges[:, first : first + BLOCK] for edges in self.edges]
        low = np.minimum(np.minimum(*sides[:2]), sides[2])
        high = np.maximum(np.maximum(*sides[:2]), sides[2])
        row, column = np.nonzero((low >= 0) | (high <= 0))
        sides = np.stack([side[row, column] for side in sides])
        ray, prim, total = rows[row], first + column, sides.sum(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = dot(self.normals[prim], self.corners[prim, 0] - rays.origins[ray])
            t = (t / dot(self.normals[prim], rays.directions[ray]))[:, 0]
            u, v = sides[2] / total, sides[0] / total
        kept = (total != 0) & (t * lengths[ray] > NEAREST * self.size) & (t < t_max[ray])
        kept &= prim != rays.left[ray]
        return ray[kept], prim[kept], t[kept], u[kept], v[kept]

    def nearest(self, rays):
        """The first hit of each ray; prim is -1 for a miss."""
        ray, prim, t, u, v = self.pairs(rays, np.full(len(rays), np.inf))
        order = np.lexsort((prim, t, ray))
        ray, rows = np.unique(ray[order], return_index=True)
        rows = order[rows]
        prims, weights = np.full(len(rays), -1), np.zeros((2, len(rays)))
        prims[ray], weights[:, ray] = prim[rows], (u[rows], v[rows])
        return Found.of(prims, weights, self.corners)

    def blocked(self, found, toward, distances, light):
        """Whether anything but a light's own triangles is before a distance."""
        ray, prim, _, _, _ = self.pairs(self.leave(found, toward), distances[:, 0])
        blocked = np.zeros(len(toward), bool)
        blocked[ray[~np.isin(prim, light.prims)]] = True
        return blocked


class Traced:
    """The same questions for a tracer, with the rays that raystream's documentation describes."""

    def __init__(self, tracer, corners):
        self.tracer, self.corners = tracer, corners

    def start(self, origins, directions):
        return Rays(origins, directions, np.full(len(directions), -1))

    def leave(self, found, directions):
        directions = directions.astype(np.float32)
        return Rays(*found.hits.spawn(directions), found.prims)

    def nearest(self, rays):
        hits = self.tracer.first_hit(rays.origins, rays.directions)
        weights = np.stack([hits.u, hits.v]).astype(np.float64)
        return Found.of(hits.prim_id.astype(int), weights, self.corners, hits)

    def blocked(self, found, toward, _, light):
        origins, _ = found.hits.spawn(toward)
        if light.kind == "DirectionalLight":
            return self.tracer.any_hit(origins, toward)
        # Just before an area light, whose own triangles would be in the way.
        end = light.place + light.normal * LIFTED * np.abs(self.corners).max()
        return self.tracer.any_hit(origins, end - origins, t_max=1.0)


class Found(NamedTuple):
    """Intersections of rays with surfaces."""

    prims: np.ndarray
    weights: np.ndarray
    points: np.ndarray
    hits: object

    @classmethod
    def of(cls, prims, weights, corners, hits=None):
        u, v = weights[:, :, None]
        a, b, c = corners[prims].transpose(1, 0, 2)
        weights = np.stack([1 - u - v, u, v])[:, :, 0]
        return cls(prims, weights, a + u * (b - a) + v * (c - a), hits)

    def __getitem__(self, rows):
        hits = None if self.hits is None else self.hits[rows]
        return Found(self.prims[rows], self.weights[:, rows], self.points[rows], hits)


class Light(NamedTuple):
    """A light in one place, or far away: then `place` is the unit vector to it."""

    kind: str
    place: np.ndarray
    color: np.ndarray
    normal: np.ndarray = np.zeros(3)
    area: float = 0.0
    prims: np.ndarray = np.zeros(0, int)


class Surface(NamedTuple):
    """Surface points at hits; directions point away from them."""

    points: np.ndarray
    back: np.ndarray  # to the eye
    flat: np.ndarray  # normals of the triangles, on the eye's side
    smooth: np.ndarray  # normals between those of the vertices
    front: np.ndarray
    diffuse: np.ndarray
    specular: np.ndarray
    reflection: np.ndarray
    transmission: np.ndarray
    emission: np.ndarray
    shininess: np.ndarray
    ior: np.ndarray


class Reference:
    """A scene as seen by a recursive ray tracer.

    Parameters
    ----------
    scene : Scene
        With lights, flat area lights and materials after Phong; textures on matte colours only.
    tracer : Tracer, optional
        Finds the hits; else `Lines` does.
    moved : float
        See `Lines`.
    """

    def __init__(self, scene, tracer=None, moved=0.0, seed=0):
        self.scene = scene
        corners = [mesh.vertices[mesh.faces] for mesh in scene.meshes]
        self.corners = np.concatenate(corners).astype(np.float64)
        self.hits = Lines(self.corners, moved, seed)
        if tracer is not None:
            self.hits = Traced(tracer, self.corners)
        self.material_ids = np.concatenate([mesh.material_ids for mesh in scene.meshes])
        self.normals = self._of_vertices("normals", 3)
        self.texcoords = self._of_vertices("texcoords", 2)
        for material in scene.materials:
            if set(material.textures) - {"diffuse"} or material.roughness is not None:
                raise NotImplementedError(f"material {material.name!r}")
        self.ambient, self.lights = self._lights()

    def _of_vertices(self, name, width):
        """An attribute of the triangles' vertices, shape (F, 3, width)."""
        parts = []
        for mesh in self.scene.meshes:
            values = getattr(mesh, name)
            if values is None:
                values = np.full((len(mesh.vertices), width), np.nan)
            parts.append(values[mesh.faces].astype(np.float64))
        return np.concatenate(parts)

    def _lights(self):
        """The ambient radiance; and each light's place or direction, colour, and area."""
        ambient, lights = np.zeros(3), []
        for light in self.scene.lights:
            kind = type(light).__name__
            if kind == "EnvironmentLight":
                ambient += light.radiance
            elif kind == "DirectionalLight":
                toward = -unit(np.array(light.direction))
                lights.append(Light(kind, toward, np.array(light.irradiance)))
            elif light.falloff == "inverse_square":
                lights.append(Light(kind, np.array(light.position), np.array(light.intensity)))
            else:
                raise NotImplementedError("light without falloff")
        width, height, depth = np.ptp(self.corners.reshape(-1, 3), axis=0)
        room = 2 * (width * height + height * depth + depth * width)
        for light in self.scene.area_lights:
            a, b, c = self.corners[light.prim_ids].transpose(1, 0, 2)
            normals = np.cross(b - a, c - a) / 2
            areas = np.sqrt(dot(normals, normals))
            if np.linalg.norm(normals.sum(axis=0)) < 0.9 * areas.sum():
                raise NotImplementedError("area light that is not flat")
            middle = (areas * (a + b + c) / 3).sum(axis=0) / areas.sum()
            patch = unit(normals.sum(axis=0)), areas.sum(), light.prim_ids
            lights.append(Light("AreaLight", middle, np.array(light.radiance), *patch))
            ambient += np.array(light.radiance) * areas.sum() / room
        if not lights and not ambient.any():
            raise NotImplementedError("scene without lights")
        return ambient, lights

    def render(self, origins, directions, bounces):
        """Radiance along rays: shape (bounces + 1, N, 3), for every number up to `bounces`."""
        return self.trace(self.hits.start(origins, directions), bounces)

    def trace(self, rays, bounces):
        """RayTrace of Christen 2005, section 2.2, for all depths at once: row k has k bounces."""
        seen = np.empty((bounces + 1, len(rays), 3))
        seen[:] = self.scene.background
        found = self.hits.nearest(rays)
        rows = np.flatnonzero(found.prims >= 0)
        if not len(rows):
            return seen
        found = found[rows]
        surface = self.surface(found, rays.directions[rows].astype(np.float64))
        color = np.repeat(self.shade(found, surface)[None], bounces + 1, axis=0)
        if bounces:
            for share, toward, goes in self.onward(surface):
                goes &= share.any(axis=1)
                if goes.any():
                    below = self.hits.leave(found[goes], toward[goes])
                    color[1:, goes] += share[goes] * self.trace(below, bounces - 1)
        seen[:, rows] = color
        return seen

    def surface(self, found, directions):
        """The surfaces at hits."""
        prims = found.prims
        a, b, c = self.corners[prims].transpose(1, 0, 2)
        back, flat = -unit(directions), unit(np.cross(b - a, c - a))
        front = (dot(flat, back) >= 0)[:, 0]
        flat = np.where(front[:, None], flat, -flat)
        smooth = unit(np.einsum("kn,nkj->nj", found.weights, self.normals[prims]))
        smooth = np.where(dot(smooth, flat) < 0, -smooth, smooth)
        usable = np.isfinite(smooth).all(axis=1, keepdims=True) & (dot(smooth, back) > 0)
        smooth = np.where(usable, smooth, flat)

        ids, materials = self.material_ids[prims], self.scene.materials
        names = ("diffuse", "specular", "reflection", "transmission", "emission")
        colors = {name: np.array([getattr(m, name) for m in materials])[ids] for name in names}
        st = np.einsum("kn,nkj->nj", found.weights, self.texcoords[prims])
        for number, material in enumerate(materials):
            rows = np.flatnonzero((ids == number) & np.isfinite(st).all(axis=1))
            if "diffuse" in material.textures and len(rows):
                colors["diffuse"][rows] *= bilinear(material.textures["diffuse"], st[rows])
        total = sum(colors[name] for name in names[:4]).max(axis=1, keepdims=True)
        for name in names[:4]:
            colors[name] = colors[name] / np.maximum(total, 1)
        shininess = np.maximum([m.shininess for m in materials], 1.0)[ids, None]
        ior = np.array([m.ior for m in materials])[ids, None]
        ior = np.where(front[:, None], ior, 1 / ior)
        return Surface(
            found.points, back, flat, smooth, front, **colors, shininess=shininess, ior=ior
        )

    def shade(self, found, at):
        """RayShade: emission, and the contribution of each unblocked light."""
        color = at.emission * at.front[:, None] + at.diffuse * self.ambient
        mirrored = 2 * dot(at.back, at.smooth) * at.smooth - at.back
        for light in self.lights:
            toward, distances, arriving = arrive(light, at.points)
            # Phong's lobe with its energy kept, as Lafortune and Willems 1994 have it.
            cosine = np.maximum(dot(at.smooth, toward), 0) * (dot(at.flat, toward) > 0)
            highlight = np.maximum(dot(mirrored, toward), 0) ** at.shininess
            lobe = at.diffuse / np.pi + at.specular * highlight * (at.shininess + 2) / (2 * np.pi)
            brought = lobe * cosine * arriving
            rows = np.flatnonzero(brought.any(axis=1))
            if len(rows):
                lit = ~self.hits.blocked(found[rows], toward[rows], distances[rows], light)
                color[rows] += brought[rows] * lit[:, None]
        return color

    def onward(self, at):
        """Rays from mirrors and glass: share, direction, and the hits that have one."""
        cosine = np.clip(dot(at.back, at.smooth), 0, 1)
        square = 1 - (1 - cosine**2) / at.ior**2
        behind = np.sqrt(np.maximum(square, 0))
        across = (cosine - at.ior * behind) / (cosine + at.ior * behind)
        along = (at.ior * cosine - behind) / (at.ior * cosine + behind)
        clear = np.where(square > 0, (across**2 + along**2) / 2, 1.0)
        clear = np.where(at.ior == 1, 0.0, clear)
        mirrored = 2 * cosine * at.smooth - at.back
        away = (dot(at.flat, mirrored) > 0)[:, 0]
        yield at.reflection + clear * at.transmission, mirrored, away
        bent = (cosine / at.ior - behind) * at.smooth - at.back / at.ior
        through = (dot(at.flat, bent) < 0)[:, 0] & (clear < 1)[:, 0]
        yield at.transmission * (1 - clear), bent, through


def arrive(light, points):
    """Unit vectors to a light, distances, and irradiance of surfaces that face it."""
    if light.kind == "DirectionalLight":
        toward = np.broadcast_to(light.place, points.shape)
        return toward, np.full((len(points), 1), np.inf), light.color
    offset = light.place - points
    distances = np.sqrt(dot(offset, offset))
    toward = offset / distances
    if light.kind == "AreaLight":
        # Of a disc as large, at a point of its axis: finite also where they touch.
        received = light.color * light.area / (distances**2 + light.area / np.pi)
        return toward, distances, received * np.maximum(-dot(toward, light.normal), 0)
    return toward, distances, light.color / distances**2


def bilinear(texture, st):
    """A texture's linear colour between four texels; v points up."""
    texels = texture.pixels()[:, :, :3] / 255.0
    texels = np.where(texels <= 0.04045, texels / 12.92, ((texels + 0.055) / 1.055) ** 2.4)
    height, width = texels.shape[:2]
    assert texture.wrap == "repeat"
    x = (st[:, 0] % 1) * width - 0.5
    y = (1 - st[:, 1] % 1) * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    across, down = (x - column)[:, None], (y - row)[:, None]
    near, far = column % width, (column + 1) % width
    upper = texels[row % height, near] * (1 - across) + texels[row % height, far] * across
    row = row + 1
    lower = texels[row % height, near] * (1 - across) + texels[row % height, far] * across
    return upper * (1 - down) + lower * down
