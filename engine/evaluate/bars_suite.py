"""The whole list of attacks on one scene, with what each costs the attacker (`mark3dgs bench suite`).

Extraction is informed: every row was read with the owner's record.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from engine.evaluate.marked_scene import MarkedScene, bench_key
from engine.formats import read_model
from engine.model import GaussianModel
from engine.pipeline.embedding import embed
from engine.pipeline.profiles import profile
from engine.pipeline.sealing import open_record
from engine.sim.suite import SUITE, Company, failures_first, run_suite

BITS = 32


def bench_suite(
    path: Path,
    named_profile: str,
    *,
    other: GaussianModel | None = None,
    seed: int = 0,
    advance: Callable[[float], None] | None = None,
) -> list[dict[str, Any]]:
    """Mark as many copies of a scene as its most numerous colluders need, then run `SUITE`.

    Parameters
    ----------
    named_profile : str
        Of the embeddings.
    other : GaussianModel, optional
        The scene merged into and framed by copy attacks; without one these are not run.
    seed : int
        Of key and attacks.
    advance : callable, optional
        Told the fraction of the attacks done.

    Returns
    -------
    list of dict
        See `run_suite`; failures first.
    """
    loaded, key = read_model(path), bench_key(seed)
    config = profile(named_profile, landmark_views=0)
    made = [
        embed(loaded.model, key, original_sha256=loaded.sha256, bits=BITS, config=config, copy=f"buyer {i}")
        for i in range(1 + max(trial.copies for trial in SUITE))
    ]
    opened = open_record(made[0].record.to_bytes(key), key)
    scene = MarkedScene(path.name, loaded.model, made[0].model, opened, made[0].report)
    company = Company([embedding.model for embedding in made[1:]], other)
    return failures_first(run_suite(scene, SUITE, company=company, seed=seed, advance=advance))
