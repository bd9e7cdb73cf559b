"""OpenUSD as text, in binary and in an archive, see `engine.formats.usd`."""

from engine.formats.declaration import Kind, later

_SCENE = later("engine.formats.usd.scene")


def _kind(name: str, *endings: str) -> Kind:
    return Kind(
        name,
        lambda data, file: data.startswith((b"PXR-USDC", b"#usda", b"PK")) and _SCENE().kind_of_usd(data) == name,
        lambda data, file, _: _SCENE().read_usd(data, file=file),
        lambda model: [_SCENE().write_usd(model, name)],
        endings=endings,
        load=lambda purpose: _SCENE().load_usd(purpose),
        holds=("harmonics",),
    )


KINDS = (_kind("usda"), _kind("usdc", "usd"), _kind("usdz"))
