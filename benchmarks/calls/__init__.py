"""What a call and a message cost, over every kind of connector and by other means."""
