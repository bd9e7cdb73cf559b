"""GLB and glTF with KHR_gaussian_splatting, see `engine.formats.gltf`."""

from engine.formats.declaration import Kind, later

_SCENE = later("engine.formats.gltf.scene")

KINDS = (
    Kind(
        "glb",
        lambda data, file: _SCENE().looks_like_gltf(data),
        lambda data, file, place: _SCENE().read_gltf(data, file=file, place=place),
        lambda model: _SCENE().write_glb(model),
        holds=("harmonics",),
    ),
)
