"""Film: the mean, its spread, layers, and checkpoints."""

from __future__ import annotations

import json
import threading

import numpy as np
import pytest

from raystream.core.errors import FileFormatError
from raystream.rendering.film import Film

WIDTH, HEIGHT = 6, 4
PIXELS = WIDTH * HEIGHT


def samples_of(count, seed=1):
    """Light as from renderers: spread over some powers of ten."""
    rng = np.random.default_rng(seed)
    return rng.exponential(2.0, (count, PIXELS, 3)).astype(np.float32) ** 3


def filled(samples, sums=None):
    sums = sums or Film(WIDTH, HEIGHT)
    for sample in samples:
        sums.add_samples(0, sample)
    return sums


def test_mean_and_variance_are_those_of_the_samples():
    samples = samples_of(9)
    sums = filled(samples)
    exact = samples.astype(np.float64)
    np.testing.assert_allclose(sums.mean().reshape(PIXELS, 3), exact.mean(axis=0), rtol=1e-6)
    expected = exact.var(axis=0, ddof=1) / len(samples)
    np.testing.assert_allclose(sums.variance().reshape(PIXELS, 3), expected, rtol=1e-5)
    assert sums.mean().dtype == sums.variance().dtype == np.float32
    assert (sums.counts == 9).all()


def test_variance_is_that_of_means_drawn_again():
    """Unbiased: over many images, the mean of the estimates is the spread of the means."""
    rng = np.random.default_rng(7)
    draws = rng.exponential(1.0, (3, 200 * 100, 3)).astype(np.float32)
    sums = Film(200, 100)
    for draw in draws:
        sums.add_samples(0, draw)
    estimate, spread = sums.variance().mean(), sums.mean().var()
    assert spread == pytest.approx(1 / 3, rel=0.05)
    assert estimate == pytest.approx(1 / 3, rel=0.05)


def test_pixels_have_numbers_of_samples_of_their_own():
    sums = Film(WIDTH, HEIGHT)
    sums.add_samples(5, np.ones((3, 3), np.float32))
    sums.add_samples(6, np.full((1, 3), 3.0, np.float32))
    assert sums.counts[4:9].tolist() == [0, 1, 2, 1, 0]
    mean = sums.mean().reshape(PIXELS, 3)
    assert mean[4:9, 0].tolist() == [0.0, 1.0, 2.0, 1.0, 0.0]
    variance = sums.variance().reshape(PIXELS, 3)
    assert variance[6].tolist() == [1.0, 1.0, 1.0]
    assert np.isinf(np.delete(variance, 6, axis=0)).all()
    assert sums.error() == np.inf


def test_samples_that_are_not_finite_count_as_black():
    sums = Film(WIDTH, HEIGHT)
    bad = np.ones((PIXELS, 3), np.float32)
    bad[3, 1], bad[8, 0], bad[9] = np.nan, np.inf, -np.inf
    sums.add_samples(0, bad)
    sums.add_samples(0, np.ones((PIXELS, 3), np.float32))
    assert sums.dropped == 3
    mean = sums.mean().reshape(PIXELS, 3)
    assert mean[[3, 8, 9]].tolist() == [[0.5] * 3] * 3
    assert (np.delete(mean, [3, 8, 9], axis=0) == 1.0).all()
    assert np.isfinite(sums.variance()).all()


def test_largest_light_leaves_no_nan():
    most = np.full((PIXELS, 3), np.finfo(np.float32).max)
    sums = filled([most, most * 0, most])
    assert not np.isnan(sums.variance()).any()
    assert np.isfinite(sums.mean()).all()


# The image's error.


def test_error_foretells_the_distance_from_the_truth():
    rng = np.random.default_rng(3)
    sums = Film(100, 60)
    for _ in range(32):
        sums.add_samples(0, rng.exponential(2.0, (6000, 3)).astype(np.float32))
    actual = np.sqrt(np.mean((sums.mean() - 2.0) ** 2)) / 2.0
    assert sums.error() == pytest.approx(actual, rel=0.05)
    assert sums.error() == pytest.approx(1 / np.sqrt(32), rel=0.05)


