"""Components whose needs are known, to hold measurements against."""
