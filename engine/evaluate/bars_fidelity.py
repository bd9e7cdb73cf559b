"""Fidelity, message lengths, outputs and budgets of an embedding (`mark3dgs bench fidelity`)."""

from pathlib import Path
from typing import Any

from engine.compress.pruning import PruneConfig
from engine.errors import CapacityError
from engine.evaluate.marked_scene import mark_scene
from engine.formats import encode_model
from engine.pipeline.profiles import EmbedConfig, profile
from engine.pipeline.verification import VerifyConfig, verify_model

LENGTHS = (16, 32, 48, 64, 128, 256)
BUDGETS_DB = (40.0, 35.0, 30.0)
FIELDS = (
    "gaussians_out",
    "psnr_worst_view",
    "ssim_worst_view",
    "psnr_total_worst_view",
    "psnr_pruned_worst_view",
    "predicted_z_per_bit",
    "capacity_bits",
)


def bench_fidelity(path: Path, profile_name: str, seed: int = 0) -> list[dict[str, Any]]:
    """One row for each message length, for "compact", and for each pruning budget; bits read from the model."""
    plain = profile(profile_name, landmark_views=0)
    cases: list[tuple[str, int, EmbedConfig]] = [(f"{bits} bits", bits, plain) for bits in LENGTHS]
    cases.append(("compact", 32, profile(profile_name, landmark_views=0, output="compact")))
    for budget in BUDGETS_DB:
        pruned = profile(profile_name, landmark_views=0, prune=PruneConfig(budget_db=budget))
        cases.append((f"budget {budget:g} dB", 32, pruned))
    rows = []
    for name, bits, config in cases:
        row: dict[str, Any] = {"scene": path.name, "case": name}
        try:
            scene = mark_scene(path, config, bits=bits, seed=seed)
        except CapacityError as refusal:
            rows.append({**row, "refused": str(refusal), "capacity_bits": refusal.capacity})
            continue
        claim = verify_model(scene.marked, scene.opened, VerifyConfig(route="model")).claim
        row |= {field: scene.report[field] for field in FIELDS if field in scene.report}
        row |= {"bit_accuracy": claim.bit_accuracy, "z": claim.z}
        if name == "compact":
            row["sog_bytes_per_gaussian"] = len(encode_model(scene.marked, "sog")) / len(scene.marked)
        rows.append(row)
    return rows
