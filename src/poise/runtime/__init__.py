"""The agents, containers and components of a robot's computers."""
