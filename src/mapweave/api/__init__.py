"""What mapweave does, one verb a file: paths or arrays in, typed results out. No terminal here."""
