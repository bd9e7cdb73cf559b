"""Jobs over HTTP: where one stands, its progress as it goes, cancelling it. Start at `endpoints`."""
