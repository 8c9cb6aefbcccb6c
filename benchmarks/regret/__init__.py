"""How far decisions at run time are from those of an oracle that knows the future."""
