"""What is asked is counted first, along the routes of the suspect's kind."""

from __future__ import annotations

import numpy as np
import pytest

from engine.errors import InputError
from engine.flows.verify.search import Suspect, VerifyConfig, count_tries
from engine.lab.evaluate.marked_scene import MarkedScene


def test_every_record_along_every_route_at_every_place_is_a_try() -> None:
    assert count_tries(3, ("model", "render"), VerifyConfig()) == 27
    assert count_tries(3, ("model",), VerifyConfig(), places=4) == 72
    assert count_tries(3, ("model",), VerifyConfig(tries=1000)) == 1000
    assert count_tries(3, ("model",), VerifyConfig(tries=2)) == 18, "a caller cannot count less than there is"


def test_routes_are_those_of_the_suspects_kind(scene: MarkedScene) -> None:
    model, picture = Suspect(scene.original), Suspect(None, [np.zeros((8, 8, 3), np.float32)])
    assert (model.routes("auto"), model.routes("render")) == (("model", "render"), ("render",))
    assert picture.routes("auto") == picture.routes("image") == ("image",)
    with pytest.raises(InputError, match="takes pictures"):
        model.routes("image")
    with pytest.raises(InputError, match="'model' takes a model"):
        picture.routes("model")
    with pytest.raises(InputError, match="empty"):
        Suspect(scene.original.take(np.arange(0))).routes("auto")
