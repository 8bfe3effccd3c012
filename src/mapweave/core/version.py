"""The version, told in every result."""

__version__ = "0.4.0.dev0"
