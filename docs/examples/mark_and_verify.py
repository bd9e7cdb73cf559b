"""Mark a model, take a piece of the marked copy, and verify it: `python mark_and_verify.py MODEL FOLDER`."""

import sys
from pathlib import Path

import mark3dgs

source, folder = sys.argv[1], Path(sys.argv[2])
loaded = mark3dgs.read_model(source)
key = mark3dgs.OwnerKey.generate()
key.write(folder / "owner.key")

# Few small views and no landmarks: quick, but pictures can then be read only if their camera is known.
settings = mark3dgs.profile("fast", views=3, view_size=256, landmark_views=0)
made = mark3dgs.embed(loaded.model, key, original_sha256=loaded.sha256, config=settings, copy="acme")
mark3dgs.write_model(made.model, folder / "marked.spz")
(folder / "acme.record").write_bytes(made.record.to_bytes(key))

# Later: half of the Gaussians of the published file, and the unmarked original.
record = mark3dgs.open_record((folder / "acme.record").read_bytes(), key)
published = mark3dgs.read_model(folder / "marked.spz").model
for name, suspect in (("piece", published.take(range(0, len(published), 2))), ("original", loaded.model)):
    claim = mark3dgs.verify_model(suspect, record).claim
    print(f"{name}: {claim.verdict}, z {claim.z:.1f}, false claim at most 10^{claim.log10_false_claim:.0f}")
