"""Logs become events, one file a format."""
