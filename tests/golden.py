"""Golden runs: digests of all that embed, verify, trace and a claim give, to compare a tree before and after a change.

    python -m tests.golden run OUT.json SCENE...      # some minutes a scene
    python -m tests.golden diff BEFORE.json AFTER.json

Bytes belong to one processor (another rounds other last digits), so a run is compared with one of the same machine
and none is kept here. Only the command line is used: the tool runs in any version of the tree.
"""

from __future__ import annotations

import hashlib
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

VOLATILE = {"seconds", "seconds_by_stage", "render_ms"}
"""Keys of reports that differ from run to run."""

EMBEDDINGS = {
    "fast": ["--profile", "fast", "--copy", "acme"],
    "sister": ["--profile", "fast", "--copy", "bee", "--registered-at", "2026-01-01"],
    "compact": ["--profile", "balanced", "--output", "compact", "--budget", "40", "--bits", "48"],
    "strong": ["--profile", "strong", "--message", "c0ffee42"],
    "auto": ["--profile", "auto"],
}


class Golden:
    """A run in a folder of its own; every command leaves a digest under its name."""

    def __init__(self, folder: str) -> None:
        self.folder, self.found = Path(folder), dict[str, Any]()
        keys = "from engine.watermark.keys import OwnerKey as K; "
        keys += "K(bytes(range(32))).write('owner.key'); K(bytes(range(1, 33))).write('wrong.key')"
        self._python("-c", keys)

    def command(self, name: str, *arguments: str) -> None:
        done = self._python("-m", "service.cli", *arguments, "--json")
        report = _steady(json.loads(done.stdout))
        digest = hashlib.sha256(json.dumps([done.returncode, report], sort_keys=True).encode()).hexdigest()
        self.found[name] = {"digest": digest, "report": report}
        sys.stderr.write(f"{name}: exit {done.returncode}\n")

    def file(self, name: str) -> None:
        self.found[f"{name} bytes"] = {"digest": hashlib.sha256((self.folder / name).read_bytes()).hexdigest()}

    def _python(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        root = str(Path(__file__).resolve().parents[1])
        environment = {**os.environ, "PYTHONPATH": root}
        return subprocess.run(
            [sys.executable, *arguments], cwd=self.folder, env=environment, capture_output=True, text=True, check=False
        )


def run(scene: Path) -> dict[str, Any]:
    """Everything that one scene gives."""
    with tempfile.TemporaryDirectory() as folder:
        golden = Golden(folder)
        (golden.folder / "sold").mkdir()
        for name, options in EMBEDDINGS.items():
            model, record = f"{name}.{'sog' if name == 'compact' else 'ply'}", f"sold/{name}.record"
            golden.command(
                f"embed {name}", "embed", str(scene), model, "--key", "owner.key", "--record", record, *options
            )
            golden.file(model)
            golden.file(record)
        owner = ["--key", "owner.key"]
        mine = ["--record", "sold/fast.record", *owner]
        golden.command("crop", "attack", "crop", "fast.ply", "piece.ply", "--strength", "0.25", "--seed", "7")
        golden.command("move", "attack", "similarity", "piece.ply", "moved.spz", "--strength", "4")
        golden.command("render", "render", "fast.ply", "shot.png", "--view", "5")
        golden.file("shot.png")
        golden.command("jpeg", "attack", "jpeg", "shot.png", "shot.jpg", "--strength", "80")
        golden.command("verify piece", "verify", "moved.spz", *mine)
        golden.command("verify original", "verify", str(scene), *mine)
        golden.command("verify sister", "verify", "sister.ply", *mine)
        golden.command("verify renders", "verify", "fast.ply", "--route", "render", *mine)
        golden.command("verify compact", "verify", "compact.sog", "--record", "sold/compact.record", *owner)
        golden.command("verify picture", "verify", "shot.jpg", *mine)
        golden.command("verify eq 10", "verify", "shot.jpg", "--decoder", "paper", *mine)
        golden.command("wrong key", "verify", "fast.ply", "--record", "sold/fast.record", "--key", "wrong.key")
        golden.command("trace", "trace", "sister.ply", "--records", "sold", *owner)
        golden.command("trace picture", "trace", "shot.jpg", "--records", "sold", *owner)
        return {f"{scene.name}: {name}": entry for name, entry in golden.found.items()}


def compare(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """A line for each entry that differs, with the values of its report that do."""
    lines = []
    for name in before.keys() | after.keys():
        old, new = before.get(name, {}), after.get(name, {})
        if old.get("digest") != new.get("digest"):
            a, b = old.get("report", {}), new.get("report", {})
            values = {key: (a.get(key), b.get(key)) for key in a.keys() | b.keys() if a.get(key) != b.get(key)}
            lines.append(f"{name}: {values}")
    return sorted(lines)


def _steady(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _steady(entry) for key, entry in value.items() if key not in VOLATILE}
    return [_steady(entry) for entry in value] if isinstance(value, list) else value


def main(action: str, *arguments: str) -> int:
    if action == "run":
        out, *scenes = (Path(argument).resolve() for argument in arguments)
        out.write_text(json.dumps({k: v for scene in scenes for k, v in run(scene).items()}, indent=1) + "\n")
        return 0
    before, after = (json.loads(Path(argument).read_text()) for argument in arguments)
    lines = compare(before, after)
    sys.stdout.write("\n".join([*lines, f"{len(before)} entries, {len(lines)} differ"]) + "\n")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
