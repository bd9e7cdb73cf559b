"""Tasks `screen` and `index`: which registered assets may a suspect come from? No owner key comes near them."""

from pathlib import Path

from engine.catalogue.catalogue import Catalogue, screen_model, screen_pictures
from engine.catalogue.config import CONFIG
from engine.catalogue.entry import Entry
from engine.errors import FormatError
from engine.formats import write_model
from engine.registration.config import CONFIG as REGISTRATION
from engine.registration.sketch import SuspectIndex
from service.work.inputs import load_model, load_pictures
from service.work.process import Progress, Reply, Request

LIKELY_MODELS, LIKELY_PICTURES = 1, 5
"""Assets that are worth a look where none is alike: a picture may show too little for the index, and enough to read."""
CLEAR = 4.0
"""So many times the votes that are enough make likeness clear. Finer steps would show slight changes of a model."""


def screen(request: Request, folder: Path, progress: Progress) -> Reply:
    """Contract: docs/SERVICE.md."""
    catalogue, damaged = _open(request)
    progress("screen", 0.1)
    among = set(request["among"])
    model = None if request.get("model") is None else load_model(request).model
    if model is not None:
        found = screen_model(catalogue, SuspectIndex(model), among)
        few, unknown, enough = LIKELY_MODELS, damaged, float(REGISTRATION.sketch.alike)
    else:
        found = screen_pictures(catalogue, load_pictures(request["images"]), among)
        few, unknown, enough = LIKELY_PICTURES, damaged + catalogue.unseen, CONFIG.shown
    progress("screen", 1.0)
    alike = [each.name for each in found if each.alike]
    likely = [each.name for each in found if not each.alike][:few]
    unknown = [name for name in unknown if name in among]
    if request.get("plain") and model is not None and alike + unknown:
        write_model(model, folder / request["plain"])
    scores = {each.name: 100 if each.votes >= CLEAR * enough else 50 for each in found if each.alike}
    return {"alike": alike, "likely": likely, "unknown": unknown, "scores": scores}


def index(request: Request, folder: Path, progress: Progress) -> Reply:
    """Contract: docs/SERVICE.md."""
    progress("index", 0.0)
    catalogue, damaged = _open(request)
    (folder / "catalogue").mkdir()
    catalogue.save(folder / "catalogue")
    return {"folder": "catalogue", "assets": len(catalogue), "damaged": damaged}


def _open(request: Request) -> tuple[Catalogue, list[str]]:
    """The kept index with the entries that it lacks; and those that could not be read."""
    entries, damaged = {}, []
    for name, path in request["entries"].items():
        try:
            entries[name] = Entry.from_bytes(Path(path).read_bytes())
        except (FormatError, OSError):
            damaged.append(name)  # it must not hide the others
    if not request["catalogue"]:
        return Catalogue.build(list(entries), entries.__getitem__), damaged
    catalogue = Catalogue.load(Path(request["catalogue"]), growing=bool(entries))
    for name, entry in entries.items():
        catalogue.add(name, entry)
    return catalogue, damaged
