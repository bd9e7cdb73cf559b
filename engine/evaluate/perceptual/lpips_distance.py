"""LPIPS, where its network's weights can be had: the optional package `lpips` and a file given by the user."""

import pickle
from collections.abc import Callable

import numpy as np

from engine.errors import InputError
from engine.model import Float32

__all__ = ["load_lpips"]


def load_lpips(weights: str) -> Callable[[Float32, Float32], float]:
    """The distance of Zhang et al. (CVPR 2018), version 0.1 on AlexNet.

    Parameters
    ----------
    weights : str
        File with torchvision's AlexNet state dict (``features.0.weight``, ...), as ``torch.save`` writes it. The
        linear layers come with the package.

    Returns
    -------
    callable
        Two pictures (H, W, 3) in 0..1 -> distance, 0 for equal ones.

    Raises
    ------
    InputError
        If the package is not installed, or the file is missing or holds something else.
    """
    try:
        import lpips
        import torch
    except ModuleNotFoundError as error:
        raise InputError(f"--lpips-weights needs the packages lpips and torchvision: {error}") from None
    network = lpips.LPIPS(net="alex", pnet_rand=True, verbose=False)
    try:
        stored = torch.load(weights, map_location="cpu", weights_only=True)
        state = {
            name: stored["features." + name.split(".", 1)[1]]  # slice3.6.weight is features.6.weight
            for name in network.net.state_dict()
        }
        network.net.load_state_dict(state)
    except FileNotFoundError:
        raise InputError(f"{weights}: no such file") from None
    except (KeyError, TypeError, RuntimeError, pickle.UnpicklingError, EOFError):
        raise InputError(f"{weights}: not the weights of torchvision's AlexNet") from None

    def distance(a: Float32, b: Float32) -> float:
        pair = [
            torch.from_numpy(np.ascontiguousarray(np.clip(image, 0, 1).transpose(2, 0, 1)))[None] for image in (a, b)
        ]
        with torch.no_grad():
            return float(network(*pair, normalize=True))

    return distance
