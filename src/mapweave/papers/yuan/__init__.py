"""Yuan, Huang, Tao, Xi: robots that decide where to drive, each with its own submap."""
