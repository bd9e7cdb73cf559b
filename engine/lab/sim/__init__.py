"""MarkGS-Sim: what happens to stolen models and screenshots, as functions with named strengths.

An attack is one function under `@ATTACKS.add` (see `attack`) in the module of its kind: `image_attacks` and
`image_encoders` for pictures, `model_*` and `adversaries` for models; `attacks` gathers the modules.
`suite` runs the list of `suite.toml`, `scenario` plays whole lives.
"""
