"""Numbers that peers published, with their conditions; never mixed with what was measured here."""

import tomllib
from dataclasses import dataclass
from importlib.resources import files

__all__ = ["Published", "read_published"]


@dataclass(frozen=True)
class Published:
    """One published number: of what ("bit accuracy", "PSNR", "embedding time", ...), under which conditions (message
    length, attack, reference), and whether reading goes without the unmarked original (blind)."""

    method: str
    venue: str
    year: int
    what: str
    value: float
    unit: str
    conditions: str
    blind: bool
    hardware: str
    source: str

    @property
    def label(self) -> str:
        """As figures and tables name it."""
        return f"{self.method} (published, other hardware, {'blind' if self.blind else 'informed'})"


def read_published() -> list[Published]:
    """All points of ``published.toml``, in its order."""
    text = files("engine.lab.evaluate").joinpath("published.toml").read_text()
    return [Published(**point) for point in tomllib.loads(text)["point"]]
