"""Profiles, and what an owner asks for on top."""

from __future__ import annotations

from dataclasses import asdict

import pytest

from engine.compress.hvq import HvqConfig
from engine.compress.pruning import PruneConfig
from engine.errors import InputError
from engine.flows.embed.profiles import Auto, EmbedConfig, compose, profile


def test_what_an_owner_asks_for_is_composed() -> None:
    assert compose("fast") == profile("fast")
    assert compose("strong", psnr_db=48.0, output="compact", budget_db=35.0) == profile(
        "strong", psnr_db=48.0, output="compact", prune=PruneConfig(budget_db=35.0)
    )
    assert compose("auto", budget_db=35.0) == Auto(profile("fast", prune=PruneConfig(budget_db=35.0)))
    assert compose("auto", psnr_db=48.0) == Auto(profile("fast", psnr_db=48.0), kept=frozenset({"psnr_db"}))
    with pytest.raises(InputError, match="unknown profile 'quick'"):
        compose("quick")


def test_every_knob_has_a_door() -> None:
    """A changed value of every knob that `config show` lists arrives where it belongs, and nothing else changes."""
    base = asdict(profile("fast"))

    def flat(values: dict, prefix: str = "") -> dict:
        found = {}
        for name, value in values.items():
            found |= flat(value, f"{prefix}{name}.") if isinstance(value, dict) else {f"{prefix}{name}": value}
        return found

    assert len(flat(base)) > 30
    for knob, value in flat(base).items():
        if knob == "device":  # it is looked for at once
            with pytest.raises(InputError, match="must be one of auto, cpu, cuda, got 'tpu'"):
                compose("fast", knobs=["device=tpu"])
            continue
        if isinstance(value, str):
            text, wanted = ("compact", "compact") if knob == "output" else ("paper", "paper")
        elif isinstance(value, tuple):
            text, wanted = "256,128", (256, 128)
        elif isinstance(value, bool):
            text, wanted = str(not value).lower(), not value
        elif isinstance(value, int):
            text, wanted = str(value + 1), value + 1
        else:
            text, wanted = "41.5", 41.5
        turned = flat(asdict(compose("fast", knobs=[f"{knob}={text}"])))
        assert {name for name in turned if turned[name] != flat(base)[name]} == {knob}
        assert turned[knob] == wanted


def test_knobs_of_auto_and_knobs_that_are_none() -> None:
    assert compose("auto", knobs=["quantize.cells=1024"]) == Auto(
        profile("fast", quantize=HvqConfig(cells=1024)), kept=frozenset({"quantize.cells"})
    )
    assert compose("auto", knobs=["psnr_db=48"]) == Auto(profile("fast", psnr_db=48.0), kept=frozenset({"psnr_db"}))
    assert compose("fast", budget_db=30.0, knobs=["prune.budget_db=none"]) == profile("fast")
    for bad in ("cells=3", "quantize=3", "quantize.cell=3", "views.deep=3", ""):
        with pytest.raises(InputError, match="there is no knob"):
            compose("fast", knobs=[bad])
    with pytest.raises(InputError, match=r"views is 6 and cannot be '6.5'"):
        compose("fast", knobs=["views=6.5"])
    with pytest.raises(InputError, match=r"paper.frequency is False and cannot be 'yes'"):
        compose("fast", knobs=["paper.frequency=yes"])
    with pytest.raises(InputError, match="psnr must lie between 20 and 90 dB, got 12"):
        compose("fast", knobs=["psnr_db=12"])


def test_records_say_what_recovery_did_only_where_something_goes() -> None:
    """Without a budget a record is, to the byte, what it was before there was recovery."""
    assert "recover" not in profile("fast").to_json()["prune"]
    assert compose("fast", budget_db=35.0, knobs=["prune.recover=false"]).to_json()["prune"]["recover"] is False
    assert compose("fast", output="compact").to_json()["prune"]["recover"] is True


def test_what_no_record_says_was_fitted_was_not() -> None:
    """Copies of a compact model that an earlier version made come out as it did."""
    config = compose("fast", output="compact")
    assert isinstance(config, EmbedConfig)
    plain = config.to_json()
    assert EmbedConfig.from_json(plain) == config
    del plain["prune"]["recover"]
    assert EmbedConfig.from_json(plain) == compose("fast", output="compact", knobs=["prune.recover=false"])
