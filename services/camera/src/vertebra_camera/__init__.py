"""Camera images on the backbone: from devices, files, network streams and other keys."""
