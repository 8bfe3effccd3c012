"""Results become figures and one HTML page. Nothing below asks this room for anything."""
