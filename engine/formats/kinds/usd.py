"""OpenUSD as text, in binary and in an archive, see `engine.formats.usd`."""

from collections.abc import Iterable

from engine.formats.declaration import Kind, Read
from engine.model import GaussianModel


def _kind(name: str, *endings: str) -> Kind:
    def is_one(data: bytes, file: str) -> bool:
        from engine.formats.usd.scene import kind_of_usd

        return data.startswith((b"PXR-USDC", b"#usda", b"PK")) and kind_of_usd(data) == name

    def read(data: bytes, file: str, spz_frame: str) -> Read:
        from engine.formats.usd.scene import read_usd

        return read_usd(data, file=file)

    def write(model: GaussianModel) -> Iterable[bytes]:
        from engine.formats.usd.scene import write_usd

        return [write_usd(model, name)]

    def load(purpose: str) -> object:
        from engine.formats.usd.scene import load_usd

        return load_usd(purpose)

    return Kind(name, is_one, read, write, endings=endings, load=load, holds=("harmonics",))


KINDS = (_kind("usda"), _kind("usdc", "usd"), _kind("usdz"))
