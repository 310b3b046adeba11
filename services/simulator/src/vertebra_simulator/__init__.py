"""A robot to try everything with: a YARP head with joints, a camera and an IMU."""
