"""Adaptive sampling: noisy tiles get more samples, and nothing else changes."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import raystream as rs
from conftest import assert_same_bits
from raystream.core.errors import FileFormatError
from raystream.jit.threads import set_thread_count
from raystream.rendering import progressive, sample_bands
from raystream.rendering.adaptive import FIRST_SAMPLES, GROWTH, LEAST_SHARE, TILE, Rounds, Tiles
from raystream.rendering.film import Film
from raystream.rendering.integrator import make_context
from raystream.rendering.render import RENDERERS
from raystream.rendering.sample_bands import trace_sample
from raystream.rendering.sampling.sampler import Sampler
from z_test import assert_zero

#: Four rows of eight tiles, the last column narrower, the last row lower.
SIZE = WIDTH, HEIGHT = 58, 26


@pytest.fixture(scope="module")
def tracer():
    """A floor, its right half black; a lamp, and below it a board that casts a shadow."""

    def square(x, y, z, half, material, faces=((0, 1, 2), (0, 2, 3))):
        corners = [[x - half, y - half, z], [x + half, y - half, z]]
        corners += [[x + half, y + half, z], [x - half, y + half, z]]
        return rs.Mesh(corners, faces, material_ids=material)

    materials = [
        rs.Material("floor", diffuse=(0.7, 0.5, 0.3)),
        rs.Material("black", diffuse=(0.0, 0.0, 0.0)),
        rs.Material("lamp", diffuse=(0.0, 0.0, 0.0), emission=(90.0, 80.0, 70.0)),
    ]
    meshes = [
        square(-4, 0, 0, 4, 0),
        square(4, 0, 0, 4, 1),
        square(-3, 0, 3, 0.5, 2, ((0, 2, 1), (0, 3, 2))),  # faces down
        square(-2, 1, 1, 0.7, 0),
    ]
    camera = rs.Camera((0, -0.1, 9), (0, 0, 0), fov=30)
    return rs.Tracer(rs.Scene(meshes, materials=materials, camera=camera))


def render(tracer, **options):
    return rs.render(tracer, "path", SIZE, **{"samples": 4096, **options})


def assert_same_image(found, expected):
    assert_same_bits(found.pixels, expected.pixels)
    assert found.layers.keys() == expected.layers.keys()
    for name, layer in expected.layers.items():
        assert_same_bits(found.layers[name], layer)
    assert found.figures == expected.figures


NOISE = 0.06


@pytest.fixture(scope="module")
def whole(tracer):
    return render(tracer, noise=NOISE, layers="all")


def test_noisy_half_gets_more_samples(whole):
    counts = whole.layers["samples"]
    assert counts.min() >= FIRST_SAMPLES
    assert counts[:, :24].mean() > 3 * counts[:, 40:].mean()
    assert whole.figures["error"] <= NOISE
    assert whole.figures["samples"] == pytest.approx(counts.mean())
    for row, column in itertools.product(range(0, HEIGHT, TILE), range(0, WIDTH, TILE)):
        tile = counts[row : row + TILE, column : column + TILE]
        assert tile.min() == tile.max()


def test_noise_takes_fewer_paths_than_everywhere_alike(tracer, whole):
    taken = whole.layers["samples"].mean()
    alike = render(tracer, samples=round(taken))
    assert alike.figures["error"] > 1.1 * whole.figures["error"]


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_threads_and_bands_change_no_bit(tracer, whole, threads, monkeypatch):
    monkeypatch.setattr(sample_bands, "LEAST_BAND", 512)
    set_thread_count(threads)
    try:
        assert_same_image(render(tracer, noise=NOISE, layers="all"), whole)
    finally:
        set_thread_count(None)


def test_layers_change_no_bit_of_the_light(tracer, whole):
    bare = render(tracer, noise=NOISE)
    assert_same_bits(bare.pixels, whole.pixels)
    assert_same_bits(bare.layers["samples"], whole.layers["samples"])
    single = render(tracer, samples=64, layers="all")
    np.testing.assert_allclose(whole.layers["depth"], single.layers["depth"], rtol=0.02)
    assert_same_bits(whole.layers["prim_id"], single.layers["prim_id"])


def pixels_taken(tracer):
    """Paths after each pass."""
    seen = []
    render(tracer, noise=NOISE, progress=lambda done, total: seen.append(done))
    return sorted(set(seen))


def test_picture_resumed_after_any_pass_is_the_same(tracer, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(progressive, "SAMPLES_SECONDS", 0.0)  # one pass at a time
    ends = pixels_taken(tracer)
    assert len(ends) > FIRST_SAMPLES + 5
    for number, end in enumerate(ends[1:-1]):
        checkpoint = tmp_path / f"{number}.npz"

        def stop(done, total, end=end):
            if done > end:
                raise KeyboardInterrupt

        asked = {"noise": NOISE, "layers": "all", "checkpoint": checkpoint}
        with pytest.raises(KeyboardInterrupt):
            render(tracer, **asked, progress=stop)
        with np.load(checkpoint) as file:
            assert 0 < file["counts"].sum() <= ends[-1]
        assert_same_image(render(tracer, **asked), whole)


def test_picture_resumed_from_within_a_pass_is_the_same(tracer, whole, tmp_path, monkeypatch):
    trace_tiles = progressive.trace_tiles
    asked = {"noise": NOISE, "layers": "all", "checkpoint": tmp_path / "a.npz"}
    for number in (1, 2, 3):
        calls = itertools.count(1)

        def trace(*arguments, number=number, calls=calls):
            traced = trace_tiles(*arguments)
            if next(calls) == number:
                raise KeyboardInterrupt
            return traced

        with monkeypatch.context() as patch:
            patch.setattr(progressive, "trace_tiles", trace)
            with pytest.raises(KeyboardInterrupt):
                render(tracer, **asked)
    assert_same_image(render(tracer, **asked), whole)


def test_passes_traced_beyond_the_noise_limit_are_dropped(tracer, whole, monkeypatch):
    traced, trace_tiles = [], progressive.trace_tiles

    def trace(renderer, context, units, progress):
        made = trace_tiles(renderer, context, units, progress)
        traced.extend(light for light, _ in made)
        return made

    monkeypatch.setattr(progressive, "trace_tiles", trace)
    monkeypatch.setattr(progressive, "_passes_at_once", lambda *_: 1000)  # whole rounds
    assert_same_image(render(tracer, noise=NOISE, layers="all"), whole)
    pixel_count = WIDTH * HEIGHT
    assert sum(map(len, traced)) > whole.layers["samples"].sum() - FIRST_SAMPLES * pixel_count


def test_picture_resumed_from_between_passes_of_a_round_is_the_same(
    tracer, whole, tmp_path, monkeypatch
):
    monkeypatch.setattr(progressive, "_passes_at_once", lambda *_: 1000)
    add, asked = progressive._add, {"noise": NOISE, "layers": "all"}
    for number in (FIRST_SAMPLES + 2, FIRST_SAMPLES + 7):
        checkpoint, calls = tmp_path / f"{number}.npz", itertools.count()

        def stop(*arguments, number=number, calls=calls):
            if next(calls) == number:
                raise KeyboardInterrupt
            add(*arguments)

        with monkeypatch.context() as patch:
            patch.setattr(progressive, "_add", stop)
            with pytest.raises(KeyboardInterrupt):
                render(tracer, **asked, checkpoint=checkpoint)
        assert_same_image(render(tracer, **asked, checkpoint=checkpoint), whole)


def test_number_of_samples_alone_means_all_pixels(tracer):
    """The same bits as samples of the whole image that are added one by one."""
    mode = RENDERERS["path"]
    camera = tracer.scene.camera_for(WIDTH / HEIGHT)
    sampler = Sampler.of("sobol", 0, 20)
    context = make_context(tracer, camera, SIZE, sampler, mode.check(mode.complete({})))
    film = Film(*SIZE)
    for sample in range(20):
        film.add_samples(0, trace_sample(mode, context, sample)[0])
    image = render(tracer, samples=20)
    assert_same_image(image, film.image({"samples": 20, "error": film.error()}))
    assert (image.layers["samples"] == 20).all()
    # All tiles end with these samples, in whatever order they got them.
    assert_same_image(render(tracer, samples=20, noise=1e-9), image)
    assert_same_image(render(tracer, samples=20, time_limit=1e9), image)


LENS = rs.Camera((0, -0.1, 9), (0, 0, 0), fov=30, aperture=0.5, focus=8.0)
AROUND = rs.Camera((-3, -0.1, 2), (-3, 0, 0), projection="equirectangular")


@pytest.mark.parametrize("camera", [LENS, AROUND], ids=["lens", "around"])
@pytest.mark.parametrize("mode", ["raycast", "whitted", "xray", "ao", "path"])
def test_samples_of_tiles_have_the_bits_of_the_whole(tracer, mode, camera):
    """In all modes and cameras: tiles end with the same samples, with other samples beside."""
    asked = {"mode": mode, "size": (21, 13), "samples": 12, "camera": camera, "layers": "all"}
    scene = rs.Tracer(tracer.scene, "graph") if mode == "path" else tracer
    assert_same_image(rs.render(scene, noise=1e-12, **asked), rs.render(scene, **asked))


def test_checkpoint_of_unequal_tiles_becomes_one_of_equal_tiles(tracer, tmp_path):
    checkpoint = tmp_path / "a.npz"
    most = render(tracer, noise=NOISE, checkpoint=checkpoint).layers["samples"].max().item()
    few = render(tracer, samples=10, checkpoint=checkpoint)
    assert few.layers["samples"].min() == 10
    assert few.layers["samples"].max() == most
    seen = []
    image = render(
        tracer,
        samples=most + 3,
        checkpoint=checkpoint,
        progress=lambda done, total: seen.append((done, total)),
    )
    assert_same_image(image, render(tracer, samples=most + 3))
    assert seen[0][0] == few.layers["samples"].sum()
    assert {total for _, total in seen} == {(most + 3) * WIDTH * HEIGHT}


def test_checkpoint_of_other_tiles_is_refused(tracer, tmp_path):
    checkpoint = tmp_path / "a.npz"
    render(tracer, samples=2, checkpoint=checkpoint)
    with np.load(checkpoint) as file:
        arrays = dict(file)
    arrays["counts"][1] += 1
    np.savez(checkpoint, **arrays)
    with pytest.raises(FileFormatError, match="tile"):
        render(tracer, samples=4, checkpoint=checkpoint)
    arrays["counts"][1] -= 1
    np.savez(checkpoint, **arrays, targets=np.array([9, 9, 9]))
    with pytest.raises(FileFormatError, match="tile"):
        render(tracer, samples=4, checkpoint=checkpoint)


def test_means_are_those_of_equal_tiles(tracer):
    """Over many seeds, part by part: with few samples, where decisions depend on them the most."""
    count, parts = 64, (2, 13, 2, 29)  # rows and columns of parts, and their pixels
    means = []
    for seed in range(count):
        image = render(tracer, noise=0.1, seed=seed, sampler="random")
        means.append(image.pixels.astype(np.float64).reshape(*parts, 3).mean(axis=(1, 3)))
    assert 10 < image.figures["samples"] < 40
    assert image.layers["samples"].max() > 1.5 * image.layers["samples"].min()
    exact = render(tracer, samples=4096, seed=count, sampler="random")
    expected = exact.pixels.astype(np.float64).reshape(*parts, 3).mean(axis=(1, 3))
    rest = exact.layers["variance"].reshape(*parts, 3).mean(axis=(1, 3)) / (13 * 29)
    variance = np.var(means, axis=0, ddof=1) / count + rest
    assert np.sqrt(variance[:, 0]).max() < 0.005 * expected[:, 0].min()
    assert_zero(np.mean(means, axis=0) - expected, variance, expected)


# Rounds, of samples that are drawn here.


def test_steps_of_a_round_have_about_as_many_tiles_each():
    film = Film(64, 64)
    film.targets = np.full(64, 2)
    film.targets[[3, 40]] = 9
    steps = [len(unit.tiles) for unit in Rounds(film, 100, True).begin()]
    assert sum(steps) == 62 * 2 + 2 * 9
    assert len(steps) == 9
    assert max(steps) <= min(steps) + 1


def drawn(film, draw, mean):
    """Add drawn samples until the film has a mean number of them; returns the film."""
    for _ in range(FIRST_SAMPLES):
        film.add_samples(0, draw(np.arange(len(film.counts))))
    rounds, tiles = Rounds(film, 1 << 16, True), Tiles(film.width, film.height)
    while film.counts.mean() < mean:
        for units in rounds.passes(rounds.begin()):
            for unit in units:
                pixels = tiles.pixels(unit.tiles)
                film.add_samples(pixels, draw(pixels))
    return film


def test_rounds_give_samples_by_noise_and_at_least_a_share():
    deviation = np.ones((64, 64))
    deviation[:, 32:] = 0.0
    deviation[:, :16] = 8.0
    rng = np.random.default_rng(3)

    def draw(pixels):
        light = 9.0 + deviation.ravel()[pixels, None] * rng.normal(size=(len(pixels), 1))
        return np.repeat(light, 3, axis=1).astype(np.float32)

    film = drawn(Film(64, 64), draw, 64)
    counts = film.counts.reshape(64, 64)
    assert 64 <= counts.mean() < 64 * GROWTH
    assert counts[:, 0].mean() > 1.5 * counts[:, 16].mean() > 6 * counts[:, 48].mean()
    assert counts.min() >= LEAST_SHARE * counts.mean() / GROWTH - 1
    weights = film.counts / film.counts.sum()
    assert film.error() < 0.9 * film.error() * np.sqrt(len(weights) * (weights**2).sum())


def test_decisions_by_the_same_samples_shift_means_little():
    """Of light that is found by one sample in fifty: the worst case of `FIRST_SAMPLES`.

    A tile that has found none by then gets few samples, so means are too small; one that has is
    corrected by more samples. The tile's size makes this rare.
    """
    means = []
    for seed in range(60):
        rng = np.random.default_rng(seed)

        def draw(pixels, rng=rng):
            is_found = rng.random((len(pixels), 1)) < 0.02
            return np.where(is_found, np.float32(50.0), np.float32(0.0)).repeat(3, axis=1)

        means.append(drawn(Film(64, 64), draw, 16).mean()[..., 0].mean(dtype=np.float64))
    error = np.std(means, ddof=1) / np.sqrt(len(means))
    assert error < 0.01
    assert abs(np.mean(means) - 1.0) < 0.01 + 4 * error
