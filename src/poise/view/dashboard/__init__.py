"""A running robot as a local web page (extra `dashboard`)."""
