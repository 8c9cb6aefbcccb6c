"""What runs on a robot's computers: agents, containers, components."""
