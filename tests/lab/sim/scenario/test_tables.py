"""Scenarios are read strictly: what does not fit is refused by file, table, name and value."""

from __future__ import annotations

from pathlib import Path

import pytest

from engine.errors import InputError
from engine.lab.sim.scenario import KINDS, read_scenario

PLANT = Path(__file__).parents[3] / "data" / "plant.splat"
OBJECT = f'[[objects]]\nmodel = "{PLANT}"\n'


def written(folder: Path, text: str) -> Path:
    path = folder / "s.toml"
    path.write_text(text)
    return path


def test_a_whole_scenario(tmp_path: Path) -> None:
    text = f"""title = "A"\nseed = 3\n{OBJECT}bits = 16\nshift = [1, 0, 0]
[film]\nsize = [320, 240]\nframes = 2
[[steps]]\ndo = "attack"\nname = "crop"\nstrength = 0.5
[[steps]]\ndo = "pictures"\nlabel = "seen"\nattacks = ["blur", ["jpeg", 30]]
"""
    scenario = read_scenario(written(tmp_path, text))
    assert (scenario.title, scenario.seed, scenario.film.size) == ("A", 3, (320, 240))
    assert [part.bits for part in scenario.parts] == [16]
    assert [step.label for step in scenario.steps] == ["attack crop 0.5", "seen"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "1 to 64 [[objects]], got 0"),
        ("title = ", "no TOML"),
        (OBJECT + OBJECT, "same name"),
        ('[[objects]]\nmodel = "none.ply"', "no file"),
        (OBJECT + "bitts = 3", "did you mean 'bits'"),
        (OBJECT + "bits = 3.5", "bits must be an integer, got 3.5"),
        (OBJECT + "bits = true", "bits must be an integer, got True"),
        (OBJECT + "bits = 300", "bits must lie in 0..256, got 300"),
        (OBJECT + "shift = [1, 2]", "shift must be a list of 3 numbers"),
        (OBJECT + "shift = [1, 2, nan]", "finite"),
        (OBJECT + '[[steps]]\ndo = "explode"', "do is one of attack"),
        (OBJECT + '[[steps]]\nname = "crop"', "do is missing"),
        (OBJECT + '[[steps]]\ndo = "attack"\nname = "krop"', "no attack is called 'krop'"),
        (OBJECT + '[[steps]]\ndo = "attack"\nname = "crop"\nstrenght = 1', "did you mean 'strength'"),
        (OBJECT + '[[steps]]\ndo = "attack"\nname = "jpeg"', "no attack is called 'jpeg'"),
        (OBJECT + '[[steps]]\ndo = "pictures"\nattacks = [["jpeg", 1, 2]]', "names or [name, strength]"),
        (OBJECT + '[[steps]]\ndo = "pictures"\nsize = [8, 8]', "64..4096"),
        (OBJECT + '[[steps]]\ndo = "move"', "shift is missing"),
        (OBJECT + '[[steps]]\ndo = "scale"\nfactor = -1', "factor must be a finite number"),
        (OBJECT + '[[steps]]\ndo = "delete"\nselect = { box = [0,0,0,1,1,1], disc = [0,0,1] }', "give one of"),
        (OBJECT + '[[steps]]\ndo = "delete"\nselect = { ball = [0,0,0,1] }', "give one of"),
        (OBJECT + "[film]\nframes = -1", "frames must lie in 0..1000"),
        (OBJECT + "sped = 1\n", "'sped' is not known"),
    ],
)
def test_refusals(tmp_path: Path, text: str, words: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as caught:
        read_scenario(path)
    assert words in str(caught.value)
    assert "s.toml" in str(caught.value) or "attack" in str(caught.value)


def test_every_kind_says_what_it_takes() -> None:
    kinds = KINDS
    assert {"attack", "pictures", "recolor", "delete", "drop", "press", "add", "remove"} <= set(kinds)
    assert all(kind.summary for kind in kinds.values())


def test_the_examples_read() -> None:
    found = sorted((Path(__file__).parents[4] / "docs" / "scenarios").glob("*.toml"))
    assert len(found) >= 3
    for path in found:
        if path.stem == "capture":  # its photos do not ship with the repository
            with pytest.raises(InputError, match="there is no file"):
                read_scenario(path)
            continue
        assert read_scenario(path).steps, path
