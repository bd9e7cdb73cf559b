"""How far a job is on the whole: the stages that it goes through, and the share of its time that each takes.

Measured on 100,000 Gaussians and two cores (docs/RESULTS.md, "The service"); larger ones move shares by a tenth.
"""

from service.jobs.port import FINAL, Job, State

_EMBED = {"screen": 5, "read": 1, "choose": 0, "look": 14, "prune": 1, "quantize": 2, "landmarks": 46, "plan": 20}
_EMBED |= {"mark": 7, "record": 1, "write": 1, "picture": 2, "commit": 0}
_AUTO = _EMBED | {"choose": 37, "look": 1, "plan": 5, "mark": 2}
_MODEL = {"screen": 10, "read": 1, "open record": 5, "register": 17, "model": 8, "decide": 4, "picture": 55}
_MODEL |= {"commit": 0}
_PICTURE = {"screen": 10, "read": 1, "open record": 2, "find camera": 30, "read picture": 40, "decide": 2}
_PICTURE |= {"picture": 15, "commit": 0}


def course(job: Job) -> float | None:
    """Share of the whole job that is done, 0 to 1; None where that cannot be said."""
    if job.state is State.QUEUED:
        return 0.0
    if job.state in FINAL:
        return 1.0 if job.state in (State.SUCCEEDED, State.DISPUTED) else None
    pictures = len(job.request.get("images") or ())
    if pictures > 1 or job.kind == "dispute":  # they go through the same stages again and again
        return None
    chosen = job.request.get("profile") == "auto"
    shares = (_AUTO if chosen else _EMBED) if job.kind == "embed" else _PICTURE if pictures else _MODEL
    if job.stage not in shares:  # kernels are compiled, or one of several records is asked
        return None
    before = sum(list(shares.values())[: list(shares).index(job.stage)])
    return (before + shares[job.stage] * min(max(job.fraction, 0.0), 1.0)) / sum(shares.values())
