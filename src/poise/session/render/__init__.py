"""Tables of placements, reports and statuses, for terminals and notebooks."""
