"""What the rows of one scene add up to: one result a setting, the Pareto front, the cheapest that meets a wish."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from engine.evaluate.pareto.points import BASE, Point, config_of
from engine.evaluate.study import Row
from engine.watermark.statistics import CHANCE_RATE, z_threshold

__all__ = ["Result", "cheapest", "pareto_front", "results"]


@dataclass(frozen=True)
class Result:
    """One setting on one scene.

    Parameters
    ----------
    embed_seconds : float
        Sum of the medians of all stages, the landmark bank included.
    cpu_seconds : float
        Processor time of the same, all threads together: it hardly depends on what else the machine does.
    worst_z : float
        Lowest of all attacks and pictures.
    worst_attack : str
        Where it was.
    matching, read : int
        Bits right and read, all attacks together.
    held_out_db : float
        PSNR of the mark in the worst view that no key view was, dB.
    row : dict
        Everything else.
    """

    point: Point
    embed_seconds: float
    cpu_seconds: float
    worst_z: float
    worst_attack: str
    matching: int
    read: int
    held_out_db: float
    row: Row

    @property
    def all_bits(self) -> bool:
        """Whether every bit was read right after every attack."""
        return self.matching == self.read

    @property
    def frames_per_second(self) -> float:
        """Of the marked model, on this machine."""
        return 1000.0 / float(self.row["frame_ms"])

    @property
    def picture_bits(self) -> float:
        """Per cent of bits right in attacked pictures, the worst attack."""
        return min(100.0 * int(told["matching"]) / int(told["read"]) for told in self._attacked_pictures())

    @property
    def picture_z(self) -> float:
        """z of the worst attacked picture."""
        return min(float(told["z"]) for told in self._attacked_pictures())

    def _attacked_pictures(self) -> list[dict[str, Any]]:
        return [told for label, told in self.row["attacks"].items() if label.startswith("picture, ")]


def results(rows: Sequence[Row]) -> list[Result]:
    """Results of one scene's rows, in their order; settings that were refused are left out."""
    measured = [row for row in rows if "refused" not in row]
    base = next((row for row in measured if Point.make(row["point"]) == BASE), None)
    wall, cpu = 0.0, 0.0
    if base is not None:
        first, *others = base["cpu_seconds"]
        wall, cpu = float(base["stages"]["landmarks"]), first - statistics.median(others or [first])
    return [_result(row, wall, cpu) if row["shares_landmarks"] else _result(row, 0.0, None) for row in measured]


def _result(row: Row, bank: float, bank_cpu: float | None) -> Result:
    """One row's result, with the time of a landmark bank that it shares."""
    cpu = row["cpu_seconds"]
    attacks: dict[str, Any] = row["attacks"]
    worst = min(attacks, key=lambda label: attacks[label]["z"])
    return Result(
        Point.make(row["point"]),
        sum(row["stages"].values()) + bank,
        cpu[0] if bank_cpu is None else statistics.median(cpu) + bank_cpu,
        float(attacks[worst]["z"]),
        worst,
        sum(told["matching"] for told in attacks.values()),
        sum(told["read"] for told in attacks.values()),
        min(row["psnr_held_out"]),
        row,
    )


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of points (cost, worth) that no other beats in one without losing in the other, cheapest first."""
    order = sorted(range(len(points)), key=lambda i: (points[i][0], -points[i][1]))
    front: list[int] = []
    for index in order:
        if not front or points[index][1] > points[front[-1]][1]:
            front.append(index)
    return front


def cheapest(found: Sequence[Result], *, margin: float, least_db: float, bits: int = 32) -> Result | None:
    """The setting of least embedding time that meets a wished accuracy; None where none does.

    Parameters
    ----------
    found : sequence of Result
    margin : float
        Times the z that a claim at 1e-9 needs, after the worst attack.
    least_db : float
        Of the mark in unseen views.
    bits : int
        Length of the message; every bit must be read after every attack.
    """
    wanted = margin * z_threshold(CHANCE_RATE)
    # A mark must be read from screenshots, too. A thinner bank loses one in some dozens (docs/RESULTS.md), which the
    # few that a study takes of each setting do not show.
    bank = config_of(BASE).landmark_views
    good = [
        result
        for result in found
        if result.point.bits == bits
        and result.all_bits
        and result.worst_z >= wanted
        and result.held_out_db >= least_db
        and result.row["landmark_views"] >= bank
    ]
    return min(good, key=lambda result: result.embed_seconds, default=None)
