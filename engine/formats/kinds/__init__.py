"""The kinds of model files. Each module here declares its formats in `KINDS`, and is found by being here.

A module is loaded with the first model that is read, so it imports what decodes a format only in order to decode.
"""
