"""Stand-in for the names of LeRobot that the plugin uses; the real one needs PyTorch."""
