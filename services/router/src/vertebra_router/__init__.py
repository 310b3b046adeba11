"""The router of the backbone."""
