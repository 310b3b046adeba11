"""PNG and WebP as encodings of images, and Pillow images as values in messages."""
