"""glTF 2.0 with KHR_gaussian_splatting. Start at `scene`."""
