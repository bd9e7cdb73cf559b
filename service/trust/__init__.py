"""What others rely on: keys and their seals, the audit log, signatures and time stamps."""
