"""Frames per second and bytes per instruction of a processor's rates (Figure 7, sections 4.2, 5.2).

Figure 7's horizontal line is what the paper's hypothetical architecture does in a second. Its
height is not in our copy; sections 4.2 and 5.2 take the rates of a GeForce3.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from raystream_lab.cost_model import ARCHITECTURES, Cost
from raystream_lab.published import published
from raystream_lab.purcell.image_counts import SIZE
from raystream_lab.purcell.scene_statistics import paper_view
from raystream_lab.results import Cell, Claim, Table, is_near, listed

#: Frames per second that count as real time: our choice.
REAL_TIME = 24.0

#: By view and architecture.
Costs = Mapping[tuple[str, str], Cost]


class Rates(NamedTuple):
    """What a processor does in a second.

    Attributes
    ----------
    instructions, bytes : float
    """

    instructions: float
    bytes: float

    @classmethod
    def published(cls) -> list[Rates]:
        """The GeForce3's, and those of section 5.2 with four times the instructions."""
        speed = published("purcell", "speed").values
        return [cls(one, speed["bytes_per_second"]) for one in speed["instructions_per_second"]]

    @property
    def balance(self) -> float:
        """Bytes per instruction."""
        return self.bytes / self.instructions

    def frames(self, found: Cost) -> float:
        """Images per second, by the slower of instructions and bytes."""
        return min(self.instructions / found.all_instructions, self.bytes / found.all_bytes)


def balance(found: Cost) -> float:
    """Bytes per instruction."""
    return found.all_bytes / found.all_instructions


def second_marks(unit: str) -> dict[str, float]:
    """Figure 7's line: a second of the GeForce3, in billions of ``"instructions"`` or ``"bytes"``.

    Parameters
    ----------
    unit : {"instructions", "bytes"}
    """
    return {"a GeForce3's second": getattr(Rates.published()[0], unit) / 1e9}


def of_paper(theirs: Costs) -> dict[tuple[str, str], Cost]:
    """The costs by the paper's counts, once for each of its views."""
    return {(paper_view(name), architecture): one for (name, architecture), one in theirs.items()}


def frame_table(ours: Costs, theirs: Costs, size: int) -> Table:
    """Frames per second and bytes per instruction, by our counts and by the paper's.

    Parameters
    ----------
    ours, theirs : mapping
        Costs of an image, by view and architecture: ours of size x size pixels, the paper's of its
        own.
    size : int
    """
    slow, fast = Rates.published()
    scale = (size / SIZE) ** 2
    rows: list[list[Cell]] = []
    for case, found in ours.items():
        printed = theirs[case]
        rows.append(
            [
                *case,
                balance(found),
                balance(printed),
                "bytes" if balance(printed) > slow.balance else "instructions",
                *(
                    value
                    for rates in (slow, fast)
                    for value in (rates.frames(found) * scale, rates.frames(printed))
                ),
            ]
        )
    return Table.of(
        "purcell-frames",
        f"Frames per second at the rates of {published('purcell', 'speed').source}, and Figure 7's "
        "line",
        ["view", "architecture", "bytes per instruction", "paper's counts", "its limit"]
        + [
            title
            for rates in (slow, fast)
            for title in (
                f"frames/s, {rates.instructions / 1e9:g} G instructions/s",
                f"{rates.instructions / 1e9:g} G, paper's counts",
            )
        ],
        rows,
        f"Images have {SIZE} x {SIZE} pixels. Both rates have {slow.bytes / 1e9:g} GB/s: "
        f"{slow.balance:g} and {fast.balance:g} bytes per instruction. Costs are those of Table 1; "
        "caches are not included.",
        "The height of Figure 7's line is not in our copy; the plots show the GeForce3's rates.",
    )


def frame_claims(ours: Costs, theirs: Costs) -> list[Claim]:
    """Judge the title's real time, and the balance of both architectures."""
    slow, fast = Rates.published()
    printed = of_paper(theirs)
    balances = {
        architecture: {
            **{f"{name}, paper's counts": balance(one) for name, one in _of(printed, architecture)},
            **{f"{name}, ours": balance(one) for name, one in _of(ours, architecture)},
        }
        for architecture in ARCHITECTURES
    }
    place = published("purcell", "speed").source
    return [
        Claim.judged(
            f"Ray tracing in real time (read as: {REAL_TIME:g} frames/s of {SIZE} x {SIZE} pixels, "
            f"by the paper's own counts, at {rates.instructions / 1e9:g} G instructions/s and "
            f"{rates.bytes / 1e9:g} GB/s)",
            f"Purcell 2002, title; {place}",
            {f"{name}, {kind}": rates.frames(one) >= REAL_TIME for (name, kind), one in rows},
            "frames/s: " + listed({f"{a}, {b}": rates.frames(one) for (a, b), one in rows}),
        )
        for rates in (slow, fast)
        for rows in [list(printed.items())]
    ] + [
        Claim.judged(
            "Multipass balances instructions and bandwidth very well (read as: within a quarter of "
            f"a GeForce3's {slow.balance:g} bytes per instruction)",
            "Purcell 2002, section 4.2",
            {case: is_near(one, slow.balance) for case, one in balances["multipass"].items()},
            "bytes per instruction: " + listed(balances["multipass"]),
        ),
        Claim.judged(
            "Branching is severely limited by instructions (read as in section 5.2: even with four "
            f"times as many it needs less than the {slow.bytes / 1e9:g} GB/s)",
            "Purcell 2002, sections 4.2 and 5.2",
            {case: one < fast.balance for case, one in balances["branching"].items()},
            "bytes per instruction: " + listed(balances["branching"]),
        ),
    ]


def _of(costs: Costs, architecture: str) -> list[tuple[str, Cost]]:
    return [(name, one) for (name, kind), one in costs.items() if kind == architecture]
