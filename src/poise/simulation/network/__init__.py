"""What lies between computers: links, datagrams, and sessions like zenoh's."""
