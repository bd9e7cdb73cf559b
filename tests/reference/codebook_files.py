"""Slow twin of `engine.scenes.codebook_files`: loads as the public code does, trusting the files.

Only for files that a test has written itself: it unpickles.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch


def load_trusting(folder: Path) -> dict[str, Any]:
    """Group -> (N, d) values looked up, for every quantised group."""
    centers = torch.load(folder / "kmeans_centers.pth", weights_only=False)
    args = np.load(folder / "kmeans_args.npy", allow_pickle=True).item()
    digits = "".join(f"{byte:08b}" for byte in (folder / "kmeans_inds.bin").read_bytes())[: args["total_len"]]
    width = args["n_bits"]
    indices = [int(digits[start : start + width], 2) for start in range(0, len(digits), width)]
    table = np.reshape(indices, (len(args["params"]), -1))
    return {name: centers[name].numpy()[table[k]] for k, name in enumerate(args["params"])}
