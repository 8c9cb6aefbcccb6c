"""Which limits a placement breaks, why nothing can hold, and what has to give way."""
