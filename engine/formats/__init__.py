"""Files in and out: Gaussian models in seven formats, cameras in four, point clouds in three.

One folder per format; what they share lies here: `guards` before anything is read, `repairs` after it is decoded.
Nothing here renders; all rooms above may import it, most by the names below. Start at
`model_reading.read_model`, then `repairs.clean`, which every reader ends in. A new format is a module of
`kinds`.
"""

from engine.formats.cameras.files import read_cameras, write_cameras
from engine.formats.file_writing import encode_model, write_model
from engine.formats.known_formats import FORMATS
from engine.formats.model_reading import LoadedModel, read_model
from engine.formats.repairs import Repair

__all__ = [
    "FORMATS",
    "LoadedModel",
    "Repair",
    "encode_model",
    "read_cameras",
    "read_model",
    "write_cameras",
    "write_model",
]
