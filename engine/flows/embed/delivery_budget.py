"""The ways of spending what an owner allows on a smaller file.

`embed --profile auto --budget DB` leaves the way to the scene: every way keeps DB in the worst key view, against the
original. `auto_profile` rehearses what each leaves of the mark and takes the smallest file that still shows it. To drop
the residual of colours (`compact`) is no way: at the same fidelity no file was smaller for it (docs/RESULTS.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from engine.flows.embed.profiles import EmbedConfig

__all__ = ["ways"]


def ways(config: EmbedConfig, allowed_db: float, sh_degree: int) -> Iterator[EmbedConfig]:
    """Settings that spend an allowance on a model of this degree: pruned as it is, or cut to fewer harmonics first."""
    for degree in range(sh_degree + 1):
        yield replace(config, prune=replace(config.prune, budget_db=allowed_db, sh_degree=degree))
