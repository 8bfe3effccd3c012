"""Where robots should drive: ``choose(maps, poses, cfg) -> commands``."""
