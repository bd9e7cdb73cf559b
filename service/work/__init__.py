"""What runs in a step's own process: the engine's work on files, JSON in and JSON out, no database, no network.

Each task is `def task(request, folder, progress) -> reply`: it reads the files that the request names, writes files
into `folder`, and names them in the reply. Secrets come in the request (through a pipe), never on a command line.
"""
