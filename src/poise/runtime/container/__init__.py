"""The container process and the zygote that forks it."""
