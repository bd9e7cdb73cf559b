"""What the rows of one scene add up to: one result a setting, the Pareto front, the cheapest that meets a wish."""

import statistics
from collections.abc import Sequence
from dataclasses import dataclass

from engine.lab.evaluate.pareto.points import BASE, Point, config_of
from engine.lab.evaluate.study import Row
from engine.watermark.statistics import CHANCE_RATE, z_threshold


@dataclass(frozen=True)
class Result:
    """One setting on one scene, and everything that was measured.

    Seconds to embed are the sum of the medians of all stages, the landmark bank included; processor time of the same,
    all threads together, hardly depends on what else the machine does.
    """

    point: Point
    embed_seconds: float
    cpu_seconds: float
    row: Row

    @property
    def attacks(self) -> dict[str, Row]:
        """What was read after each attack."""
        return dict(self.row["attacks"])

    @property
    def worst_attack(self) -> str:
        """The attack with the lowest z."""
        return min(self.attacks, key=lambda label: float(self.attacks[label]["z"]))

    @property
    def worst_z(self) -> float:
        """Lowest of all attacks and pictures."""
        return float(self.attacks[self.worst_attack]["z"])

    @property
    def matching(self) -> int:
        """Bits right, all attacks together."""
        return sum(after["matching"] for after in self.attacks.values())

    @property
    def read(self) -> int:
        """Bits read, all attacks together."""
        return sum(after["read"] for after in self.attacks.values())

    @property
    def held_out_db(self) -> float:
        """PSNR of the mark in the worst view that no key view was, dB."""
        return float(min(self.row["psnr_held_out"]))

    @property
    def frames_per_second(self) -> float:
        """Of the marked model, on this machine."""
        return 1000.0 / float(self.row["frame_ms"])

    @property
    def picture_bits(self) -> float:
        """Per cent of bits right in attacked pictures, the worst attack."""
        return min(100.0 * int(after["matching"]) / int(after["read"]) for after in self._attacked_pictures())

    @property
    def picture_z(self) -> float:
        """z of the worst attacked picture."""
        return min(float(after["z"]) for after in self._attacked_pictures())

    @property
    def usual_picture_z(self) -> float:
        """z of a picture at JPEG quality 10, mean of several: what a rehearsal promises."""
        return float(self.attacks["picture, JPEG 10"]["usual_z"])

    def _attacked_pictures(self) -> list[Row]:
        return [after for label, after in self.attacks.items() if label.startswith("picture, ")]


def results(rows: Sequence[Row]) -> list[Result]:
    """Results of one scene's rows, in their order; settings that were refused are left out.

    A setting that shares the landmark bank of the base is given that bank's time.
    """
    measured = [(Point(**row["point"]), row) for row in rows if "refused" not in row]
    bank, bank_cpu = 0.0, 0.0
    for point, row in measured:
        if point == BASE:
            first, *others = row["cpu_seconds"]
            bank, bank_cpu = float(row["stages"]["landmarks"]), first - statistics.median(others or [first])
    found = []
    for point, row in measured:
        seconds, cpu = sum(row["stages"].values()), row["cpu_seconds"]
        if row["shares_landmarks"]:
            found.append(Result(point, seconds + bank, statistics.median(cpu) + bank_cpu, row))
        else:
            found.append(Result(point, seconds, cpu[0], row))
    return found


def pareto_front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Indices of points (cost, worth) that no other beats in one without losing in the other, cheapest first."""
    order = sorted(range(len(points)), key=lambda i: (points[i][0], -points[i][1]))
    front: list[int] = []
    for index in order:
        if not front or points[index][1] > points[front[-1]][1]:
            front.append(index)
    return front


def cheapest(found: Sequence[Result], *, margin: float, least_db: float, bits: int = 32) -> Result | None:
    """The setting of least embedding time that reads every bit after every attack; None where none does.

    After the worst attack it keeps `margin` times the z that a claim at 1e-9 needs, and in unseen views `least_db`.
    """
    wanted = margin * z_threshold(CHANCE_RATE)
    # A mark must be read from screenshots, too. A thinner bank loses one in some dozens (docs/RESULTS.md), which the
    # few that a study takes of each setting do not show.
    bank = config_of(BASE).landmark_views
    good = [
        result
        for result in found
        if result.point.bits == bits
        and result.matching == result.read
        and result.worst_z >= wanted
        and result.held_out_db >= least_db
        and result.row["landmark_views"] >= bank
    ]
    return min(good, key=lambda result: result.embed_seconds, default=None)
