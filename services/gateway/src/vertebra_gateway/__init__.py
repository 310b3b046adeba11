"""The robots of the fleet on the web."""
