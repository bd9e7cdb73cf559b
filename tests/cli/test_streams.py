"""Standard input in place of a file."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace

import pytest

from engine.cli import streams
from engine.errors import InputError


def test_it_is_spooled_up_to_a_limit(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(streams, "MAX_INPUT_BYTES", 3 << 20)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))

    def given(size: int) -> None:
        stdin = SimpleNamespace(buffer=io.BytesIO(bytes(size)), isatty=lambda: False)
        monkeypatch.setattr("sys.stdin", stdin)

    given(3 << 20)
    with streams.input_file(streams.STREAM) as file:
        assert file.stat().st_size == 3 << 20
    given((3 << 20) + 1)
    with pytest.raises(InputError, match=r"more than 0\.00292969 GiB: save it"), streams.input_file(streams.STREAM):
        pass
    assert not list(tmp_path.iterdir())
