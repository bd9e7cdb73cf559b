"""The main job as requests and answers, between files: mark a scene, verify a suspect, trace copies.

Each module has a frozen request, one function that serves it, and a frozen answer. Command line and worker call these.
"""
