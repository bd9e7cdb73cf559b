"""Files in and out: Gaussian models in five formats, cameras in four."""

from engine.formats.cameras.files import read_cameras, write_cameras
from engine.formats.reading import FORMATS, LoadedModel, read_model
from engine.formats.repairs import Repair
from engine.formats.writing import encode_model, write_model

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
