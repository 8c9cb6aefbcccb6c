"""Tables that reports and statuses share, and how tables look."""
