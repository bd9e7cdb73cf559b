"""A self-made signer, and small models as they are delivered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import pytest

from engine.credentials.signer import Signer, make_trial_signer
from engine.formats import encode_model, read_model

DATA = Path(__file__).parents[1] / "data"
RECORD = "3871513a0d27461d362f21a8244218b9"
"""Id of a record that is nowhere."""


@dataclass(frozen=True)
class Desk:
    """Who signs, and the authority (PEM) that vouches for it."""

    signer: Signer
    authority: str

    def write(self, folder: Path) -> tuple[Path, Path]:
        """Files of certificates and key."""
        paths = folder / "chain.pem", folder / "signer.key"
        for path, content in zip(paths, (self.signer.chain, self.signer.key), strict=True):
            path.write_bytes(content)
        return paths


@pytest.fixture(scope="session")
def desk() -> Desk:
    signer, authority = make_trial_signer("Studio Acme", 30)
    return Desk(signer, authority.decode())


@pytest.fixture(scope="session")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The shipped small scene in each format that a model is delivered in; by format."""
    folder = tmp_path_factory.mktemp("models")
    model = read_model(DATA / "train_1000.ply").model
    found = {}
    for kind in ("sog", "glb", "splat"):
        found[kind] = folder / f"small.{kind}"
        found[kind].write_bytes(encode_model(model, kind))
    return found
