"""What mapweave does, one verb a file: logs in, typed results out. No terminal here."""
