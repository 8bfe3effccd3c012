"""Files, one format a module: logs become events, results become files other tools open, whole or not at all."""
