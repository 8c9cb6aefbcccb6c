"""A robot in virtual time: what it does, with which placement, under which faults."""
