"""Running the cells of a study: here, in several processes, or on a Dask cluster; stopped and resumed at any cell."""

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import TypedDict

from engine.errors import InputError, Mark3DGSError
from engine.extras import load_extra
from engine.lab.evaluate.machine import machine_info, peak_memory_mb
from engine.lab.evaluate.study import Cell, Row
from engine.numerics.plain import plain

__all__ = ["run_cells", "write_whole"]

Tell = Callable[[str, float], None]


class Measured(TypedDict):
    """What a cell's file holds."""

    digest: str
    work: str
    arguments: Mapping[str, object]
    rows: list[Row]
    seconds: float
    peak_memory_mb: float
    machine: Mapping[str, object]


def run_cells(
    cells: Sequence[Cell], folder: Path, *, workers: int = 1, dask: str | None = None, tell: Tell | None = None
) -> list[Row]:
    """Rows of all cells, each with its ``"cell"``, in their order; what a folder already holds is not measured again.

    Parameters
    ----------
    folder : Path
        Gets one ``<cell>.json`` for each, complete or not at all.
    workers : int
        Local processes; 1 runs in this one. Timings need 1.
    dask : str, optional
        Address of a scheduler whose workers see the same files under the same paths.
    tell : callable, optional
        Called with a cell's name and the fraction done.

    Raises
    ------
    InputError
        If two cells have one name, or Dask is requested and not installed.
    """
    names = [cell.name for cell in cells]
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InputError(f"two cells are called {twice!r}")
    folder.mkdir(parents=True, exist_ok=True)
    tell = tell or (lambda name, done: None)
    done = {cell.name: rows for cell in cells if (rows := _stored(cell, folder)) is not None}

    def starts(cell: Cell) -> Cell:
        tell(cell.name, len(done) / len(cells))
        return cell

    left = [cell for cell in cells if cell.name not in done]
    here = dask is None and workers == 1
    results = ((cell, measure(starts(cell))) for cell in left) if here else _elsewhere(left, workers, dask)
    for cell, result in results:
        write_whole(folder / f"{cell.name}.json", (json.dumps(result, indent=1) + "\n").encode())
        done[cell.name] = result["rows"]
        tell(cell.name, len(done) / len(cells))
    return [{"cell": name, **row} for name in names for row in done[name]]


def measure(cell: Cell) -> Measured:
    """Run one cell wherever this process is; its rows, and what it took."""
    began = time.perf_counter()
    try:
        rows = cell.run()
    except Mark3DGSError as error:
        raise InputError(f"cell {cell.name}: {error}") from error
    return {
        "digest": cell.digest,
        "work": cell.work,
        "arguments": cell.arguments,
        "rows": plain(rows),
        "seconds": time.perf_counter() - began,
        "peak_memory_mb": peak_memory_mb(),
        "machine": machine_info(),
    }


def write_whole(path: Path, content: bytes) -> None:
    """A file is complete or as it was before."""
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(content)
    os.replace(part, path)


def _elsewhere(cells: Sequence[Cell], workers: int, dask: str | None) -> Iterator[tuple[Cell, Measured]]:
    """Results of other processes, as they come."""
    with _executor(workers, dask) as executor:
        waiting = {executor.submit(measure, cell): cell for cell in cells}
        try:
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        except BaseException:
            for future in waiting:
                future.cancel()
            raise


@contextmanager
def _executor(workers: int, dask: str | None) -> Iterator[Executor]:
    if dask is None:
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            yield pool
        return
    Client = load_extra("distributed", "dask", "--dask").Client
    try:
        client = Client(dask, timeout=10)
    except OSError as error:
        raise InputError(f"no Dask scheduler answers at {dask!r}: {error}") from None
    with client:
        yield client.get_executor(pure=False)


def _stored(cell: Cell, folder: Path) -> list[Row] | None:
    """Rows of an earlier run, if they are of this very cell."""
    try:
        result = json.loads((folder / f"{cell.name}.json").read_text())
    except (FileNotFoundError, json.JSONDecodeError):
        return None
    rows: list[Row] | None = result["rows"] if result.get("digest") == cell.digest else None
    return rows
