"""Robots that decide where to drive: ``choose(maps, poses, cfg) -> commands``."""
