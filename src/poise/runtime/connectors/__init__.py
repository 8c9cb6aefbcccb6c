"""How two ports are joined: by a direct call, or over a channel between containers."""
