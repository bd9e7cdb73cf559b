"""Content Credentials (C2PA) of a marked model: signed by whoever delivers it, with the mark as its soft binding.

Start at `manifest`. Nothing here decides anything about a mark: a manifest is somebody's signed word, and no verdict
reads one.
"""
