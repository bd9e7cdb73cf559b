"""How powers, probabilities and times are written; nothing measured is called certain."""

import math
from dataclasses import dataclass
from datetime import datetime

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
SMALLEST = 300
"""Of smaller probabilities no exponent is written: it says nothing to a person."""
_CERTAIN = 0.9999
"""No measured probability is said to be larger."""


@dataclass(frozen=True)
class Form:
    """How powers and names are written: the one difference between words in a terminal and words on a page."""

    raised: bool

    def power(self, base: int, exponent: int) -> str:
        """10^-9, or with the exponent raised."""
        return f"{base}{str(exponent).translate(_RAISED)}" if self.raised else f"{base}^{exponent}"

    def name(self, text: str) -> str:
        """A name given by a user, in quotes."""
        return f"“{text}”" if self.raised else repr(text)

    def odds(self, log10_probability: float) -> str:
        """A bound on a probability as "at most 1 in 10^N", or "below 10^-300"; never overstated."""
        exponent = math.floor(-log10_probability + 1e-9)
        if exponent > SMALLEST:
            return f"below {self.power(10, -SMALLEST)}"
        if exponent >= 1:
            return f"at most 1 in {self.power(10, exponent)}"
        hundredths = math.ceil(100.0 * 10.0**log10_probability)
        return f"at most {hundredths} in 100" if hundredths < 100 else "no better than chance"

    def rate(self, probability: float) -> str:
        """A small probability that was chosen, not measured: "1 in 10^9"."""
        digits, exponent = f"{probability:.1e}".split("e")
        return f"{digits.removesuffix('.0')} in {self.power(10, -int(exponent))}"


PLAIN, TYPOGRAPHIC = Form(raised=False), Form(raised=True)


def number(value: float, digits: int = 3) -> str:
    """A number rounded to so many significant digits and written without an exponent: 1230, 0.000012."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value + 0.0:.0f}"  # -0.0, too
    places = digits - 1 - math.floor(math.log10(abs(value)))
    text = f"{round(value, places):.{max(0, places)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def percent(share: float) -> str:
    """A share in percent that says 100 % only of the whole."""
    if 0.999 <= share < 1.0:
        return "more than 99.9 %"
    return f"{100.0 * share:.1f} %".replace(".0 %", " %")


def surely(probability: float) -> str:
    """A probability in percent; nothing measured is ever certain."""
    return percent(min(probability, _CERTAIN))


def when(at: str) -> str:
    """2026-11-03T09:14:07.123456+00:00 as a person writes it; what is no such time stays as it is."""
    try:
        time = datetime.fromisoformat(at)
    except ValueError:
        return at
    return f"{time.day} {time:%B %Y}, {time:%H:%M:%S} UTC"
