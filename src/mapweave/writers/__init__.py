"""Results become files other tools open, one file a format; whole or not at all."""