def test_error_is_a_part_of_the_brightness():
    samples = samples_of(4)
    assert filled(samples * 8).error() == pytest.approx(filled(samples).error(), rel=1e-6)
    assert filled(np.zeros((2, PIXELS, 3), np.float32)).error() == 0.0
    assert filled(samples[:1]).error() == np.inf


def test_samples_added_together_give_the_bits_of_one_by_one():
    """In order, so that an image does not depend on how many are traced at once."""
    samples = samples_of(7)
    samples[2, 3:9] = np.inf
    together = Film(WIDTH, HEIGHT)
    together.add_samples(0, samples[:3])
    together.add_samples(0, samples[3:])
    singly = filled(samples)
    np.testing.assert_array_equal(together.mean(), singly.mean())
    np.testing.assert_array_equal(together.variance(), singly.variance())
    np.testing.assert_array_equal(together.counts, singly.counts)
    assert together.dropped == singly.dropped > 0


# Layers.


def test_layers_are_means_and_first_samples():
    sums = Film(WIDTH, HEIGHT)
    for depth, prim_id in ((2.0, 7), (np.inf, -1), (4.0, 9)):
        sums.set_layer("depth", 0, np.full(PIXELS - 1, depth, np.float32))
        sums.set_layer("prim_id", 0, np.full(PIXELS - 1, prim_id, np.int32))
        sums.set_layer("normal", 1, np.full((2, 3), depth, np.float32))
    layers = sums.layers()
    assert layers["depth"].shape == (HEIGHT, WIDTH)
    assert layers["depth"].ravel()[:-1].tolist() == [3.0] * (PIXELS - 1)
    assert layers["depth"].ravel()[-1] == np.inf
    assert layers["prim_id"].ravel().tolist() == [7] * (PIXELS - 1) + [-1]
    assert layers["prim_id"].dtype == np.int32
    assert layers["normal"][0, :4, 2].tolist() == [0.0, 3.0, 3.0, 0.0]
    assert set(layers) == {"depth", "prim_id", "normal", "variance", "samples"}


def test_image_has_the_layers():
    sums = filled(samples_of(3))
    image = sums.image({"rays": 5})
    np.testing.assert_array_equal(image.layers["variance"], sums.variance())
    assert (image.layers["samples"] == 3).all()
    assert image.figures == {"rays": 5}


@pytest.mark.parametrize(
    ("name", "values", "named"),
    [
        ("colour", np.zeros(3), "layer"),
        ("depth", np.zeros((3, 3)), "depth"),
        ("normal", np.zeros(3), "normal"),
        ("depth", np.zeros(PIXELS + 1), "first_pixel"),
    ],
)
def test_bad_layer_is_refused(name, values, named):
    with pytest.raises(ValueError, match=f"^{named}: "):
        Film(WIDTH, HEIGHT).set_layer(name, 0, values.astype(np.float32))


@pytest.mark.parametrize("first", [-1, 1, PIXELS])
def test_pixels_outside_are_refused(first):
    with pytest.raises(ValueError, match=r"^first_pixel: "):
        Film(WIDTH, HEIGHT).add_samples(first, np.zeros((PIXELS, 3), np.float32))


def test_shape_and_size_are_checked():
    with pytest.raises(ValueError, match="radiance"):
        Film(WIDTH, HEIGHT).add_samples(0, np.zeros(3, np.float32))
    with pytest.raises(ValueError, match="size"):
        Film(0, 4)


# Threads.


