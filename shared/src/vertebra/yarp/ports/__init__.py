"""Ports, and the connections between them."""
