"""NumPy arrays and scalars as values in messages."""