def test_threads_add_to_pixels_of_their_own():
    samples = samples_of(40)
    samples[::3, ::5] = np.nan
    together = Film(WIDTH, HEIGHT)

    def add(row):
        pixels = slice(row * WIDTH, (row + 1) * WIDTH)
        for sample in samples:
            together.add_samples(pixels.start, sample[pixels])
            together.set_layer("albedo", pixels.start, np.nan_to_num(sample[pixels]))

    threads = [threading.Thread(target=add, args=(row,)) for row in range(HEIGHT)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    alone = filled(samples)
    np.testing.assert_array_equal(together.mean(), alone.mean())
    np.testing.assert_array_equal(together.variance(), alone.variance())
    assert together.dropped == alone.dropped == 14 * 5
    np.testing.assert_allclose(together.layers()["albedo"], alone.mean(), rtol=1e-6)


# Checkpoints.

IDENTITY = json.dumps({"scene": "cornell", "mode": "path", "seed": 3})


def test_sums_go_on_from_a_checkpoint_to_the_same_bits(tmp_path):
    samples = samples_of(8)
    samples[2, 3] = np.inf
    whole, part = Film(WIDTH, HEIGHT), Film(WIDTH, HEIGHT)
    for i, sample in enumerate(samples):
        if i == 3:
            part.save(tmp_path / "half.npz", IDENTITY)
            part = Film.load(tmp_path / "half.npz", IDENTITY)
        for sums in (whole, part):
            sums.add_samples(0, sample)
            sums.set_layer("depth", 0, sample[:, 0])
            sums.set_layer("prim_id", 1, np.full(5, i, np.int32))
    assert part.mean().tobytes() == whole.mean().tobytes()
    assert part.error() == whole.error()
    assert part.dropped == whole.dropped == 1
    expected, found = whole.layers(), part.layers()
    assert set(found) == set(expected)
    for name, layer in expected.items():
        assert found[name].tobytes() == layer.tobytes(), name


def test_checkpoint_of_another_picture_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    filled(samples_of(1)).save(path, IDENTITY)
    other = json.dumps({"scene": "cornell", "mode": "ao", "seed": 4})
    with pytest.raises(FileFormatError, match=r"another image \(mode, seed differ\)"):
        Film.load(path, other)
    with pytest.raises(FileFormatError, match=r"another image .*not 'plain text'"):
        Film.load(path, "plain text")
    with pytest.raises(TypeError, match="identity"):
        Film.load(path, 3)


def test_identities_that_only_look_like_json(tmp_path):
    path = tmp_path / "a.npz"
    filled(samples_of(1)).save(path, "[" * 5000)
    with pytest.raises(FileFormatError, match="another image"):
        Film.load(path, "[" * 5001)
    with pytest.raises(ValueError, match="identity"):
        filled(samples_of(1)).save(path, "x" * 70000)


def test_write_that_fails_keeps_the_old_checkpoint(tmp_path, monkeypatch):
    path = tmp_path / "a.npz"
    filled(samples_of(2)).save(path, IDENTITY)
    before = path.read_bytes()

    def fail(stream, **arrays):
        stream.write(b"half of it")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", fail)
    with pytest.raises(KeyboardInterrupt):
        filled(samples_of(3)).save(path, IDENTITY)
    assert path.read_bytes() == before
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.npz"]


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("sum", np.zeros((PIXELS, 3), np.float32)),
        ("sum", np.full((PIXELS, 3), np.nan)),
        ("squares", np.full((PIXELS, 3), -1.0)),
        ("squares", np.zeros((PIXELS - 1, 3))),
        ("counts", np.full(PIXELS, -1)),
        ("size", np.array([1 << 40, 1 << 40])),
        ("size", np.array([0, 4])),
        ("version", np.array([2])),
        ("identity", np.zeros((2, 2), np.uint8)),
        ("depth_sum", np.zeros(3)),
        ("depth_counts", None),
        ("counts", None),
    ],
)
def test_damaged_checkpoint_is_refused(tmp_path, name, array):
    sums = filled(samples_of(2))
    sums.set_layer("depth", 0, np.ones(PIXELS, np.float32))
    path = tmp_path / "a.npz"
    sums.save(path, IDENTITY)
    with np.load(path) as file:
        arrays = dict(file)
    arrays.pop(name)
    if array is not None:
        arrays[name] = array
    np.savez(path, **arrays)
    with pytest.raises(FileFormatError, match=r"^.*a\.npz: "):
        Film.load(path, IDENTITY)


def test_file_that_is_none_is_refused(tmp_path):
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 no archive")
    for name in ("a.npz", "missing.npz"):
        with pytest.raises(FileFormatError, match=name):
            Film.load(tmp_path / name, IDENTITY)
