"""What components work on while they are measured."""
