"""Denoisers: less noise, the edges of the guides stay, and the image keeps its mean."""

from __future__ import annotations

import numpy as np
import pytest

import raystream as rs
from extras import need
from raystream.jit.threads import set_thread_count
from raystream.rendering.color import luminance
from raystream.rendering.oidn import has_oidn
from raystream.rendering.regional_gain import regional_gain

HEIGHT, WIDTH = 64, 96
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH].astype(float)


@pytest.fixture(params=["atrous", "oidn", "oidn-fast"])
def method(request):
    """Each filter."""
    if request.param != "atrous":
        need("pyoidn")
    return request.param


def rmse(pixels, truth):
    return float(np.sqrt(np.mean((pixels - truth) ** 2)))


def two_walls():
    """A known image: two walls with a curved edge, a texture, and soft light on them."""
    on_left = WIDTH / 2 + 8 * np.sin(ROWS / 9) > COLUMNS
    checks = (ROWS // 4 + COLUMNS // 4) % 2 == 0
    layers = {
        "normal": np.where(on_left[..., None], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]),
        "depth": np.where(on_left, 5 + 0.01 * COLUMNS, 8 + 0.02 * ROWS),
        "albedo": np.where(checks[..., None], [0.8, 0.3, 0.1], [0.1, 0.4, 0.9]),
    }
    soft = np.where(on_left, 1 + 0.5 * np.sin(COLUMNS / 30), 0.3 + 0.2 * np.cos(ROWS / 25))
    return soft[..., None] * layers["albedo"], layers


def noisy(truth, count, seed=1):
    """The mean of samples with the spread of their values, and its variance."""
    rng = np.random.default_rng(seed)
    samples = rng.exponential(1.0, (count, HEIGHT, WIDTH, 1)) * truth
    variance = samples.var(axis=0, ddof=1) / count if count > 1 else np.full(truth.shape, np.inf)
    known = {"variance": variance, "samples": np.full((HEIGHT, WIDTH), count)}
    return samples.mean(axis=0), known


@pytest.mark.parametrize("count", [1, 4, 16])
@pytest.mark.parametrize("with_variance", [True, False])
def test_error_falls_to_a_fifth(count, with_variance):
    truth, layers = two_walls()
    pixels, known = noisy(truth, count)
    image = rs.Image(pixels, layers | known if with_variance else layers)
    smooth = image.denoise("atrous").pixels
    assert rmse(smooth, truth) < rmse(pixels, truth) / 5


@pytest.mark.parametrize("guides", [("normal", "albedo"), ("albedo",), ("normal",), ()])
def test_open_image_denoise_removes_noise_with_and_without_guides(guides):
    need("pyoidn")
    truth, layers = two_walls()
    truth = truth / layers["albedo"] * 0.5  # without a texture, which it could not see
    layers["albedo"] = np.full(truth.shape, 0.5)
    pixels, _ = noisy(truth, 4)
    smooth = rs.Image(pixels, {name: layers[name] for name in guides}).denoise("oidn").pixels
    assert rmse(smooth, truth) < rmse(pixels, truth) / 5


def test_more_samples_are_still_better():
    truth, layers = two_walls()
    errors = []
    for count in (4, 64):
        pixels, known = noisy(truth, count)
        errors.append(rmse(rs.Image(pixels, layers | known).denoise("atrous").pixels, truth))
    assert errors[1] < errors[0] / 2


def test_texture_stays_sharp():
    """Light is filtered without albedo: its mean over a large wall is right on each check."""
    truth, layers = two_walls()
    pixels, known = noisy(truth, 16)
    with_albedo = rs.Image(pixels, layers | known).denoise("atrous").pixels
    layers.pop("albedo")
    without = rs.Image(pixels, layers | known).denoise("atrous").pixels
    assert rmse(with_albedo, truth) < rmse(without, truth) / 3


