"""The YARP adapter: YARP ports, RPC and control boards on the backbone."""
