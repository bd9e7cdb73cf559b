"""Records as flows use them: checked, opened, and read together with their attestations."""
