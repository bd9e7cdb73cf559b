"""What the hostile corpus is collected from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from engine.errors import FormatError
from engine.formats import read_model
from tests.service.refused_inputs import READERS, keep_refused


@pytest.mark.parametrize(("module", "name"), READERS[:-1], ids=[name for _, name in READERS[:-1]])
def test_what_a_reader_refuses_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: Any, name: str) -> None:
    keep_refused(tmp_path, monkeypatch.setattr)
    data = b"ply\nno header" if "p" in name else b"x"
    with pytest.raises(FormatError):
        getattr(module, name)(data, file="bad")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [data]


def test_what_is_of_no_format_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    keep_refused(tmp_path, monkeypatch.setattr)
    with pytest.raises(FormatError):
        read_model(b"of no format")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"of no format"]
