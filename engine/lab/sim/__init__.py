"""MarkGS-Sim: what happens to stolen models and screenshots, as functions with named strengths.

An attack is one function under `@ATTACKS.add` (see `attack`) in the module of its kind: `image_attacks`, `views` and
`adversaries.denoising` for pictures, `model_*` and the other adversaries for models; `attacks` gathers the modules.
`suite` runs the list of `suite.toml`, `scenario` plays whole lives.
"""
