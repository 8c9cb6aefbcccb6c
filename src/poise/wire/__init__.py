"""What computers say to each other: messages, their encoding, and transports."""
