"""Which observation belongs to which landmark, beam or map."""