@pytest.mark.parametrize("guide", ["normal", "depth", "albedo", "sky"])
def test_step_of_one_guide_does_not_blur(guide):
    """Dark and bright halves, with variance that would let light mix: one guide parts them."""
    right = COLUMNS >= WIDTH / 2
    pixels = np.where(right[..., None], 1.0, 0.5) * np.ones(3)
    layers = {"variance": np.full((HEIGHT, WIDTH, 3), 1.0)}
    edges = {
        "normal": np.where(right[..., None], [0.0, 0.6, 0.8], [0.0, -0.6, 0.8]),
        "depth": np.where(right, 3.0, 2.0),
        "sky": np.where(right, np.inf, 2.0),
        "albedo": np.where(right[..., None], [1.0, 0.01, 1.0], [0.01, 1.0, 0.01]),
    }
    blurred = rs.Image(pixels, layers).denoise("atrous").pixels
    assert np.abs(blurred - pixels).max() > 0.1
    layers["depth" if guide == "sky" else guide] = edges[guide]
    if guide == "albedo":  # light is what is left without it: unlike, and not mixed
        pixels = edges["albedo"]
    kept = rs.Image(pixels, layers).denoise("atrous").pixels
    np.testing.assert_allclose(kept, pixels, atol=2e-3)


def test_rim_of_a_lamp_is_left_as_it_is():
    """Pixels that a lamp covers in part differ from sample to sample, but not by noise."""
    rng = np.random.default_rng(5)
    rim = rng.uniform(40, 41, (HEIGHT, 1))
    covered = np.clip(COLUMNS - rim, 0, 1)[..., None] * np.array([20.0, 18.0, 15.0])
    light = rng.exponential(0.5, (HEIGHT, WIDTH, 3))
    pixels = (covered + light).astype(np.float32)
    variance = np.full(pixels.shape, 0.25) + 0.2 * covered * (20.0 - covered).clip(0)
    known = {"variance": variance, "samples": np.full((HEIGHT, WIDTH), 8)}
    smooth = rs.Image(pixels, {**known, "emission": covered}).denoise("atrous").pixels - covered
    assert rmse(smooth[:, 41], 0.5) < 0.1
    blurred = rs.Image(pixels, known).denoise("atrous").pixels - covered
    assert rmse(blurred[:, 41], 0.5) > 1


def test_slope_of_depth_is_no_edge():
    """A floor seen at a grazing angle is one surface."""
    rng = np.random.default_rng(5)
    truth = np.full((HEIGHT, WIDTH, 3), 0.5)
    pixels = truth + rng.normal(0, 0.1, (HEIGHT, WIDTH, 1))
    layers = {"variance": np.full(truth.shape, 0.01)}
    flat = rmse(rs.Image(pixels, layers).denoise("atrous").pixels, truth)
    layers["depth"] = 10 + 2.0 * ROWS
    steep = rmse(rs.Image(pixels, layers).denoise("atrous").pixels, truth)
    assert steep < 1.5 * flat < 0.1 / 5


def test_light_with_little_variance_is_kept():
    """A shadow's edge, which no guide knows, stays where samples agree on it."""
    pixels = np.where((COLUMNS > 40)[..., None], 1.0, 0.1) * np.ones(3)
    layers = {"variance": np.full((HEIGHT, WIDTH, 3), 1e-6)}
    np.testing.assert_allclose(rs.Image(pixels, layers).denoise("atrous").pixels, pixels, atol=1e-6)


@pytest.mark.parametrize("variance", [None, 0.0, 0.3, np.inf])
def test_constant_picture_is_unchanged(variance):
    """Bit for bit, of many colours: dividing by albedo and multiplying again would round."""
    rng = np.random.default_rng(8)
    for _ in range(20):
        pixels = np.full((5, 7, 3), rng.exponential(1.0, 3), np.float32)
        layers = {} if variance is None else {"variance": np.full(pixels.shape, variance)}
        layers["albedo"] = np.full(pixels.shape, rng.random(3))
        assert rs.Image(pixels, layers).denoise("atrous").pixels.tobytes() == pixels.tobytes()


