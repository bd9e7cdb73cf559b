"""Content Credentials (C2PA) of a marked model: signed by its publisher, with the mark as its soft binding.

Start at `manifest`. Nothing here decides anything about a mark: a manifest is its signer's statement, and no verdict
reads one.
"""
