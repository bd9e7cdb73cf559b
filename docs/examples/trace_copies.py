"""Mark a copy for each recipient, then find out whose copy leaked: `python trace_copies.py MODEL`."""

import sys

import mark3dgs

loaded = mark3dgs.read_model(sys.argv[1])
key = mark3dgs.OwnerKey.generate()
settings = mark3dgs.profile("fast", views=3, view_size=256, landmark_views=0)
recipients = ["acme", "bolt", "cord"]
made = mark3dgs.embed_copies(loaded.model, key, recipients, original_sha256=loaded.sha256, config=settings)

copies, records = [], []
for each in made:
    copies.append(each.model)
    records.append(mark3dgs.open_record(each.record.to_bytes(key), key))

leaked = copies[1].take(range(0, len(copies[1]), 3))  # a third of the Gaussians of bolt's copy
traced = mark3dgs.trace_model(leaked, records)
print("named:", ", ".join(finding.copy for finding in traced.named))
