"""UML diagrams of a robot: its software, where it runs, and how that changes."""
