"""The annex of a report: how often the method errs, on one page beside the claim, and not signed with it.

Its numbers are those of docs/results, which `error_rates.json` holds: see `engine.lab.evaluate.results_page`.
"""

import json
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from engine.present.numerals import TYPOGRAPHIC
from engine.records.header import FORMAT_VERSION
from engine.watermark.rates import DRAWS
from engine.watermark.statistics import CHANCE_RATE, DISHONEST_CLAIMANT_RATE, z_threshold
from service.claims.report import template

_RATES = Path(__file__).with_name("error_rates.json")


def annex_html(document: Mapping[str, Any]) -> str:
    """One self-contained HTML page of a signed claim, in which the same version gives the same claim the same bytes."""
    return template("annex.html").render(
        claim=document,
        odds=TYPOGRAPHIC.odds(document["log10_false_claim"]),
        rates=json.loads(_RATES.read_text(encoding="utf-8")),
        version=version("mark3dgs"),
        record_format=FORMAT_VERSION,
        chance=z_threshold(CHANCE_RATE, DRAWS),
        search=z_threshold(DISHONEST_CLAIMANT_RATE, 1),
    )
