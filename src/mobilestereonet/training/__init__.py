"""Training: losses, recipes as data, the Lightning module."""
