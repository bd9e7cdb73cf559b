"""Mark a model and check the copy with a running service: `python service_client.py ADDRESS MODEL FOLDER`.

The API key is read from the environment variable MARK3DGS_API_KEY. Needs the package httpx.
"""

import os
import sys
from pathlib import Path

from mark3dgs.client import Client

address, source, folder = sys.argv[1], sys.argv[2], Path(sys.argv[3])
with Client(address, os.environ["MARK3DGS_API_KEY"]) as client:
    made = client.embed(source, profile="fast", copy_name="acme")
    copy = client.download(made.asset_id, folder / "acme.spz", format="spz")
    found = client.verify(copy)  # compared with every asset that the API key's tenant registered
    print(f"{found.verdict}: asset {found.asset_id}, false claim at most 10^{found.log10_false_claim:.0f}")
    client.report(found.claim_id, folder / "report.html")
