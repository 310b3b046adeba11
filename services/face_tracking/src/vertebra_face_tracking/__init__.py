"""Find faces in camera images and follow them over time."""