def test_mirrored_picture_gives_the_mirrored_answer():
    truth, layers = two_walls()
    pixels, known = noisy(truth, 8)
    odd = np.s_[:, : WIDTH - 7]  # vectors of the last columns are not full
    pixels = pixels[odd]
    known = {name: layer[odd] for name, layer in (layers | known).items()}
    flipped = {name: layer[:, ::-1] for name, layer in known.items()}
    once = rs.Image(pixels, known).denoise("atrous").pixels
    mirrored = rs.Image(pixels[:, ::-1], flipped).denoise("atrous").pixels[:, ::-1]
    np.testing.assert_allclose(once, mirrored, rtol=1e-3, atol=1e-4)


def test_hostile_numbers_leave_nothing_that_is_not_finite(method):
    rng = np.random.default_rng(6)
    hard = np.array([np.nan, np.inf, -np.inf, 0.0, -1.0, 3e38, 1e-40, 1.0], np.float32)

    def any_of(*shape):
        return rng.choice(hard, shape)

    size = (24, 31)
    layers = {name: any_of(*size, 3) for name in ("normal", "albedo", "variance")}
    layers |= {"depth": any_of(*size), "samples": rng.integers(0, 9, size)}
    for chosen in (layers, {}, {"depth": layers["depth"]}):
        assert np.isfinite(rs.Image(any_of(*size, 3), chosen).denoise(method).pixels).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (3, 2)])
def test_small_pictures(size, method):
    pixels = np.random.default_rng(7).random((*size, 3)).astype(np.float32)
    layers = {"albedo": np.full(pixels.shape, 0.5), "normal": np.zeros(pixels.shape)}
    for chosen in ({}, layers):
        smooth = rs.Image(pixels, chosen).denoise(method).pixels
        assert smooth.min() > -0.1
        assert smooth.max() < 1.5


def rare(truth, seed):
    """Noise with the mean 1 and a heavy tail: one pixel in 200 has most of the light."""
    rng = np.random.default_rng(seed)
    size = truth.shape[:2]
    tail = np.where(rng.random(size) < 0.005, 120.0 * rng.pareto(3.0, size), 0.0)
    return truth * (0.7 * rng.exponential(1.0, size) + tail)[..., None]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("guided", [True, False])
def test_mean_stays_with_heavy_tails(seed, guided, method):
    """The filters reject what is rare, and would take a third of this light with it."""
    truth, layers = two_walls()
    pixels = rare(truth, seed)
    smooth = rs.Image(pixels, layers if guided else {}).denoise(method).pixels
    before, after = (luminance(one.astype(float)).mean() for one in (pixels, smooth))
    assert after == pytest.approx(before, rel=0.01)


@pytest.mark.parametrize("seed", range(4))
def test_edges_stay_with_heavy_tails(seed, method):
    """What is returned goes to both walls, and does not blur the edge between them."""
    truth, layers = two_walls()
    truth = truth / layers["albedo"] * 0.5
    layers["albedo"] = np.full(truth.shape, 0.5)
    smooth = luminance(rs.Image(rare(truth, seed), layers).denoise(method).pixels)
    edges = WIDTH / 2 + 8 * np.sin(np.arange(HEIGHT) / 9)
    ratios = []
    for values in (smooth, luminance(truth)):
        rows = list(zip(values, edges.astype(int), strict=True))
        left = np.mean([row[edge - 3 : edge - 1] for row, edge in rows])
        ratios.append(left / np.mean([row[edge + 2 : edge + 4] for row, edge in rows]))
    assert ratios[0] == pytest.approx(ratios[1], rel=0.4)


@pytest.mark.parametrize("strength", [10.0, 100.0, 1000.0])
def test_firefly_is_no_spot(strength):
    """Its light is spread so widely that it cannot be seen from its neighbours."""
    rng = np.random.default_rng(3)
    pixels = 0.5 + 0.05 * rng.standard_normal((HEIGHT, WIDTH, 1)) * np.ones(3)
    pixels[30, 40] = strength
    smooth = luminance(rs.Image(pixels).denoise("atrous").pixels)
    assert smooth.mean() == pytest.approx(luminance(pixels).mean(), rel=1e-4)
    assert smooth[30, 40] < 1.2 * smooth[22:39, 32:49].mean()


