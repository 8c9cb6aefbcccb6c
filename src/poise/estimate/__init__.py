"""What components need: profiles, demands, and estimates while they run."""
