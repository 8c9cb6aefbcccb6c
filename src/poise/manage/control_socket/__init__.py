"""How commands such as `poise status` and `poise move` reach a running manager."""
