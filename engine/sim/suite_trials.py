"""The attack suite as data: what each work does to models and pictures, and chains of it.

`literal` is what the words say, `as_code` what public code runs under them. Not to be had without trained networks, and
so left out: regeneration by a variational auto-encoder, editing by a diffusion model (`repaint` stands in for it).
Fine-tuning and re-training have settings of their own and stand in `fine_tuning` and the capture package.
"""

from engine.sim.suite import Trial

__all__ = ["SUITE"]

PAPER, GSPURE, GMEA, NGS = ("Mark3DGS, Table 2", "GSPure (AAAI 2026)", "GMEA (AAAI 2026)", "NGS-Marker (ICLR 2026)")
FLYMARK, GMARKER, GSW, GUARD = (
    "FlyMark (2026)",
    "GaussianMarker (NeurIPS 2024)",
    "3D-GSW (CVPR 2025)",
    "GuardSplat (CVPR 2025)",
)
ROBUST, OURS, TRADE = "Robust3DGSW (CVPR 2026)", "this program", "file formats in trade"
ZHAO, COX, KUTTER = "Zhao et al. (TIP 2005)", "Cox et al. (TIP 1997)", "Kutter et al. (2000)"

_PLACE = (
    Trial("none", (), OURS),
    Trial("similarity x10 and shuffle", (("similarity", 10.0), ("shuffle", 1.0)), NGS),
    Trial("rotate 180 deg", (("rotate", 180.0),), NGS),
    Trial("merged into another scene", (("merge_into", 3.0),), NGS),
    Trial("rotate by any matrix", (("rotate", 1.0),), GMARKER, reading="as_code"),
    Trial("each point shifted by N(0, 1)", (("translate", 1.0),), GMARKER, reading="as_code"),
)
_POPULATION = (
    Trial("partial theft, connected 50 %", (("crop", 0.5),), NGS),
    Trial("partial theft, connected 25 %", (("crop", 0.25),), NGS),
    Trial("partial theft, connected 10 %", (("crop", 0.1),), NGS),
    Trial("partial theft, random 10 %", (("prune_random", 0.9),), FLYMARK),
    Trial("a block of 10 % of the file dropped", (("crop", 0.1),), GMARKER, reading="as_code"),
    Trial("a block of 50 % of the file dropped", (("crop", 0.5),), GMARKER, reading="as_code"),
    Trial("prune random 20 %", (("prune_random", 0.2),), PAPER),
    Trial("prune random 70 %", (("prune_random", 0.7),), FLYMARK),
    Trial("prune by opacity 10 %", (("prune_opacity", 0.1),), FLYMARK),
    Trial("prune by opacity 50 %", (("prune_opacity", 0.5),), FLYMARK),
    Trial("prune by contribution 30 %", (("prune_low_impact", 0.3),), GSPURE),
    Trial("prune by contribution 70 %", (("prune_low_impact", 0.7),), GSPURE),
    Trial("clusters of low contribution 0.1", (("purify", 0.1),), GSPURE),
    Trial("clusters of low contribution 0.25", (("purify", 0.25),), GSPURE),
    Trial("clusters of low contribution 1", (("purify", 1.0),), GSPURE),
    Trial("clone 50 %", (("clone", 0.5),), PAPER),
    Trial("clone 50 %, duplicates", (("clone", 0.5),), GSW, reading="as_code"),
    Trial("inject 5 %", (("inject", 0.05),), FLYMARK),
    Trial("inject 10 %", (("inject", 0.1),), FLYMARK),
    Trial("inject 30 %", (("inject", 0.3),), FLYMARK),
)
_VALUES = (
    Trial("noise 0.1 on all attributes", (("noise_all", 0.1),), GSW),
    Trial("noise 0.3 on all attributes", (("noise_all", 0.3),), GSW),
    Trial("noise 0.1 on all colours", (("noise_colors", 0.1),), PAPER),
    Trial("DC noise 0.005", (("noise_dc", 0.005),), FLYMARK),
    Trial("DC noise 0.01", (("noise_dc", 0.01),), FLYMARK),
    Trial("DC noise 0.02", (("noise_dc", 0.02),), FLYMARK),
    Trial("DC noise 0.2", (("noise_dc", 0.2),), OURS),
    Trial("DC coefficients by N(0, 8^2)", (("noise_colors", 8.0),), GMARKER, reading="as_code"),
    Trial("opacity noise 0.05", (("noise_opacity", 0.05),), FLYMARK),
    Trial("opacity noise 0.2", (("noise_opacity", 0.2),), FLYMARK),
    Trial("position noise 0.001 radii", (("noise_position", 0.001),), FLYMARK),
    Trial("position noise 0.005 radii", (("noise_position", 0.005),), FLYMARK),
    Trial("position noise 0.01 radii", (("noise_position", 0.01),), FLYMARK),
    Trial("position noise N(0, 1)", (("noise_means", 1.0),), GMARKER, reading="as_code"),
    Trial("float16", (("round_floats", 10),), FLYMARK),
    Trial("8-bit float", (("round_floats", 3),), OURS),
    Trial("8 bits, every attribute", (("quantize", 8),), ROBUST),
    Trial("6 bits, every attribute", (("quantize", 6),), ROBUST),
    Trial("4 bits, every attribute", (("quantize", 4),), ROBUST),
    Trial("8 bits, colours", (("quantize_colors", 8),), FLYMARK),
    Trial("6 bits, colours", (("quantize_colors", 6),), FLYMARK),
    Trial("4 bits, colours", (("quantize_colors", 4),), FLYMARK),
    Trial("SH cut to degree 0", (("drop_sh", 0),), FLYMARK),
    Trial("SH baked to RGB", (("bake_colors", 24),), OURS),
    Trial(".splat and back", (("convert", "splat"),), TRADE),
    Trial(".spz and back", (("convert", "spz"),), TRADE),
    Trial(".sog and back", (("convert", "sog"),), TRADE),
    Trial(".compressed.ply and back", (("convert", "compressed.ply"),), TRADE),
)
_ADVERSARIES = (
    Trial("evolved prune and tint, 40 dB", (("evolve", 40.0),), GMEA),
    Trial("evolved prune and tint, 30 dB", (("evolve", 30.0),), GMEA),
    Trial("evolved prune and tint, 25 dB", (("evolve", 25.0),), GMEA),
    Trial("overwritten at 47 dB", (("overwrite", 47.0),), COX),
    Trial("overwritten at 35 dB", (("overwrite", 35.0),), COX),
    Trial("overwritten at 30 dB", (("overwrite", 30.0),), COX),
    Trial("overwritten at 27 dB", (("overwrite", 27.0),), COX),
    Trial("overwritten at 47 dB, three times", (("overwrite", 47.0),) * 3, COX),
    Trial("colours smoothed over 8 neighbours", (("smooth_colors", 8),), OURS),
    Trial("colours smoothed over 64 neighbours", (("smooth_colors", 64),), OURS),
    Trial("repainted 50 %", (("repaint", 0.5),), OURS),
    Trial("repainted 90 %", (("repaint", 0.9),), OURS),
    Trial("repainted 100 %", (("repaint", 1.0),), OURS),
    *(
        Trial(f"{count} copies, {rule}", (("collude", rule),), ZHAO if rule != "mean" else FLYMARK, copies=count - 1)
        for rule in ("mean", "median", "min", "max", "minmax", "modneg", "randneg", "interleave", "patches")
        for count in ((2, 3, 5, 10) if rule == "mean" else (5, 10) if rule in ("minmax", "modneg") else (5,))
    ),
    Trial("mark lifted onto another model", (("transplant", 1.0),), KUTTER, "copy attack"),
    Trial("mark lifted onto another model, x4", (("transplant", 4.0),), KUTTER, "copy attack"),
)
_CHAINS = (
    Trial(
        "crop 25 %, similarity, shuffle, noise 0.02",
        (("crop", 0.25), ("similarity", 4.0), ("shuffle", 1.0), ("noise_all", 0.02)),
        OURS,
    ),
    Trial("crop 25 %, .splat, merged", (("crop", 0.25), ("convert", "splat"), ("merge_into", 1.0)), OURS),
    Trial("prune 50 %, noise 0.1, 6 bits", (("prune_random", 0.5), ("noise_all", 0.1), ("quantize", 6)), OURS),
    Trial("overwritten, smoothed, .splat", (("overwrite", 40.0), ("smooth_colors", 16), ("convert", "splat")), OURS),
    Trial(
        "everything that keeps 27 dB",
        (
            ("overwrite", 40.0),
            ("smooth_colors", 16),
            ("prune_opacity", 0.1),
            ("noise_dc", 0.05),
            ("noise_opacity", 0.05),
            ("quantize", 8),
            ("similarity", 4.0),
            ("shuffle", 1.0),
        ),
        OURS,
    ),
)
_PICTURES = (
    Trial("JPEG 10", (("jpeg", 10),), GSW, "image"),
    Trial("JPEG 50", (("jpeg", 50),), PAPER, "image"),
    Trial("noise std 0.1", (("noise_image", 0.1),), PAPER, "image"),
    Trial("noise std 0.01", (("noise_image", 0.01),), GUARD, "image", "as_code"),
    Trial("rotation 30 deg", (("rotate_image", 30.0),), PAPER, "image"),
    Trial("scale 0.75", (("scale_image", 0.75),), PAPER, "image"),
    Trial("crop 40 % of the area", (("crop_image", 0.4),), PAPER, "image"),
    Trial("crop to side x0.4", (("crop_image", 0.4),), GUARD, "image", "as_code"),
    Trial("blur sigma 1", (("blur", 1.0),), GSW, "image"),
    Trial("brightness x2", (("brightness", 2.0),), GSW, "image"),
    Trial("median 3", (("median", 3),), OURS, "image"),
    Trial("median 7", (("median", 7),), OURS, "image"),
    Trial("bilateral 0.1", (("bilateral", 0.1),), OURS, "image"),
    Trial("non-local means 5", (("denoise_nonlocal", 5),), OURS, "image"),
    Trial("non-local means 10", (("denoise_nonlocal", 10),), OURS, "image"),
    Trial("wavelet shrinkage 0.03", (("denoise_wavelet", 0.03),), OURS, "image"),
    Trial("wavelet shrinkage 0.1", (("denoise_wavelet", 0.1),), OURS, "image"),
    Trial("crop 40 %, scale 0.75, JPEG 50", (("crop_image", 0.4), ("scale_image", 0.75), ("jpeg", 50)), GUARD, "image"),
    Trial(
        "crop, scale, blur, JPEG 10",
        (("crop_image", 0.4), ("scale_image", 0.75), ("blur", 0.8), ("jpeg", 10)),
        GUARD,
        "image",
        "as_code",
    ),
    Trial(
        "rotation 10 deg, crop 20 %, JPEG 50",
        (("rotate_image", 10.0), ("crop_image", 0.2), ("jpeg", 50)),
        OURS,
        "image",
    ),
    Trial("noise 0.05, median 5, JPEG 50", (("noise_image", 0.05), ("median", 5), ("jpeg", 50)), OURS, "image"),
)

SUITE: tuple[Trial, ...] = (*_PLACE, *_POPULATION, *_VALUES, *_ADVERSARIES, *_CHAINS, *_PICTURES)
"""All trials, in the order of a table: placed, cut and added to, changed in value, attacked on purpose, chains,
pictures."""
