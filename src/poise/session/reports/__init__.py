"""What a run showed, as records for people and machines."""
