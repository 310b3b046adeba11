"""What YARP's bytes mean; nothing here does I/O."""
