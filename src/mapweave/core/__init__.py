"""The words every other room uses: SE(2), Gaussians, records, errors, configuration."""
