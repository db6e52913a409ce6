"""The differences from the CPU's answers that graphics devices are allowed.

The device computes t, u and v from the same float32 numbers by other instructions, and a driver
may round some of them its own way (Vulkan, "Precision and Operation of SPIR-V Instructions").
Which triangles a ray meets follows from exact signs, so counts, splits, ids and what is in the
way are the CPU's.
"""

from __future__ import annotations

import numpy as np

import raystream as rs
from conftest import assert_same_bits

#: Of t, relative to t; near 0, where a difference of positions cancelled, relative to the largest
#: coordinate that it was a difference of: of the scene, and of the ray's origin.
T_TOLERANCE = 1e-5

#: Of u and v, which are shares of 1; and of a sliver seen edge-on, where a share is the quotient
#: of areas that all but cancelled.
WEIGHT_TOLERANCE = 1e-4

Answers = dict[str, np.ndarray]


class Tolerance:
    """The tolerance of t against brute force.

    Parameters
    ----------
    scene : Scene
    rays : dict
        ``origins`` and ``directions``, as queries take them.
    """

    def __init__(self, scene: rs.Scene, rays) -> None:
        origins, directions = (np.asarray(rays[name], float) for name in ("origins", "directions"))
        origins, directions = np.broadcast_arrays(origins, directions)
        bounds = scene.bounds
        low, high = (np.zeros(3), np.zeros(3)) if bounds is None else np.asarray(bounds, float)
        with np.errstate(all="ignore"):
            # Tracing is relative to the middle of the scene.
            reach = np.abs(origins - (low + high) / 2).max(axis=-1) + (high - low).max() / 2
            lengths = np.abs(directions).max(axis=-1)
            self._least = np.nan_to_num(reach / lengths, nan=0.0, posinf=0.0).ravel()

    def of(self, t: np.ndarray, ray_id: np.ndarray) -> np.ndarray:
        """The tolerance of each t, which is a row of the ray with this number."""
        return T_TOLERANCE * np.maximum(np.abs(t), self._least[ray_id])


def assert_close(answers: Answers, expected: Answers, tolerance: Tolerance) -> None:
    """Answers as `test_agreement.answers_of` names them; those expected have all options."""
    assert answers
    for name, answer in answers.items():
        query, _, column = name.rpartition(": ")
        if column not in ("t", "u", "v", "prim_id"):
            assert_same_bits(answer, expected[name])
            continue
        assert answer.dtype == expected[name].dtype
        assert answer.shape == expected[name].shape
        if column == "prim_id":
            _check_rows(query, answers, expected, tolerance)


def _check_rows(query: str, answers: Answers, expected: Answers, tolerance: Tolerance) -> None:
    t, ids = answers[f"{query}: t"].ravel(), answers[f"{query}: prim_id"].ravel()
    other_t, other_ids = expected[f"{query}: t"].ravel(), expected[f"{query}: prim_id"].ravel()
    splits = expected.get(f"{query}: ray_splits")
    ray_id = np.arange(len(t)) if splits is None else _ray_ids(splits)
    np.testing.assert_array_equal(ids < 0, other_ids < 0, err_msg=query)
    is_hit = ids >= 0
    assert (t[~is_hit] == np.inf).all()
    # t, row by row: hits at nearly one t may have changed places.
    off = np.zeros(len(t))
    off[is_hit] = np.abs(t[is_hit].astype(float) - other_t[is_hit])
    most = np.zeros(len(t))
    most[is_hit] = tolerance.of(other_t[is_hit].astype(float), ray_id[is_hit])
    assert (off <= most).all(), f"{query}: t: {_worst(off, most)}"
    same = ids == other_ids
    for column in ("u", "v"):
        ours, theirs = (every[f"{query}: {column}"].ravel() for every in (answers, expected))
        difference = np.abs(ours.astype(float) - theirs)[same & is_hit]
        assert (difference <= WEIGHT_TOLERANCE).all(), f"{query}: {column}: {difference.max()}"
    if not same.all():
        _check_places(query, ray_id[~same], ids[~same], other_t[~same], most[~same], expected)


def _check_places(query, ray_id, ids, t, most, expected: Answers) -> None:
    """A row with another triangle is right if brute force meets that one as far away."""
    crossings = "surfaces" if "surfaces" in query else "triangles"
    every = f"multi_hit, {crossings}, None"
    rows = _ray_ids(expected[f"{every}: ray_splits"])
    distances = dict(
        zip(
            zip(rows.tolist(), expected[f"{every}: prim_id"].tolist(), strict=True),
            expected[f"{every}: t"].tolist(),
            strict=True,
        )
    )
    for ray, prim_id, nearest, allowed in zip(ray_id, ids, t, most, strict=True):
        found = distances.get((int(ray), int(prim_id)))
        assert found is not None, f"{query}: ray {ray} does not hit {prim_id}"
        assert abs(found - nearest) <= 2 * allowed, f"{query}: ray {ray}: {found} for {nearest}"


def _ray_ids(splits: np.ndarray) -> np.ndarray:
    return np.repeat(np.arange(len(splits) - 1), np.diff(splits))


def _worst(off: np.ndarray, most: np.ndarray) -> str:
    row = int(np.argmax(off - most))
    return f"row {row}: {off[row]} is more than {most[row]}"
