"""Seeded worlds, robots and sensors that write the same logs real robots do."""
