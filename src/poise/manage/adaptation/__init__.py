"""When and where components move while the robot runs."""