def test_gain_is_one_where_nothing_is_lost():
    smooth = np.random.default_rng(4).exponential(1.0, (20, 30))
    np.testing.assert_array_equal(regional_gain(smooth, np.zeros((20, 30))), 1.0)
    np.testing.assert_array_equal(regional_gain(np.zeros((20, 30)), np.zeros((20, 30))), 1.0)


@pytest.mark.parametrize("size", [(1, 1), (1, 50), (40, 60)])
@pytest.mark.parametrize("most", [0.1, 30.0])
def test_gain_preserves_the_sum(size, most):
    """By regions; and, where that would be more than twice the light there, in all."""
    rng = np.random.default_rng(6)
    smooth = rng.exponential(1.0, size)
    lost = rng.normal(0.05, 0.1, size)
    lost[size[0] // 2, size[1] // 2] += most * smooth.size
    gain = regional_gain(smooth, lost)
    assert gain.min() > 0
    assert np.sum(smooth * gain) == pytest.approx(np.sum(smooth + lost), rel=1e-12)


def test_gain_stays_in_its_region():
    lost = np.zeros((60, 200))
    lost[20:40, 20:40] = 0.2
    gain = regional_gain(np.ones((60, 200)), lost)
    assert gain[30, 30] > 1.02
    assert abs(gain[:, 150:] - 1).max() < 1e-6


def test_bits_do_not_depend_on_threads(method):
    truth, layers = two_walls()
    image = rs.Image(noisy(truth, 4)[0], layers)
    try:
        results = []
        for count in (1, 2, 3):
            set_thread_count(count)
            results.append(image.denoise(method).pixels.tobytes())
    finally:
        set_thread_count(None)
    assert results[0] == results[1] == results[2]


def test_layers_and_figures_go_on(method):
    truth, layers = two_walls()
    pixels, known = noisy(truth, 4)
    image = rs.Image(pixels, layers | known, {"rays": 5})
    smooth = image.denoise(method)
    assert set(smooth.layers) == {"normal", "depth", "albedo", "samples"}
    assert smooth.figures == {"rays": 5}
    np.testing.assert_array_equal(image.pixels, pixels.astype(np.float32))


def test_emission_is_not_filtered(method):
    truth, layers = two_walls()
    pixels, _ = noisy(truth, 8)
    lamp = np.where((COLUMNS > 70)[..., None], [8.0, 7.0, 6.0], 0.0)
    plain = rs.Image(pixels, layers).denoise(method).pixels
    lit = rs.Image(pixels + lamp, {**layers, "emission": lamp}).denoise(method).pixels
    if method == "atrous":  # estimates the variance near lamps
        plain, lit = plain[:, :64], lit[:, :64]
        lamp = lamp[:, :64]
    np.testing.assert_allclose(lit - lamp, plain, atol=0.02)


def test_open_image_denoise_is_chosen_where_it_is_installed(monkeypatch):
    truth, layers = two_walls()
    image = rs.Image(noisy(truth, 2)[0], layers)
    atrous = image.denoise("atrous").pixels
    if has_oidn():
        oidn = image.denoise("oidn").pixels
        assert np.abs(oidn - atrous).max() > 0.01
        np.testing.assert_array_equal(image.denoise().pixels, oidn)
    monkeypatch.setattr("raystream.rendering.denoise.has_oidn", lambda: False)
    np.testing.assert_array_equal(image.denoise().pixels, atrous)


def test_bad_arguments_are_refused(monkeypatch):
    image = rs.Image(np.zeros((4, 5, 3)), {"depth": np.zeros((4, 5, 3))})
    with pytest.raises(
        ValueError, match=r"method: expected 'oidn' or 'oidn-fast' or 'atrous', got 'blur'"
    ):
        image.denoise("blur")
    with pytest.raises(ValueError, match="'depth' of shape"):
        image.denoise("atrous")
    monkeypatch.setattr("raystream.rendering.oidn.has_oidn", lambda: False)
    with pytest.raises(ImportError, match=r"pip install 'raystream\[denoise\]'"):
        image.denoise("oidn")
