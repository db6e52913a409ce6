"""The oracle of spheres: exact rational arithmetic, without square roots.

The hit of a ray with a sphere is compared with those of two spheres with the same centre, whose
radii differ from the sphere's by a tolerance. A root t of |f + t d|^2 = r^2 decreases with r where
the ray enters, and increases where it leaves; so signs of the polynomial say on which side a
number is, and no root is computed.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

#: The radius may be off by this part of (radius + distance of the origin from the centre).
RADIUS_TOLERANCE = Fraction(1, 2**48)

#: t is rounded to float32 once; and where the origin is far outside the scene, once before, when
#: it is at most four times as large.
T_TOLERANCE = Fraction(1, 2**24)
FAR_T_TOLERANCE = 5 * T_TOLERANCE

#: A t beyond float32 is reported as its largest number: it may be as large as this.
LARGEST, BEYOND = Fraction(float(np.finfo(np.float32).max)), Fraction(2**400)


class ExactSphere:
    """A ray and a sphere in rationals."""

    def __init__(self, origin, direction, center, radius, is_far: bool = False) -> None:
        f = [Fraction(float(o)) - Fraction(float(c)) for o, c in zip(origin, center, strict=True)]
        d = [Fraction(float(x)) for x in direction]
        self.a = sum(x * x for x in d)
        self.b = sum(x * y for x, y in zip(f, d, strict=True))
        self.c = sum(x * x for x in f)
        self.middle = -self.b / self.a
        radius = Fraction(float(radius))
        distance = Fraction(float(np.sqrt(float(self.c)))) if self.c else Fraction(0)
        off = RADIUS_TOLERANCE * (radius + distance)
        self.small, self.large = (max(radius - off, 0)) ** 2, (radius + off) ** 2
        self.relative = FAR_T_TOLERANCE if is_far else T_TOLERANCE

    def _at(self, t: Fraction) -> Fraction:
        """The square of the distance from the centre."""
        return (self.a * t + 2 * self.b) * t + self.c

    def _slack(self, t: Fraction) -> Fraction:
        return abs(t) * self.relative + Fraction(1, 2**149)

    def _around(self, t: Fraction) -> tuple[Fraction, Fraction]:
        """Between which numbers t may be."""
        early, late = t - self._slack(t), t + self._slack(t)
        return -BEYOND if t == -LARGEST else early, BEYOND if t == LARGEST else late

    def is_entry(self, t: float) -> bool:
        """Whether the ray enters at t, within the tolerances."""
        early, late = self._around(Fraction(float(t)))
        is_not_late = early <= self.middle and self._at(early) >= self.small
        return is_not_late and (late >= self.middle or self._at(late) <= self.large)

    def is_exit(self, t: float) -> bool:
        """Whether the ray leaves at t, within the tolerances."""
        early, late = self._around(Fraction(float(t)))
        is_not_early = late >= self.middle and self._at(late) >= self.small
        return is_not_early and (early <= self.middle or self._at(early) <= self.large)

    def must_hit(self) -> bool:
        """Whether the line meets the sphere, whatever the tolerance."""
        return self._at(self.middle) <= self.small

    def may_hit(self) -> bool:
        """Whether the line meets the sphere, at best."""
        return self._at(self.middle) <= self.large

    def must_enter_within(self, t_min: float, t_max: float) -> bool:
        """Whether it enters within an interval, whatever the tolerances."""
        if not self.must_hit():
            return False
        low = Fraction(float(t_min))
        low += self._slack(low)
        if not (low <= self.middle and self._at(low) >= self.large):
            return False
        if t_max == np.inf:
            return True
        high = Fraction(float(t_max))
        high -= self._slack(high)
        return high >= self.middle or self._at(high) <= self.small

    def must_leave_within(self, t_min: float, t_max: float) -> bool:
        """Whether it leaves within an interval, whatever the tolerances."""
        if not self.must_hit():
            return False
        low = Fraction(float(t_min))
        low += self._slack(low)
        if not (low <= self.middle or self._at(low) <= self.small):
            return False
        if t_max == np.inf:
            return True
        high = Fraction(float(t_max))
        high -= self._slack(high)
        return high >= self.middle and self._at(high) >= self.large


def check(spheres, rays, targets, hits, is_far: bool = False) -> int:
    """Check the hits of each ray with the sphere that it is aimed at; returns their number.

    Parameters
    ----------
    spheres : tuple of centers, radii
    rays : tuple of origins, directions, t_min, t_max
        Arrays with a row for each ray.
    targets : ndarray of shape (N,), int
    hits : MultiHits
        All hits of the rays.
    """
    centers, radii = spheres
    origins, directions, t_mins, t_maxs = rays
    found = 0
    for i, k in enumerate(targets):
        exact = ExactSphere(origins[i], directions[i], centers[k], radii[k], is_far)
        rows = np.arange(hits.ray_splits[i], hits.ray_splits[i + 1])
        rows = rows[hits.prim_id[rows] == k]
        ts = hits.t[rows]
        found += len(ts)
        where = f"ray {i}: {origins[i].tolist()} + t {directions[i].tolist()}, sphere {k}"
        assert len(ts) <= 2, where
        assert ((ts >= t_mins[i]) & (ts <= t_maxs[i])).all(), where
        if len(ts) == 2:
            assert exact.may_hit(), where
            assert exact.is_entry(ts[0]), where
            assert exact.is_exit(ts[1]), where
        elif len(ts) == 1:
            is_entry, is_exit = exact.is_entry(ts[0]), exact.is_exit(ts[0])
            assert exact.may_hit(), where
            assert is_entry or is_exit, where
            # The other one is not within the interval, or might not be.
            if is_entry and not is_exit:
                assert not exact.must_leave_within(t_mins[i], t_maxs[i]), where
            if is_exit and not is_entry:
                assert not exact.must_enter_within(t_mins[i], t_maxs[i]), where
        else:
            assert not exact.must_enter_within(t_mins[i], t_maxs[i]), where
            assert not exact.must_leave_within(t_mins[i], t_maxs[i]), where
    return found
